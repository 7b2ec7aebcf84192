"""Every instruction that has a rule does to registers, flags and memory what a core does."""

import random
from collections import Counter

import pytest

from tests.prove.instructions import (
    BYTES,
    CODE,
    DATA,
    EDGES,
    FIXED,
    LONG,
    STACK,
    Chip,
    State,
    draw_long,
    make_terms,
)
from zerodrift_proof.equality.terms import UndecidedError
from zerodrift_proof.object.code import decode


@pytest.fixture(scope="module")
def chip() -> Chip:
    return Chip()


def draw_state(rng: random.Random, access: bool) -> State:
    """Return a state of which some registers are addresses; for an access most of them."""
    registers = []
    for _ in range(13):
        kind = rng.choice((0, 0, 0, 1, 2, 6, 6, 6)) if access else rng.randrange(6)
        if kind == 0:
            registers.append(DATA + 4 * rng.randint(16, 80))
        elif kind == 1:
            registers.append(FIXED + 4 * rng.randint(16, 80))
        elif kind == 6:
            registers.append(2 * rng.randint(-8, 8) % 2**32)
        elif kind == 2:
            registers.append(rng.choice(EDGES))
        elif kind == 3:
            registers.append(rng.randint(-70, 70) % 2**32)
        else:
            registers.append(rng.getrandbits(32))
    registers += [STACK - 4 * rng.randint(16, 80), rng.getrandbits(32)]
    memory = rng.randbytes(BYTES), rng.randbytes(2 * BYTES)
    return State(registers, rng.getrandbits(4), *memory)


def is_access(code: bytes) -> bool:
    """Return whether an instruction may read or write memory."""
    halves = int.from_bytes(code[:2], "little"), int.from_bytes(code[2:], "little")
    return decode(*halves, in_it=False).name[:2] in ("ld", "st", "pu")


def hold(chip: Chip, code: bytes, rng: random.Random, symbols: bool, steps: int = 1) -> str:
    """Run an instruction on both; return "" or why the machine does not decide.

    Raises:
        AssertionError: they differ.
    """
    access = is_access(code)
    state, fixed = draw_state(rng, access), rng.randbytes(BYTES)
    terms = make_terms(code, state, fixed, rng if symbols else None, access)
    machine = terms.machine
    try:
        for _ in range(steps):
            machine.step()
    except UndecidedError as error:
        return str(error)
    found = chip.run(code, state, fixed, steps)
    said = f"{code.hex()} {[hex(r) for r in state.registers]} {state.flags:04b}"
    if found is None:  # a branch to where nothing is
        assert abs(machine.at - CODE) > 1 << 24, said
        return "the core stops"
    assert machine.at in (found.at, -1), said
    for k in range(15):
        assert terms.word(machine.registers[k]) == found.registers[k], f"r{k}: {said}"
    flags = machine.flags
    for k, flag in enumerate((flags.n, flags.z, flags.c, flags.v)):
        try:
            assert terms.word(flag()) == found.flags >> (3 - k) & 1, f"flag {k}: {said}"
        except UndecidedError:
            assert symbols, f"flag {k}: {said}"
    for area in machine.memory.areas.values():
        content, first = (found.data, 0) if area.name == "data" else (found.stack, -BYTES)
        for cells, size in ((area.words, 4), (area.halves, 2)):
            for at, cell in cells.items():
                here = int.from_bytes(content[at - first : at - first + size], "little")
                assert terms.word(cell) % 256**size == here, f"{area.name} {at}: {said}"
    return ""


def test_short_instructions(chip: Chip) -> None:
    hold_short_instructions(chip, 101, 1)


@pytest.mark.slow
def test_every_short_instruction(chip: Chip) -> None:
    hold_short_instructions(chip, 1, 20)


def hold_short_instructions(chip: Chip, stride: int, least: int) -> None:
    """Of the encodings of 16 bits every so many: what is decoded does what the core does."""
    rng, decided, known = random.Random(1), Counter[int](), 0
    for half in range(0, 29 << 11, stride):
        try:
            if decode(half, 0, False).name == "it":
                continue  # with the instruction after it, below
        except UndecidedError:
            continue
        known += 1
        why = hold(chip, half.to_bytes(2, "little"), rng, symbols=half % 2 == 1)
        decided[half >> 11] += not why
    assert known > 35_000 // stride
    for top in decided:
        assert decided[top] >= least, f"{top:05b}: {decided[top]}"


CASES = [(name, False) for name in LONG]
CASES += [(name, True) for name in LONG if name not in ("b.cond", "b.any", "uqadd8")]


@pytest.mark.spread(15, ("name", "symbols"), CASES)
def test_long_instructions(chip: Chip, name: str, symbols: bool) -> None:
    draw_long_instructions(chip, name, symbols, 60)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "symbols"), CASES)
def test_many_long_instructions(chip: Chip, name: str, symbols: bool) -> None:
    draw_long_instructions(chip, name, symbols, 4000)


def draw_long_instructions(chip: Chip, name: str, symbols: bool, count: int) -> None:
    """Draw until so many were decoded; some of them must be decided, of symbols at least one."""
    rng, decoded, decided = random.Random(f"{name} {symbols}"), 0, 0
    for _ in range(100 * count):
        first, second = draw_long(rng, LONG[name])
        try:
            decode(first, second, False)
        except UndecidedError:
            continue
        decoded += 1
        code = first.to_bytes(2, "little") + second.to_bytes(2, "little")
        decided += not hold(chip, code, rng, symbols)
        if decoded == count:
            break
    assert decided >= (1 if symbols else count // 20), f"{decided} of {decoded}"


def test_a_move_that_hangs_on_a_condition(chip: Chip) -> None:
    rng, decided = random.Random(3), 0
    for number in range(2000):
        move = (
            0x4600 | rng.choice((0x08, 0x13, 0x2C)) if number % 2 else 0x2000 | rng.getrandbits(10)
        )
        it = 0xBF08 | rng.randrange(14) << 4
        code = it.to_bytes(2, "little") + move.to_bytes(2, "little")
        decided += not hold(chip, code, rng, number % 3 == 0, steps=2)
    assert decided > 1000


def test_words_that_are_no_instruction_are_refused() -> None:
    """VADD, LDREX, SVC, BKPT, CPS, WFI, BLX, TBB, SDIV, MRS."""
    for first, second in ((0xEE30, 0x0A00), (0xE850, 0x0F00), (0xDF00, 0), (0xBE00, 0), (0xB672, 0),
                          (0xBF30, 0), (0x4780, 0), (0xE8D0, 0xF001), (0xFB90, 0xF0F1),
                          (0xF3EF, 0x8000)):  # fmt: skip
        with pytest.raises(UndecidedError, match="no instruction"):
            decode(first, second, False)
    assert CODE
