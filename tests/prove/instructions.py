"""Single instructions, drawn at random: a core's answer, and the term machine's."""

import random
from dataclasses import dataclass, field

from unicorn import UcError
from unicorn.arm_const import (
    UC_ARM_REG_CPSR,
    UC_ARM_REG_LR,
    UC_ARM_REG_PC,
    UC_ARM_REG_R0,
    UC_ARM_REG_R12,
    UC_ARM_REG_SP,
    UC_ARM_REG_XPSR,
)

from zerodrift.c_runtime.emulator import make_chip
from zerodrift_proof.equality.kernels import compute_tanh
from zerodrift_proof.equality.terms import Whole
from zerodrift_proof.object.image import ElfSpan, Image
from zerodrift_proof.object.machine import Area, Flags, ObjectMachine
from zerodrift_proof.object.words import WORD, Word, WordCurve

CODE, DATA, STACK, FIXED = 0x03000000, 0x20001000, 0x30001000, 0x10000000
BYTES = 512
EDGES = (
    0,
    1,
    2,
    0x7FFFFFFF,
    0x80000000,
    0xFFFFFFFF,
    0xFFFF,
    0x8000,
    0x10000,
    31,
    32,
    255,
    0x80000001,
)

LONG = {
    "ldm": "1110100010W1nnnn rr0rrrrrrrrrrrrr", "stm": "1110100010W0nnnn 0r0rrrrrrrrrrrrr",
    "push": "1110100100101101 0r0rrrrrrrrrrrrr", "pop": "1110100010111101 rr0rrrrrrrrrrrrr",
    "ldrd": "1110100xx1x1nnnn ttttssss000000ii", "strd": "1110100xx1x0nnnn ttttssss000000ii",
    "shifted register": "11101010xxxSnnnn 0iiiddddiittmmmm",
    "pkh": "111010101100nnnn 0iiiddddii?0mmmm",
    "shifted register, sums": "11101011xxxSnnnn 0iiiddddiittmmmm",
    "immediate": "11110i0xxxxSnnnn 0iiiddddiiiiiiii",
    "addw": "11110i100000nnnn 0iiiddddiiiiiiii", "subw": "11110i101010nnnn 0iiiddddiiiiiiii",
    "movw": "11110i100100iiii 0iiiddddiiiiiiii", "movt": "11110i101100iiii 0iiiddddiiiiiiii",
    "ssat": "1111001100s0nnnn 0iiiddddii0iiiii", "usat": "1111001110s0nnnn 0iiiddddii0iiiii",
    "b": "11110s00000000ii 10j1jiiiiiiiiiii", "bl": "11110s00000000ii 11j1jiiiiiiiiiii",
    "b.cond": "11110s0000iiiiii 10j0jiiiiiiiiiii", "b.any": "11110scccciiiiii 10j0jiiiiiiiiiii",
    "load, 12 bits": "1111100s1zz1nnnn tttt0000iiiiiii0",
    "store, 12 bits": "111110001zz0nnnn tttt0000iiiiii00",
    "load, 8 bits": "1111100s0zz1nnnn tttt1xxx00iiiii0",
    "store, 8 bits": "111110000zz0nnnn tttt1xxx00iiiii0",
    "load, register": "1111100s0zz1nnnn tttt000000iimmmm",
    "store, register": "111110000zz0nnnn tttt000000iimmmm",
    "shift by register": "11111010000xSnnn 1111dddd0000mmmm",
    "shift by a register": "111110100xxSnnnn 1111dddd0000mmmm",
    "extend": "111110100xxx1111 1111dddd10rrmmmm", "uqadd8": "111110101000nnnn 1111dddd0101mmmm",
    "clz": "111110101011mmmm 1111dddd1000mmmm", "mla": "111110110000nnnn aaaadddd0000mmmm",
    "mul": "111110110000nnnn 1111dddd0000mmmm", "smlad": "111110110010nnnn aaaadddd0000mmmm",
    "smuad": "111110110010nnnn 1111dddd0000mmmm", "smmla": "111110110101nnnn aaaadddd000rmmmm",
    "smmul": "111110110101nnnn 1111dddd000rmmmm", "smull": "111110111000nnnn aaaadddd0000mmmm",
}  # fmt: skip
"""What is fixed of each encoding of 32 bits; a letter that stands for a field is drawn as one."""


