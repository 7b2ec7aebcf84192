"""Instructions of Armv6-M and Armv7E-M as their bytes say: those that the kernels use, no others.

An instruction of Armv6-M or Armv7E-M, decoded.

Written from the Armv7-M Architecture Reference Manual (DDI 0403), chapter A7. An encoding that it
calls unpredictable, or whose fixed bits are others than it says, is no instruction here.
"""

from dataclasses import dataclass
from typing import NoReturn

from zerodrift_proof.equality.terms import UndecidedError

SP, LR, PC = 13, 14, 15
ALWAYS = 14
"""The condition of what has none."""


@dataclass(frozen=True, slots=True)
class Instruction:
    """What an encoding says. Registers are 0 to 15; -1 where there is none."""

    name: str
    size: int
    """2 or 4 bytes."""
    d: int = -1
    n: int = -1
    m: int = -1
    a: int = -1
    """The third operand, or the upper half of a long result."""
    value: int = 0
    """An immediate, an offset in bytes or a branch's distance from the next instruction but one."""
    shift: str = "lsl"
    by: int = 0
    sets: bool = False
    """Whether flags are set."""
    registers: tuple[int, ...] = ()
    before: bool = False
    """Of an address: the offset is added before the access."""
    back: bool = False
    """Of an address: it is written back."""
    condition: int = ALWAYS
    carry: int | None = None
    """Of an immediate: the carry that making it leaves."""


SHIFTS = ("lsl", "lsr", "asr", "ror")
ALU = {0: "and", 1: "bic", 2: "orr", 4: "eor", 8: "add", 10: "adc", 11: "sbc", 13: "sub", 14: "rsb"}
COMPARING = {"and": "tst", "eor": "teq", "add": "cmn", "sub": "cmp"}
SHORT_ALU = ("and", "eor", "lsl", "lsr", "asr", "adc", "sbc", "ror",
             "tst", "rsb", "cmp", "cmn", "orr", "mul", "bic", "mvn")  # fmt: skip
LOADS = ("str", "strh", "", "", "ldr", "ldrh", "", "ldrsh")
"""Of short encodings with two registers; bytes have no rule."""


def decode(half: int, second: int, in_it: bool) -> Instruction:
    """Return the instruction of two halfwords, of which a short one has the first alone.

    Args:
        half: the first halfword.
        second: the one after it.
        in_it: whether an IT block makes it conditional; short ones then set no flags.

    Raises:
        UndecidedError: it is none of those that are known.
    """
    if half >> 11 < 29:
        return _Short(half, not in_it).decode()
    return _Long(half, second).decode()


def _refuse(*halves: int) -> NoReturn:
    words = " ".join(f"{half:04x}" for half in halves)
    raise UndecidedError(f"no instruction that has a rule: {words}")


