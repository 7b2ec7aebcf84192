"""Known assembly of Armv7E-M and Armv8-M with DSP: how the tables of tanh and sigmoid are read.

Shares no code with the generator and needs the standard library only.
"""

from collections.abc import Iterator, Sequence

HALF_LINES = 178
"""Of the table that is read at -Os."""
LIMIT = 256 - HALF_LINES


def find_tables(small: bool) -> Iterator[str]:
    """r5, r6 <- offsets and slopes of tanh, r7 <- offsets of the sigmoid; at -Os its limit."""
    tables: tuple[str, ...]
    if small:
        tables = (f"tanh_half_offset_q30 - {4 * LIMIT}", f"tanh_half_slope_q19 - {2 * LIMIT}")
    else:
        tables = ("tanh_offset_q30 + 1024", "tanh_slope_q19 + 512", "sigmoid_offset_q31 + 1024")
    for register, table in zip(("r5", "r6", "r7"), tables, strict=False):
        yield f"movw {register}, #:lower16:(zd_{table})"
        yield f"movt {register}, #:upper16:(zd_{table})"
    if small:
        yield f"movs r7, #{LIMIT}"


def activate(k: int, shift: int, small: bool, half: bool) -> Iterator[str]:
    """tanh of r<k> >> shift, or the sigmoid of twice that."""
    if small:
        yield from _limited(k, shift)
        yield from _line_of_half(k)
        yield f"adc r{k}, r{k}, #{'0x40000000' if half else '0'}"
        return
    yield from _line_of_all(k, shift, half)


def _shifted(shift: int) -> str:
    return f", asr #{shift}" if shift else ""


def _line_of_all(k: int, shift: int, half: bool) -> Iterator[str]:
    yield from (f"ssat r{k}, #20, r{k}{_shifted(shift)}", f"asr r5, r{k}, #11")
    yield from _look_up(k, half)


def _look_up(k: int, half: bool) -> Iterator[str]:
    yield from (f"ldr r6, [r{10 if half else 8}, r5, lsl #2]", "ldrsh lr, [r9, r5, lsl #1]")
    yield f"mla r{k}, lr, r{k}, r6"


def keep_update(to: int, shift: int) -> str:
    """What makes of a_u its table's argument, or 0 towards rest; u_keep where that needs none."""
    return f"and r{to}, r3, #{2 ** (32 - shift)}" if shift > 1 else f"mov r{to}, r3"


def update(keep: int, shift: int, small: bool) -> Iterator[str]:
    """u_q31, or 1/2, from r2."""
    if small:
        if shift > 1:
            yield from (f"smmul r2, r2, r{keep}", "eors r5, r2, r2, asr #31")
            yield "usat r5, #8, r5, asr #11"
        else:
            yield f"and r2, r2, r{keep}"
            yield from _limited(2, shift)
        yield from _line_of_half(2)
        yield "adc r2, r2, #0x40000000"
        return
    if shift > 1:
        yield from (f"smmul r2, r2, r{keep}", "ssat r5, #9, r2, asr #11")
        yield from _look_up(2, half=True)
    else:
        yield f"and r2, r2, r{keep}"
        yield from _line_of_all(2, shift, half=True)


def gates_of_all(shifts: Sequence[int]) -> Iterator[str]:
    """r3 <- what a GRU\'s state moves towards, r2 <- how far, by the whole table."""
    yield from _line_of_all(1, shifts[0], half=True)
    yield "smmlar r3, r4, r1, r3"
    yield from update(11, shifts[1], small=False)
    yield from _line_of_all(3, shifts[2], half=False)


def _limited(k: int, shift: int) -> Iterator[str]:
    yield from (f"ssat r{k}, #20, r{k}{_shifted(shift)}", f"asr r5, r{k}, #11")
    yield f"eors r5, r5, r{k}, asr #31"


def _line_of_half(k: int) -> Iterator[str]:
    yield from ("uqadd8 r5, r5, r10", "ldr r6, [r8, r5, lsl #2]", "ldrh lr, [r9, r5, lsl #1]")
    yield from (f"eor r6, r6, r{k}, asr #31", f"mla r{k}, lr, r{k}, r6")


def gates_of_half(shifts: Sequence[int]) -> Iterator[str]:
    """The same by half of the table."""
    yield from _limited(1, shifts[0])
    yield from _line_of_half(1)
    yield from ("adc r1, r1, #0x40000000", "smmlar r3, r4, r1, r3")
    yield from update(11, shifts[1], small=True)
    yield from _limited(3, shifts[2])
    yield from _line_of_half(3)
    yield "adc r3, r3, #0"