def draw_long(rng: random.Random, pattern: str) -> tuple[int, int]:
    """Return two halfwords of a pattern."""
    halves = pattern.split()
    fields: dict[str, list[int]] = {}
    for letter in "mnd":
        if letter * 4 in pattern:  # one register for all places of its letter
            number = rng.choice((*range(13), *range(8), 14, 13))
            fields[letter] = [number >> k & 1 for k in (3, 2, 1, 0)] * 2
    found = []
    for half in halves:
        bits = [
            int(c) if c in "01" else fields[c].pop(0) if fields.get(c) else rng.getrandbits(1)
            for c in half
        ]
        found.append(int("".join(map(str, bits)), 2))
    return found[0], found[1]


@dataclass
class State:
    """Registers, flags and memory."""

    registers: list[int]
    """r0 to r14."""
    flags: int
    """N Z C V, N the highest."""
    data: bytes
    stack: bytes
    at: int = CODE


def fill(code: bytes, fixed: bytes) -> bytes:
    """Return instructions with NOP behind them, and what may be read after those."""
    return code + b"\0\xbf" * 8 + fixed * 6


class Chip:
    """One instruction on an emulated Cortex-M4."""

    def __init__(self) -> None:
        self.chip = make_chip("cortex-m4")
        self.chip.mem_map(CODE - 0x2000000, 0x4000000)  # wherever a branch may go
        self.chip.mem_map(FIXED, 0x1000)
        for at in (DATA, STACK):
            self.chip.mem_map(at - 0x1000, 0x2000)

    def run(self, code: bytes, state: State, fixed: bytes, steps: int = 1) -> State | None:
        """Return the state after so many instructions; None where the core stops."""
        chip = self.chip
        chip.mem_write(CODE, fill(code, fixed))
        chip.mem_write(DATA, state.data)
        chip.mem_write(STACK - BYTES, state.stack)
        chip.mem_write(FIXED, fixed)
        for k, value in enumerate(state.registers):
            chip.reg_write(_number(k), value)
        chip.reg_write(UC_ARM_REG_XPSR, state.flags << 28 | 0x01000000)
        chip.ctl_flush_tb()
        try:
            if steps == 1:
                chip.emu_start(CODE | 1, 0xFFFFFFFE, 0, 1)  # type: ignore[call-arg]
            else:  # unicorn counts an IT block as one
                chip.emu_start(CODE | 1, CODE + 2 * steps, 0)
        except UcError:
            return None
        flags = chip.reg_read(UC_ARM_REG_CPSR) >> 28
        return State(
            [chip.reg_read(_number(k)) for k in range(15)],
            flags,
            bytes(chip.mem_read(DATA, BYTES)),
            bytes(chip.mem_read(STACK - BYTES, 2 * BYTES)),
            chip.reg_read(UC_ARM_REG_PC) & ~1,
        )


def _number(k: int) -> int:
    if k == 12:
        return UC_ARM_REG_R12
    if k == 13:
        return UC_ARM_REG_SP
    if k == 14:
        return UC_ARM_REG_LR
    return UC_ARM_REG_R0 + k


@dataclass
class Terms:
    """The term machine at one instruction, with numbers for its symbols."""

    machine: ObjectMachine
    values: dict[int, int] = field(default_factory=dict)
    """Number of a symbol -> its value."""
    _known: dict[int, int] = field(default_factory=dict)

    def symbol(self, name: str, low: int, high: int, value: int) -> Whole:
        """Return a symbol that has a value."""
        made = self.machine.terms.symbol(name, low, high)
        self.values[made.number] = value
        return made

    def word(self, word: Word) -> int:
        """Return a word's 32 bits."""
        if not isinstance(word, WordCurve):
            return self.evaluate(word) % WORD
        at = self.evaluate(word.base)
        for (low, high), symbol, value in zip(
            word.domain.pieces, word.domain.symbols, word.values, strict=True
        ):
            if low <= at <= high:
                inside = Terms(self.machine, {**self.values, symbol.number: at})
                return inside.evaluate(value) % WORD
        raise AssertionError(f"{at} is in none of the pieces")

    def evaluate(self, term: Whole) -> int:
        """Return a term's number, which lies in its range."""
        if term.number not in self._known:
            found = self._evaluate(term)
            assert term.low <= found <= term.high
            self._known[term.number] = found
        return self._known[term.number]

    def _evaluate(self, term: Whole) -> int:
        terms = self.machine.terms
        if term.kind == "sum":
            return term.constant + sum(self.evaluate(terms.atom(n)) * f for n, f in term.sums)
        if term.kind == "symbol":
            return self.values[term.number]
        if term.kind == "shift":
            return self.evaluate(terms.atom(term.inner[0])) >> term.inner[1]
        inner = [self.evaluate(terms.atom(n)) for n in term.inner]
        match term.kind:
            case "product":
                return inner[0] * inner[1]
            case "max" | "min":
                return max(inner) if term.kind == "max" else min(inner)
            case "le" | "eq":
                return int(inner[0] <= 0 if term.kind == "le" else inner[0] == 0)
            case "or":
                return int(any(inner))
            case "choose":
                return inner[1] if inner[0] else inner[2]
        name = next(key[1] for key, made in terms._made.items() if made is term)
        if name == "tanh":
            return compute_tanh(inner[0])
        if name == "2^":
            return 1 << inner[0]
        assert name == "^", name
        both = (inner[0] ^ inner[1]) % WORD
        return both - WORD * (both >> 31)