class _Short:
    """An encoding of 16 bits."""

    def __init__(self, half: int, sets: bool) -> None:
        self.half, self.sets = half, sets

    def field(self, at: int, bits: int = 3) -> int:
        return self.half >> at & ((1 << bits) - 1)

    def decode(self) -> Instruction:
        top = self.half >> 11
        if top < 8:
            return self._immediate(top)
        if top == 8:
            return self._registers() if not self.field(10, 1) else self._special()
        if top == 9:
            return Instruction("ldr", 2, self.field(8), PC, value=4 * self.field(0, 8), before=True)
        if top < 20:
            return self._access(top)
        if top in (21, 22, 23):
            return self._other()
        listed = tuple(r for r in range(8) if self.half >> r & 1)
        base = self.field(8)
        if top == 24 and listed and base not in listed[1:]:
            return Instruction("stm", 2, n=base, registers=listed, back=True)
        if top == 25 and listed:
            return Instruction("ldm", 2, n=base, registers=listed, back=base not in listed)
        if top in (26, 27) and self.field(8, 4) < ALWAYS:
            distance = 2 * _extend(self.field(0, 8), 8)
            return Instruction("b", 2, value=distance, condition=self.field(8, 4))
        if top == 28:
            return Instruction("b", 2, value=2 * _extend(self.field(0, 11), 11))
        _refuse(self.half)

    def _immediate(self, top: int) -> Instruction:
        d, n, sets = self.field(0), self.field(3), self.sets
        if top < 3:
            by = self.field(6, 5) or (32 if top else 0)
            return Instruction("mov", 2, d, m=n, shift=SHIFTS[top], by=by, sets=sets)
        if top == 3:
            name = "sub" if self.field(9, 1) else "add"
            if self.field(10, 1):
                return Instruction(name, 2, d, n, value=self.field(6), sets=sets)
            return Instruction(name, 2, d, n, self.field(6), sets=sets)
        name, d = ("mov", "cmp", "add", "sub")[top - 4], self.field(8)
        sets = sets or name == "cmp"
        n = -1 if name == "mov" else d
        return Instruction(
            name, 2, -1 if name == "cmp" else d, n, value=self.field(0, 8), sets=sets
        )

    def _registers(self) -> Instruction:
        name, d, m = SHORT_ALU[self.field(6, 4)], self.field(0), self.field(3)
        if name in SHIFTS:
            return Instruction("shift", 2, d, d, m, shift=name, sets=self.sets)
        if name in ("tst", "cmp", "cmn"):
            return Instruction(name, 2, -1, d, m, sets=True)
        if name == "rsb":
            return Instruction("rsb", 2, d, m, sets=self.sets)
        if name == "mvn":
            return Instruction("mvn", 2, d, m=m, sets=self.sets)
        return Instruction(name, 2, d, d, m, sets=self.sets)

    def _special(self) -> Instruction:
        kind, d, m = self.field(8, 2), self.field(7, 1) << 3 | self.field(0), self.field(3, 4)
        if kind == 3:
            if self.half & 0x87 == 0 and m not in (SP, PC):
                return Instruction("bx", 2, m=m)
            _refuse(self.half)
        if PC in (d, m) or SP in (d, m):
            _refuse(self.half)
        if kind == 0:
            return Instruction("add", 2, d, d, m)
        if kind == 1 and (d > 7 or m > 7):
            return Instruction("cmp", 2, -1, d, m, sets=True)
        if kind == 2:
            return Instruction("mov", 2, d, m=m)
        _refuse(self.half)

    def _access(self, top: int) -> Instruction:
        t, n = self.field(0), self.field(3)
        if top < 12:
            name = LOADS[self.field(9)]
            if not name:
                _refuse(self.half)
            return Instruction(name, 2, t, n, self.field(6), before=True)
        if top < 18:
            if top in (14, 15):
                _refuse(self.half)
            ways = {12: ("str", 4), 13: ("ldr", 4), 16: ("strh", 2), 17: ("ldrh", 2)}
            name, unit = ways[top]
            return Instruction(name, 2, t, n, value=unit * self.field(6, 5), before=True)
        name = "str" if top == 18 else "ldr"
        return Instruction(name, 2, self.field(8), SP, value=4 * self.field(0, 8), before=True)

    def _other(self) -> Instruction:
        half = self.half
        if half >> 11 == 21:
            return Instruction("add", 2, self.field(8), SP, value=4 * self.field(0, 8))
        if half & 0xFF00 == 0xB000:
            name = "sub" if half & 0x80 else "add"
            return Instruction(name, 2, SP, SP, value=4 * self.field(0, 7))
        if half & 0xF500 == 0xB100:
            distance = self.field(9, 1) << 6 | self.field(3, 5) << 1
            name = "cbnz" if half & 0x800 else "cbz"
            return Instruction(name, 2, n=self.field(0), value=distance)
        if half & 0xFF00 == 0xB200:
            name = ("sxth", "sxtb", "uxth", "uxtb")[self.field(6, 2)]
            return Instruction(name, 2, self.field(0), m=self.field(3))
        listed = tuple(r for r in range(8) if half >> r & 1)
        if half & 0xFE00 == 0xB400 and half & 0x1FF:
            listed += (LR,) if half & 0x100 else ()
            return Instruction("push", 2, n=SP, registers=listed, back=True)
        if half & 0xFE00 == 0xBC00 and half & 0x1FF:
            listed += (PC,) if half & 0x100 else ()
            return Instruction("ldm", 2, n=SP, registers=listed, back=True)
        if half == 0xBF00:
            return Instruction("nop", 2)
        if half & 0xFF00 == 0xBF00 and self.field(0, 4) == 8 and self.field(4, 4) < ALWAYS:
            return Instruction("it", 2, condition=self.field(4, 4))  # of one instruction
        _refuse(half)


