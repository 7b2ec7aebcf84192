"""A Cortex-M over terms: its memory, its flags, and what each instruction does.

The memory that a kernel sees: the program's constants, its arguments and its stack.

Each array that it is given, and the stack, lies at an address that is a symbol: they may be
anywhere, but do not overlap. What is below the stack pointer is nobody's: an interrupt may write
there at any time.

The flags of a Cortex-M: each is worked out where it is asked for.

Instructions that set no flags of their own: products, halves, bytes, limits.

Registers hold terms modulo 2^32 or curves, flags are worked out where they are asked for. Whatever
has no rule, and every branch that hangs on a number that is not known, ends the run undecided.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TypeAlias

from zerodrift_proof.equality.terms import UndecidedError, Whole
from zerodrift_proof.object.code import ALWAYS, LR, PC, SP, Instruction, decode
from zerodrift_proof.object.image import Image
from zerodrift_proof.object.words import (
    LIMITED,
    TABLE,
    WIDE,
    WORD,
    Curves,
    Word,
    WordCurve,
    Words,
    WordTerms,
)

LOWEST = -(1 << 16)
"""Of the stack, in bytes from where a call finds it."""


@dataclass
class Area:
    """An array or the stack."""

    name: str
    base: Whole
    """Its address."""
    first: int
    """Bytes from the base where it may be read from."""
    end: int
    align: int
    """2 or 4: what the base is a multiple of."""
    writable: bool = False
    write_end: int = 0
    """Bytes from the base up to where it may be written."""
    words: dict[int, Whole] = field(default_factory=dict)
    """By their place, a multiple of 4."""
    halves: dict[int, Whole] = field(default_factory=dict)
    """Numbers with a sign, by their place; no place is in both."""


class ObjectMemory:
    """Loads and stores of words and halves."""

    def __init__(self, words: Words, image: Image) -> None:
        """Begin with the program's constants."""
        self.words, self.image = words, image
        self.areas: dict[int, Area] = {}
        """By the number of the base."""

    def give(self, area: Area) -> Whole:
        """Add an area; return its address."""
        self.areas[area.base.number] = area
        return area.base

    def _find(self, address: Whole) -> tuple[Area | None, int]:
        """Return where an address lies: an area and a place in it, or None and a number."""
        constant, sums = self.words.terms.split(address)
        sums = tuple((n, f % WORD) for n, f in sums if f % WORD)
        at = (constant + WORD // 2) % WORD - WORD // 2
        if not sums:
            return None, at % WORD
        if len(sums) == 1 and sums[0][1] == 1 and sums[0][0] in self.areas:
            return self.areas[sums[0][0]], at
        raise UndecidedError("an address that is not known")

    def _hold(self, area: Area, at: int, size: int, floor: int, write: bool) -> None:
        end = area.write_end if write else area.end
        first = max(area.first, floor) if area.name == "stack" else area.first
        if (write and not area.writable) or at < first or at + size > end:
            done = "written" if write else "read"
            raise UndecidedError(f"{size} bytes at {at} of {area.name} are {done}")

    def load(self, address: Whole, size: int, signed: bool, floor: int, loose: bool) -> Whole:
        """Return what lies at an address.

        Args:
            address: of the first byte.
            size: 2 or 4 bytes.
            signed: whether fewer than 4 are extended with their sign.
            floor: the stack pointer, in bytes from where it was at the call.
            loose: whether the instruction may read a word from any even address.
        """
        area, at = self._find(address)
        if area is None:
            if at % (2 if loose and size == 4 and self.image.unaligned else size):
                raise UndecidedError(f"{size} bytes are read at {at:#x}")
            content = self.image.read(at, size)
            if content is None:
                raise UndecidedError(f"{at:#x} is read, which may change or is not there")
            return self.words.number(int.from_bytes(content, "little", signed=signed or size == 4))
        self._hold(area, at, size, floor, False)
        aligned = at % size == 0 and size <= area.align
        if not (aligned or (loose and self.image.unaligned and at % 2 == 0)):
            raise UndecidedError(f"{size} bytes are read at {at} of {area.name}")
        if size == 4:
            if at in area.words:
                return area.words[at]
            return self.words.pack(self._half(area, at), self._half(area, at + 2))
        half = self._half(area, at)
        return half if signed else self.words.residue(half, 16, False)

    def _half(self, area: Area, at: int) -> Whole:
        whole = at & ~3
        if whole in area.words:
            word = area.words[whole]
            return self.words.high_half(word) if at & 2 else self.words.low_half(word)
        if at not in area.halves:
            raise UndecidedError(f"{area.name} is read at {at} before it is written")
        return area.halves[at]

    def store(self, address: Whole, size: int, value: Whole, floor: int) -> None:
        """Write a word or half to an address."""
        area, at = self._find(address)
        if area is None:
            raise UndecidedError(f"{at:#x} is written")
        self._hold(area, at, size, floor, True)
        if at % size or size > area.align:
            raise UndecidedError(f"{size} bytes are written at {at} of {area.name}")
        if size == 4:
            area.halves.pop(at, None)
            area.halves.pop(at + 2, None)
            area.words[at] = value
            return
        whole = at & ~3
        if whole in area.words:
            low, high = self._half(area, whole), self._half(area, whole + 2)
            del area.words[whole]
            area.halves[whole], area.halves[whole + 2] = low, high
        area.halves[at] = self.words.low_half(value)

    def release(self, floor: int) -> None:
        """Forget what lies below the stack pointer."""
        for area in self.areas.values():
            if area.name == "stack":
                for cells in (area.words, area.halves):
                    for at in [at for at in cells if at < floor]:
                        del cells[at]


Flag: TypeAlias = Callable[[], Word]


def unknown() -> Word:
    """Of a flag that is asked for: there is no rule for it."""
    raise UndecidedError("a flag that nothing has set, or that has no rule")


@dataclass(frozen=True)
class Flags:
    """How to find each flag, 0 or 1."""

    n: Flag = unknown
    z: Flag = unknown
    c: Flag = unknown
    v: Flag = unknown

    def hold(self, condition: int, curves: Curves) -> Word:
        """Return whether a condition holds.

        Raises:
            UndecidedError: it takes two flags or more, of which one is not known.
        """
        if condition == ALWAYS:
            return curves.words.number(1)
        kind = condition >> 1
        if kind < 4:
            truth = (self.z, self.c, self.n, self.v)[kind]()
        else:
            asked = (self.n(), self.v(), self.z(), self.c())
            n, v, z, c = (w.exact if isinstance(w, Whole) else None for w in asked)
            if None in (n, v, z, c):
                raise UndecidedError("a condition of numbers that are not known")
            held = (c == 1 and z == 0, n == v, n == v and z == 0)[kind - 4]
            truth = curves.words.number(int(held))
        if condition & 1:
            return curves.apply(("not",), curves.terms.negate, truth)
        return truth


def set_flags(curves: Curves, result: Word, carry: Flag, overflow: Flag) -> Flags:
    """Return the flags of a result."""
    words = curves.words
    return Flags(
        lambda: curves.apply(("sign",), words.sign, result),
        lambda: curves.apply(("zero",), words.is_zero, result),
        carry,
        overflow,
    )


class Parts:
    """What they make of words."""

    def __init__(self, words: Words, curves: Curves) -> None:
        """Make words with these."""
        self.words, self.curves, self.terms = words, curves, words.terms

    def shift(self, word: Word, kind: str, by: int) -> Word:
        """Return a word shifted by 0 to 32."""
        if by == 0:
            return word
        ways = {"lsl": self.words.lsl, "lsr": self.words.lsr, "asr": self.words.asr}
        way = ways.get(kind, self.words.ror)
        return self.curves.apply((kind, by), lambda a: way(a, by), word)

    def limit(self, word: Word, bits: int, signed: bool) -> Word:
        """Return a word limited to bits; to 20 it is what the table of tanh is read with."""
        words = self.words
        if isinstance(word, Whole) and signed and word.exact is None:
            t, edge = words.signed(word), 1 << (bits - 1)
            if bits == 20:
                word = self.curves.begin(TABLE, t)
            elif t.low < -edge or t.high >= edge:
                word = self._begin_limit(t, bits)
        return self.curves.apply(
            ("limit", bits, signed), lambda a: words.limit(a, bits, signed), word
        )

    def begin_lines(self, word: Word) -> Word:
        """Return a word whose line of tanh's table is asked for: a curve over these lines."""
        if isinstance(word, Whole) and word.exact is None:
            return self.curves.begin(TABLE, self.words.signed(word))
        return word

    def _begin_limit(self, t: Whole, bits: int) -> Word:
        """Return a number that is to be limited as a curve, of its half where it is even."""
        constant, sums = self.terms.split(t)
        every = [abs(n) for n in (constant, *(f for _, f in sums)) if n]
        twos = min((n & -n).bit_length() - 1 for n in every)
        twos = min(twos, bits - 1)
        base = self.curves.begin(LIMITED, self.terms.shift(t, twos), bits - twos)
        return self.shift(base, "lsl", twos)

    def make(self, one: Instruction, n: Word, m: Word, a: Word) -> Word:
        """Return what an instruction gives of its operands; one that it lacks is 0.

        Raises:
            UndecidedError: it has no rule.
        """
        words, terms, apply, name = self.words, self.terms, self.curves.apply, one.name
        if name in ("mul", "mla"):
            return apply(
                ("mla",), lambda x, y, z: terms.add(words.multiply(x, y), z), n, m, a
            )  # fmt: skip
        if name in ("smlad", "smuad"):
            return apply(("smlad",), words.multiply_halves, n, m, a)
        if name.startswith("smm"):
            rounded = name.endswith("r")
            way = words.multiply_high
            return apply((name,), lambda x, y, z: way(x, y, z, rounded), n, m, a)
        if name in ("pkhbt", "pkhtb"):
            m = self.shift(m, one.shift, one.by)
            if name == "pkhbt":
                return apply((name,), lambda x, y: words.pack(x, words.high_half(y)), n, m)
            return apply((name,), lambda x, y: words.pack(y, words.high_half(x)), n, m)
        if name in ("sxth", "uxth", "sxtb", "uxtb"):
            m, bits = self.shift(m, one.shift, one.by), 16 if name.endswith("h") else 8
            signed = name.startswith("s")
            return apply((name,), lambda x: words.residue(x, bits, signed), m)
        if name == "sxtb16":
            return apply((name,), words.extend_bytes, self.shift(m, "ror", one.by))
        if name == "uqadd8":
            return apply((name,), words.add_bytes, n, m)
        if name == "clz":
            return apply((name,), words.count_zeros, m)
        if name == "movt":
            return apply((name,), lambda x: words.pack(x, words.number(one.value)), n)
        raise UndecidedError(f"{name} has no rule")


MOST = 4_000_000
"""Instructions of a call."""
LINE = 11
"""A line of the table of tanh is 2^11 wide."""
ACCESS = {"ldr": (4, False), "ldrh": (2, False), "ldrsh": (2, True),
          "str": (4, False), "strh": (2, False)}  # fmt: skip
"""Name -> bytes, and whether they are extended with their sign."""


class ObjectMachine:
    """Runs a function of a program."""

    def __init__(self, image: Image) -> None:
        """Begin with registers of any value and no memory but the program's constants."""
        self.image, self.terms = image, WordTerms()
        self.words = Words(self.terms)
        self.curves, self.memory = Curves(self.words), ObjectMemory(self.words, image)
        self.parts = Parts(self.words, self.curves)
        self.registers: list[Word] = [
            self.terms.symbol(f"r{k} before", 0, WORD - 1) for k in range(15)
        ]
        self.flags = Flags()
        self.at = 0
        """Of the instruction that is run."""
        self.floor = 0
        """The stack pointer, in bytes from where it was at the call."""
        self.count = 0
        self._it: int | None = None
        self._decoded: dict[tuple[int, bool], Instruction] = {}

    # --- a call

    def call(self, entry: int) -> None:
        """Run a function until it returns; registers and areas are set.

        Raises:
            UndecidedError: something has no rule, or the function breaks the rules of a call.
        """
        before = list(self.registers)
        self.at, self.count, self.floor, self._it = entry, 0, 0, None
        while self.at >= 0:
            self.count += 1
            if self.count > MOST:
                raise UndecidedError(f"no return within {MOST} instructions")
            self.step()
        for k in (*range(4, 12), SP):
            if self.registers[k] is not before[k]:
                raise UndecidedError(f"r{k} is not given back")

    def step(self) -> None:
        """Run one instruction."""
        given, self._it = self._it, None
        one = self._fetch(given is not None)
        after = self.at + one.size
        if given is None or one.name == "it":
            self.at = self._run(one, after)
            return
        truth = self._holds(given)
        if isinstance(truth, Whole) and truth.exact is not None:
            self.at = self._run(one, after) if truth.exact else after
            return
        if one.name != "mov" or one.sets:
            raise UndecidedError("what is done hangs on a number that is not known")
        old, new = self.registers[one.d], self._operand(one)[0]
        self.registers[one.d] = self.curves.apply(("choose",), self.words.choose, truth, new, old)
        self.at = after

    def _fetch(self, in_it: bool) -> Instruction:
        key = self.at, in_it
        if key not in self._decoded:
            first = self.image.fetch(self.at)
            if first is None:
                raise UndecidedError("no instruction of this program")
            second = self.image.fetch(self.at + 2) or b"\0\0"
            halves = [int.from_bytes(half, "little") for half in (first, second)]
            self._decoded[key] = decode(halves[0], halves[1], in_it)
        return self._decoded[key]

    def _run(self, one: Instruction, after: int) -> int:
        """Return where to go on; below 0 after a return."""
        name = one.name
        if name in ("b", "bl", "cbz", "cbnz"):
            return self._branch(one, after)
        if name == "bx":
            return self._go(self._read(one.m))
        if name == "it":
            self._it = one.condition
        elif name in ACCESS:
            self._access(one)
        elif name in ("ldrd", "strd"):
            self._access_two(one)
        elif name in ("ldm", "stm", "push"):
            return self._access_many(one, after)
        elif name != "nop":
            self._compute(one)
        return after

    # --- registers, branches

    def _read(self, k: int) -> Word:
        return self.words.number(self.at + 4) if k == PC else self.registers[k]

    def _whole(self, k: int) -> Whole:
        return self.curves.settle(self._read(k))

    def _settle(self, k: int) -> Whole:
        """Return a register as a term, and hold it as that from now on."""
        word = self._read(k)
        return self._settle_word(word) if isinstance(word, WordCurve) else word

    def _write(self, k: int, value: Word) -> None:
        if k == SP:
            area, at = self.memory._find(self.curves.settle(value))
            if area is None or area.name != "stack" or at % 4 or not LOWEST <= at <= 0:
                raise UndecidedError("a stack pointer that is not known")
            self.floor = at
            self.memory.release(at)
        self.registers[k] = value

    def _branch(self, one: Instruction, after: int) -> int:
        target = self.at + 4 + one.value
        if one.name == "bl":
            self.registers[LR] = self.words.number(after | 1)
            return target
        if one.name == "b":
            truth = self._holds(one.condition)
        else:
            zero = self.curves.apply(("zero",), self.words.is_zero, self._read(one.n))
            truth = zero
        if not isinstance(truth, Whole) or truth.exact is None:
            raise UndecidedError("a branch that hangs on a number that is not known")
        return target if truth.exact == (one.name != "cbnz") else after

    def _go(self, where: Word) -> int:
        if where is self.terms.symbol(f"r{LR} before", 0, WORD - 1):
            return -1
        if isinstance(where, WordCurve) or where.exact is None or not where.exact & 1:
            raise UndecidedError("a branch to where is not known")
        return where.exact % WORD & ~1

    def _holds(self, condition: int) -> Word:
        """Return whether a condition holds."""
        return self.flags.hold(condition, self.curves)

    # --- loads and stores

    def _address(self, one: Instruction) -> tuple[Word, Word]:
        """Return the address of an access, and what is written back."""
        base: Word = self._read(one.n)
        if one.n == PC:
            base = self.words.number(self.at + 4 & ~3)
        if one.m >= 0:
            moved = self._shift(self._read(one.m), "lsl", one.by)
        else:
            moved = self.words.number(one.value)
        after = self.curves.apply(("add",), self.words.add, base, moved)
        return (after if one.before else base), after

    def _load(self, address: Word, size: int, signed: bool, loose: bool) -> Word:
        if isinstance(address, Whole) and address.exact is None:
            address = self._lift_place(address)
        if not isinstance(address, WordCurve):
            return self.memory.load(address, size, signed, self.floor, loose)

        def look_up(at: Whole) -> Whole:
            if at.exact is None:
                raise UndecidedError("a place in a table that is not known")
            return self.memory.load(at, size, signed, 0, loose)

        return self.curves.apply(("load", size, signed), look_up, address)

    def _lift_place(self, address: Whole) -> Word:
        """Return a place in a table, constant + f (t >> 11), as a curve of a t in a register."""
        for t in self.registers:
            if isinstance(t, WordCurve) or t.exact is not None:
                continue
            line = self.terms.shift(t, LINE)
            for size in (1, 2, 4):
                start = self.terms.subtract(address, self.terms.scale(line, size))
                if start.exact is not None:
                    return self._find_place(self.curves.begin(TABLE, t), size, start)
        return address

    def _find_place(self, t: WordCurve, size: int, start: Whole) -> Word:
        words, apply = self.words, self.curves.apply
        line = apply(("line",), lambda a: self.terms.shift(a, LINE), t)
        at = apply(("x", size), lambda a: self.terms.scale(a, size), line)
        return apply(("add",), words.add, at, start)

    def _access(self, one: Instruction) -> None:
        address, after = self._address(one)
        size, signed = ACCESS[one.name]
        if one.name.startswith("ldr"):
            value = self._load(address, size, signed, True)
            if one.back:
                self._write(one.n, after)
            self._write(one.d, value)
            return
        place, value = self.curves.settle(address), self._settle(one.d)
        if one.back:
            self._write(one.n, after)
        self.memory.store(place, size, value, self.floor)

    def _access_two(self, one: Instruction) -> None:
        address, after = self._address(one)
        place = self.curves.settle(address)
        places = place, self.terms.add(place, self.words.number(4))
        if one.name == "ldrd":
            values = [self._load(p, 4, False, False) for p in places]
        else:
            values = [self._whole(one.d), self._whole(one.a)]
            for p, value in zip(places, values, strict=True):
                self.memory.store(p, 4, self.curves.settle(value), self.floor)
        if one.back:
            self._write(one.n, after)
        if one.name == "ldrd":
            self.registers[one.d], self.registers[one.a] = values

    def _access_many(self, one: Instruction, after: int) -> int:
        base, count = self._whole(one.n), len(one.registers)
        if one.name == "push":
            base = self.terms.subtract(base, self.words.number(4 * count))
            self._write(one.n, base)
        places = [self.terms.add(base, self.words.number(4 * k)) for k in range(count)]
        if one.name != "ldm":
            for k, place in zip(one.registers, places, strict=True):
                self.memory.store(place, 4, self._settle(k), self.floor)
        else:
            values = [self._load(place, 4, False, False) for place in places]
            for k, value in zip(one.registers, values, strict=True):
                if k != PC:
                    self.registers[k] = value
        if one.back and one.name != "push":
            self._write(one.n, self.terms.add(base, self.words.number(4 * count)))
        if one.name == "ldm" and one.registers[-1] == PC:
            return self._go(values[-1])
        return after

    # --- numbers

    def _shift(self, word: Word, kind: str, by: int) -> Word:
        if by == 0:
            return word
        if kind == "asr" and by >= 31:
            word = self._find_sign(word, by)
        elif kind == "lsl" and isinstance(word, WordCurve) and self.curves.overflows(word, by):
            word = self._settle_word(word)
        return self.parts.shift(word, kind, by)

    def _settle_word(self, word: WordCurve) -> Whole:
        """Return a curve as a term; a register that holds it holds the term from now on."""
        whole = self.curves.settle(word)
        self.registers = [whole if r is word else r for r in self.registers]
        return whole

    def _find_sign(self, word: Word, by: int) -> Word:
        """Return a word as a curve of which each piece has one sign, as far as there is one."""
        if isinstance(word, WordCurve):
            signs = self.parts.shift(word, "asr", by)
            if isinstance(signs, Whole) or all(v.exact is not None for v in signs.values):
                return word
            word = self._settle_word(word)
        return word if word.exact is not None else self._lift(word)

    def _lift(self, word: Whole) -> Word:
        """Return a word of which a mask of its sign is made, as a curve."""
        if word.low < -(WORD >> 1) or word.high >= WORD >> 1:
            return self.curves.begin(WIDE, word)
        floor = self.words.floor_word
        for other in self.registers:
            if not isinstance(other, Whole) or other.high - other.low < WORD:
                continue
            if floor(other) is word:  # the upper word of a number of 64 bits
                return self.curves.apply(("floor",), floor, self.curves.begin(WIDE, other))
        return self.curves.begin(TABLE, word)

    def _operand(self, one: Instruction) -> tuple[Word, Flag]:
        """Return the last operand, and the carry that making it leaves."""
        if one.m < 0:
            old = self.flags.c
            value = self.words.number(one.value)
            if one.carry is None:
                return value, old
            bit = self.words.number(one.carry)
            return value, lambda: bit
        word, kind, by = self._read(one.m), one.shift, one.by
        if by == 0:
            return word, self.flags.c
        shifted = self._shift(word, kind, by)
        if kind == "asr" and by >= 31 and isinstance(word, Whole) and word.exact is None:
            word = self._lift(word)
        words = self.words
        return shifted, lambda: self.curves.apply(
            ("out", kind, by), lambda a: words.shifted_out(a, kind, by), word
        )

    def _compute(self, one: Instruction) -> None:
        name = one.name
        if name in ("add", "adc", "sub", "sbc", "rsb", "cmp", "cmn"):
            self._add(one)
        elif name in ("and", "bic", "orr", "eor", "mov", "mvn", "tst", "teq"):
            self._on_bits(one)
        elif name == "shift":
            self._shift_by_register(one)
        elif name in ("ssat", "usat"):
            self._limit(one)
        else:
            self._others(one)

    def _add(self, one: Instruction) -> None:
        """Sums; a difference adds what has every bit inverted, and 1 or the carry."""
        name, (b, _) = one.name, self._operand(one)
        a, words, apply = self._read(one.n), self.words, self.curves.apply
        if name == "rsb":
            a, b = b, a
        if name in ("sub", "cmp", "rsb", "sbc"):
            b = apply(("invert",), words.invert, b)
        more: Word = words.number(int(name in ("sub", "cmp", "rsb")))
        if name in ("adc", "sbc"):
            more = self.flags.c()
        total = apply(("sum",), lambda x, y, z: words.add(words.add(x, y), z), a, b, more)
        if one.sets:
            terms = self.terms

            def overflows(x: Whole, y: Whole, z: Whole) -> Whole:
                exact = terms.add(terms.add(words.signed(x), words.signed(y)), z)
                return terms.negate(terms.equal(words.signed(exact), exact))

            self.flags = set_flags(
                self.curves,
                total,
                lambda: apply(("carry",), words.carry, a, b, more),
                lambda: apply(("overflow",), overflows, a, b, more),
            )
        if one.d >= 0:
            self._write(one.d, total)

    def _on_bits(self, one: Instruction) -> None:
        name, (b, carry) = one.name, self._operand(one)
        words, apply = self.words, self.curves.apply
        if name in ("bic", "mvn"):
            b = apply(("invert",), words.invert, b)
        if name in ("mov", "mvn"):
            total = b
        else:
            kind = {"bic": "and", "tst": "and", "teq": "eor"}.get(name, name)
            ways = {"and": words.both, "orr": words.either, "eor": words.differ}
            total = apply((kind,), ways[kind], self._read(one.n), b)
        if one.sets:
            self.flags = set_flags(self.curves, total, carry, self.flags.v)
        if one.d >= 0:
            self._write(one.d, total)

    def _shift_by_register(self, one: Instruction) -> None:
        words, by = self.words, self._whole(one.m)
        amount = words.residue(by, 8, False).exact
        if amount is None and one.shift == "lsl":
            total: Word = words.shift_left_by(self._whole(one.n), by)
            if one.sets:
                self.flags = set_flags(self.curves, total, unknown, self.flags.v)
        elif amount is None or (one.sets and not 0 < amount < 32) or amount > 31:
            raise UndecidedError("a shift by what is not known")
        else:
            word = self._read(one.n)
            total = self._shift(word, one.shift, amount)
            if one.sets:
                kind, apply = one.shift, self.curves.apply
                self.flags = set_flags(
                    self.curves,
                    total,
                    lambda: apply(
                        ("out", kind, amount), lambda a: words.shifted_out(a, kind, amount), word
                    ),
                    self.flags.v,
                )
        self._write(one.d, total)

    def _limit(self, one: Instruction) -> None:
        word = self._read(one.m)
        if one.name == "ssat" and one.value == 20:
            word = self.curves.settle(word)
        elif (one.name, one.value, one.shift, one.by) == ("ssat", 9, "asr", 11):
            word = self.parts.begin_lines(word)
        word = self._shift(word, one.shift, one.by)
        self._write(one.d, self.parts.limit(word, one.value, one.name == "ssat"))

    def _others(self, one: Instruction) -> None:
        name, words, apply = one.name, self.words, self.curves.apply
        if name == "smull":
            product = apply(("x",), words.multiply_signed, self._read(one.n), self._read(one.m))
            self._write(one.d, product)
            self._write(one.a, apply(("floor",), words.floor_word, product))
            return
        zero = words.number(0)
        n, m, a = (self._read(k) if k >= 0 else zero for k in (one.n, one.m, one.a))
        self._write(one.d, self.parts.make(one, n, m, a))
        if one.sets:  # MULS leaves carry and overflow as they are
            self.flags = set_flags(self.curves, self.registers[one.d], self.flags.c, self.flags.v)