def make_terms(
    code: bytes, state: State, fixed: bytes, rng: random.Random | None, memory: bool = True
) -> Terms:
    """Return the term machine before an instruction: with numbers, or symbols if `rng` is given.

    Registers that hold an address in the data or on the stack are one of the machine's areas.
    """
    spans = ElfSpan(CODE, fill(code, fixed), True), ElfSpan(FIXED, fixed, False)
    terms = Terms(ObjectMachine(Image(spans, (), True)))
    machine = terms.machine
    areas = []
    for name, base, content, first, end in (
        ("data", DATA, state.data, 0, BYTES),
        ("stack", STACK, state.stack, -BYTES, BYTES),
    ):
        symbol = terms.symbol(f"address of {name}", 0, WORD - 1, base)
        area = Area(name, symbol, first, end, 4, True, end)
        for k in range(0, len(content) if memory else 0, 4):
            value = int.from_bytes(content[k : k + 4], "little", signed=True)
            area.words[first + k] = _say(terms, f"{name} {k}", value, rng)
        machine.memory.give(area)
        areas.append((base, symbol))
    for k, value in enumerate(state.registers):
        near = [(base, s) for base, s in areas if abs(value - base) < BYTES]
        if near:
            offset = machine.terms.constant(value - near[0][0])
            machine.registers[k] = machine.terms.add(near[0][1], offset)
            if k == 13:
                machine.floor = value - near[0][0]
        else:
            machine.registers[k] = _say(terms, f"r{k}", value, rng)
    bits = [machine.terms.constant(state.flags >> k & 1) for k in (3, 2, 1, 0)]
    if rng is not None:
        bits = [terms.symbol(f"flag {k}", 0, 1, bit.low) for k, bit in enumerate(bits)]
    n, z, c, v = bits
    machine.flags = Flags(lambda: n, lambda: z, lambda: c, lambda: v)
    machine.at = CODE
    return terms


def _say(terms: Terms, name: str, value: int, rng: random.Random | None) -> Whole:
    """Return a word's value as a number, or as a symbol that may be other numbers too."""
    made = terms.machine.terms
    signed = (value + (WORD >> 1)) % WORD - (WORD >> 1)
    if rng is None or rng.random() < 0.2:
        return made.constant(rng.choice((signed, signed % WORD)) if rng else signed)
    way = rng.randrange(6)
    if way == 0:  # any word
        return terms.symbol(name, 0, WORD - 1, signed % WORD)
    if way == 1:  # two halves
        low, high = ((signed >> s & 0xFFFF ^ 0x8000) - 0x8000 for s in (0, 16))
        parts = [terms.symbol(f"{name} {s}", -32768, 32767, s) for s in (low, high)]
        return terms.machine.words.pack(parts[0], parts[1])
    if way == 2:  # an even or odd one
        half = terms.symbol(f"{name} half", -(1 << 30), (1 << 30) - 1, signed >> 1)
        return made.add(made.scale(half, 2), made.constant(signed & 1))
    turns = rng.randint(-2, 2) if way == 3 else 0
    width = rng.choice((0, 1, 3, 100, 1 << 11, 1 << 20, 1 << 31))
    low, high = (rng.randint(0, width) for _ in range(2))
    around = terms.symbol(name, signed - low, signed + high, signed)
    return made.add(around, made.constant(turns * WORD))