class _Long:
    """An encoding of 32 bits."""

    def __init__(self, first: int, second: int) -> None:
        self.first, self.second = first, second
        self.n, self.d, self.m = first & 15, second >> 8 & 15, second & 15
        self.t = second >> 12

    def refuse(self) -> NoReturn:
        _refuse(self.first, self.second)

    def decode(self) -> Instruction:
        first, second = self.first, self.second
        if first >> 9 == 0x74:
            return self._dual() if first & 0x40 else self._multiple()
        if first >> 9 == 0x75:
            return self._shifted()
        if first >> 11 == 0x1E:
            if second >> 15:
                return self._branch()
            return self._plain() if first & 0x200 else self._modified()
        if first >> 9 == 0x7C:
            return self._access()
        if first >> 8 == 0xFA:
            return self._of_registers()
        if first >> 7 == 0x1F6:
            return self._multiply()
        if first >> 4 == 0xFB8 and second & 0xF0 == 0:  # SMULL
            self._only_plain(self.n, self.m, self.d, self.t)
            if self.d == self.t:
                self.refuse()
            return Instruction("smull", 4, self.t, self.n, self.m, self.d)
        self.refuse()

    def _only_plain(self, *registers: int) -> None:
        if SP in registers or PC in registers:
            self.refuse()

    def _multiple(self) -> Instruction:
        way, back, load = self.first >> 7 & 3, bool(self.first & 0x20), bool(self.first & 0x10)
        listed = tuple(r for r in range(16) if self.second >> r & 1)
        if self.n == PC or SP in listed or len(listed) < 2 or (back and self.n in listed):
            self.refuse()
        if load and way == 1 and not {LR, PC} <= {*listed}:
            return Instruction("ldm", 4, n=self.n, registers=listed, back=back)
        if not load and way == 1 and PC not in listed:
            return Instruction("stm", 4, n=self.n, registers=listed, back=back)
        if not load and way == 2 and PC not in listed and back:
            return Instruction("push", 4, n=self.n, registers=listed, back=True)
        self.refuse()

    def _dual(self) -> Instruction:
        first, t, second = self.first, self.t, self.d
        before, back, load = bool(first & 0x100), bool(first & 0x20), bool(first & 0x10)
        self._only_plain(t, second)
        if not (before or back) or self.n == PC or (back and self.n in (t, second)):
            self.refuse()
        if load and t == second:
            self.refuse()
        offset = 4 * (self.second & 255)
        return Instruction(
            "ldrd" if load else "strd", 4, t, self.n, a=second, before=before, back=back,
            value=offset if first & 0x80 else -offset,
        )  # fmt: skip

    def _shifted(self) -> Instruction:
        second = self.second
        by, kind = (second >> 12 & 7) << 2 | second >> 6 & 3, second >> 4 & 3
        if second >> 15 or (kind == 3 and by == 0):
            self.refuse()
        by = by or (32 if kind in (1, 2) else 0)
        self._only_plain(self.m)
        code, sets = self.first >> 5 & 15, bool(self.first & 0x10)
        if code == 6:
            self._only_plain(self.n, self.d)
            if sets or kind & 1:
                self.refuse()
            name = "pkhtb" if kind else "pkhbt"
            return Instruction(name, 4, self.d, self.n, self.m, shift=SHIFTS[kind], by=by)
        name, d, n = self._alu(code, sets)
        return Instruction(name, 4, d, n, self.m, shift=SHIFTS[kind], by=by, sets=sets)

    def _alu(self, code: int, sets: bool) -> tuple[str, int, int]:
        """Return name, d and n; -1 where there is none."""
        name, d, n = ALU.get(code, ""), self.d, self.n
        if code == 2 and n == PC:
            name, n = "mov", -1
        elif code == 3 and n == PC:
            name, n = "mvn", -1
        if name in COMPARING and d == PC and sets:
            name, d = COMPARING[name], -1
        moves_stack = name in ("add", "sub") and d == n == SP
        if not name or (d in (SP, PC) and not moves_stack):
            self.refuse()
        if n == PC or (n == SP and name not in ("add", "sub")):
            self.refuse()
        return name, d, n

    def _modified(self) -> Instruction:
        first, second = self.first, self.second
        twelve = (first >> 10 & 1) << 11 | (second >> 12 & 7) << 8 | second & 255
        low, carry = twelve & 255, None
        if twelve >> 10 == 0:
            value = low * (1, 0x00010001, 0x01000100, 0x01010101)[twelve >> 8]
            if twelve >> 8 and not low:
                self.refuse()
        else:
            by, part = twelve >> 7, 0x80 | twelve & 0x7F
            value = (part >> by | part << (32 - by)) & 0xFFFFFFFF
            carry = value >> 31
        sets = bool(first & 0x10)
        name, d, n = self._alu(first >> 5 & 15, sets)
        return Instruction(name, 4, d, n, value=value, sets=sets, carry=carry)

    def _plain(self) -> Instruction:
        first, second = self.first, self.second
        code, top, three = first >> 4 & 31, first >> 10 & 1, second >> 12 & 7
        twelve = top << 11 | three << 8 | second & 255
        if code in (0, 10):
            moves_stack = self.d == self.n == SP
            if (self.d in (SP, PC) and not moves_stack) or self.n == PC:
                self.refuse()
            return Instruction("add" if code == 0 else "sub", 4, self.d, self.n, value=twelve)
        self._only_plain(self.d)
        if code in (4, 12):
            value = self.n << 12 | twelve
            return Instruction("mov" if code == 4 else "movt", 4, self.d, self.d, value=value)
        if code in (16, 18, 24, 26):
            self._only_plain(self.n)
            by = three << 2 | second >> 6 & 3
            if top or second & 0x20 or (code & 2 and not by):
                self.refuse()
            name, to = ("ssat", (second & 31) + 1) if code < 24 else ("usat", second & 31)
            shift = "asr" if code & 2 else "lsl"
            return Instruction(name, 4, self.d, m=self.n, value=to, shift=shift, by=by)
        self.refuse()

    def _branch(self) -> Instruction:
        first, second = self.first, self.second
        sign, j1, j2 = first >> 10 & 1, second >> 13 & 1, second >> 11 & 1
        condition, low = first >> 6 & 15, (second & 0x7FF) << 1
        if second & 0x5000 == 0 and condition < ALWAYS:
            whole = sign << 20 | j2 << 19 | j1 << 18 | (first & 63) << 12 | low
            return Instruction("b", 4, value=_extend(whole, 21), condition=condition)
        if not second & 0x1000:
            self.refuse()
        whole = sign << 24 | (1 ^ j1 ^ sign) << 23 | (1 ^ j2 ^ sign) << 22
        whole |= (first & 0x3FF) << 12 | low
        return Instruction("bl" if second & 0x4000 else "b", 4, value=_extend(whole, 25))

    def _access(self) -> Instruction:
        first, second = self.first, self.second
        size, load, signed = first >> 5 & 3, bool(first & 0x10), bool(first & 0x100)
        names = ("", "strh", "str") if not load else ("", "ldrh", "ldr")
        if (
            size in (0, 3)
            or self.n == PC
            or self.t in (SP, PC)
            or (signed and (not load or size == 2))
        ):
            self.refuse()
        name = "ldrsh" if signed else names[size]
        if first & 0x80:
            return Instruction(name, 4, self.t, self.n, value=second & 0xFFF, before=True)
        if second & 0x800:
            before, up, back = (bool(second & bit) for bit in (0x400, 0x200, 0x100))
            if not (before or back) or (before and up and not back) or (back and self.n == self.t):
                self.refuse()
            offset = second & 255 if up else -(second & 255)
            return Instruction(name, 4, self.t, self.n, value=offset, before=before, back=back)
        if second & 0x7C0:
            self.refuse()
        self._only_plain(self.m)
        by = second >> 4 & 3
        return Instruction(name, 4, self.t, self.n, self.m, by=by, before=True)

    def _of_registers(self) -> Instruction:
        code, second = self.first >> 4 & 15, self.second
        if self.t != 15:
            self.refuse()
        self._only_plain(self.d, self.m)
        if code < 8 and second & 0xF0 == 0:
            self._only_plain(self.n)
            name = SHIFTS[code >> 1]
            return Instruction("shift", 4, self.d, self.n, self.m, shift=name, sets=bool(code & 1))
        if code in (0, 1, 2, 4, 5) and second & 0xC0 == 0x80 and self.n == PC:
            name = ("sxth", "uxth", "sxtb16", "", "sxtb", "uxtb")[code]
            by = 8 * (second >> 4 & 3)
            return Instruction(name, 4, self.d, m=self.m, shift="ror", by=by)
        if code == 8 and second & 0xF0 == 0x50:
            self._only_plain(self.n)
            return Instruction("uqadd8", 4, self.d, self.n, self.m)
        if code == 11 and second & 0xF0 == 0x80 and self.n == self.m:
            return Instruction("clz", 4, self.d, m=self.m)
        self.refuse()

    def _multiply(self) -> Instruction:
        code, way, a = self.first >> 4 & 7, self.second >> 4 & 15, self.t
        self._only_plain(self.d, self.n, self.m)
        names = {
            (0, 0): ("mla", "mul"), (2, 0): ("smlad", "smuad"),
            (5, 0): ("smmla", "smmul"), (5, 1): ("smmlar", "smmulr"),
        }  # fmt: skip
        if (code, way) not in names or a == SP:
            self.refuse()
        if a == PC:
            return Instruction(names[code, way][1], 4, self.d, self.n, self.m)
        return Instruction(names[code, way][0], 4, self.d, self.n, self.m, a)


def _extend(value: int, bits: int) -> int:
    return value - (value >> (bits - 1) << bits)
