"""Known assembly of Armv6-M and Armv8-M baseline (Cortex-M0, M0+, M23), line by line."""

from collections.abc import Iterator, Sequence

HALF_LINES = 178
"""Of the table that is read at -Os."""


def write_gru(
    name: str, inputs: int, hidden: int, shifts: Sequence[int], small: bool
) -> Iterator[str]:
    """Reset after the product, 16-bit weights."""
    x_pairs, h_pairs = (inputs + 1) // 2, (hidden + 1) // 2
    frame = 12 + 8 * (x_pairs + h_pairs)
    yield from _enter(name, frame)
    yield from ("str r3, [sp, #4]", "str r1, [sp, #8]")
    yield from _pack(inputs, hidden, 12)
    yield from ("3:", "ldm r0!, {r1-r4}")
    yield from (f"mov r{7 + k}, r{k}" for k in range(1, 5))
    yield "add r1, sp, #12"
    yield from _dot_of_words(x_pairs, ("r8", "r9", "r10"), 8 * x_pairs + 12, "4")
    yield from _dot_of_words(h_pairs, ("r8", "r9", "r11"), 8 * (x_pairs + h_pairs) + 12, "5")
    yield "mov r1, r8"
    yield from _then_tanh(shifts[0])
    yield from ("movs r2, #1", "lsls r2, r2, #30", "adds r2, r2, r1", "mov r1, r11", "bl 7f")
    yield from ("add r10, r1", "mov r1, r9")
    yield from _then_tanh(shifts[1])
    yield from ("ldr r2, [sp, #4]", "ands r1, r1, r2", "movs r2, #1", "lsls r2, r2, #30")
    yield from ("adds r1, r1, r2", "mov r9, r1", "mov r1, r10")
    yield from _then_tanh(shifts[2])
    yield from ("ldr r6, [sp, #8]", "ldr r7, [r6]", "subs r1, r1, r7", "mov r2, r9", "bl 7f")
    yield from ("lsls r1, r1, #1", "adds r7, r7, r1", "stm r6!, {r7}", "str r6, [sp, #8]")
    yield from ("ldr r1, [sp]", "cmp r6, r1", "beq 8f", "b 3b", "8:")
    yield from _leave(frame)
    yield from _tanh(small)
    yield from HIGH_PRODUCT
    yield from _tables(small)


def write_gru_before(
    name: str, inputs: int, hidden: int, shifts: Sequence[int], small: bool
) -> Iterator[str]:
    """Reset before the product, 16-bit weights: r and u of all units, then n of all."""
    x_pairs, h_pairs = (inputs + 1) // 2, (hidden + 1) // 2
    end_x = 16 + 8 * x_pairs
    at_rh = end_x + 8 * h_pairs
    frame = at_rh + 16 * h_pairs + 4
    yield from _enter(name, frame)
    yield from ("str r3, [sp, #4]", "str r1, [sp, #8]")
    yield from _pack(inputs, hidden, 16)
    yield from ("str r4, [sp, #12]", "3:", "ldm r0!, {r1, r2}", "mov r8, r1", "mov r9, r2")
    yield "add r1, sp, #16"
    yield from _dot_of_words(x_pairs, ("r8", "r9"), end_x, "4")
    yield from _dot_of_words(h_pairs, ("r8", "r9"), at_rh, "5")
    yield from ("ldr r6, [sp, #12]", "mov r1, r9")
    yield from _then_tanh(shifts[1])
    yield from ("ldr r2, [sp, #4]", "ands r1, r1, r2", "movs r2, #1", "lsls r2, r2, #30")
    yield from (
        "adds r1, r1, r2",
        f"movs r2, #{4 * h_pairs}",
        "lsls r2, r2, #1",
        "str r1, [r6, r2]",
    )
    yield "mov r1, r8"
    yield from _then_tanh(shifts[0])
    yield from ("movs r2, #1", "lsls r2, r2, #30", "adds r2, r2, r1", "movs r5, #0", "mov r12, r5")
    yield from ("ldr r7, [sp, #8]", "ldm r7!, {r1}", "str r7, [sp, #8]", "bl 7f", "movs r2, #1")
    yield from ("lsls r2, r2, #13", "adds r1, r1, r2", "asrs r1, r1, #14", "stm r6!, {r1}")
    yield from ("str r6, [sp, #12]", "ldr r1, [sp]", "cmp r7, r1", "beq 8f", "b 3b", "8:")
    if hidden % 2:
        yield from ("movs r1, #0", "stm r6!, {r1}", "str r6, [sp, #12]")
    yield from (f"movs r1, #{hidden}", "lsls r1, r1, #2", "subs r7, r7, r1", "str r7, [sp, #8]")
    yield from ("11:", "ldm r0!, {r1}", "mov r8, r1", "add r1, sp, #16")
    yield from _dot_of_words(x_pairs, ("r8",), end_x, "4")
    yield f"add r1, sp, #{at_rh}"
    yield from _dot_of_words(h_pairs, ("r8",), at_rh + 8 * h_pairs, "5")
    yield "mov r1, r8"
    yield from _then_tanh(shifts[2])
    yield from ("ldr r6, [sp, #12]", "ldm r6!, {r2}", "str r6, [sp, #12]", "ldr r6, [sp, #8]")
    yield from ("ldr r7, [r6]", "subs r1, r1, r7", "movs r5, #1", "lsls r5, r5, #15")
    yield from ("mov r12, r5", "bl 7f", "lsls r1, r1, #1", "adds r7, r7, r1", "stm r6!, {r7}")
    yield from ("str r6, [sp, #8]", "ldr r1, [sp]", "cmp r6, r1", "beq 12f", "b 11b", "12:")
    yield from _leave(frame)
    yield from _tanh(small)
    at = HIGH_PRODUCT.index("movs r5, #1")
    yield from (*HIGH_PRODUCT[:at], "add r2, r12", *HIGH_PRODUCT[at + 3 :])
    yield from _tables(small)


def write_lstm(
    name: str, sizes: tuple[int, int], shifts: Sequence[int], bits: int, small: bool
) -> Iterator[str]:
    """The LSTM with 16-bit weights, of so many inputs and units and bits of the cell state."""
    inputs, hidden = sizes
    end_x = 12 + 8 * ((inputs + 1) // 2)
    frame = end_x + 8 * ((hidden + 1) // 2)
    all_four = ("r8", "r9", "r10", "r11")
    yield from _enter(name, frame)
    yield from ("str r3, [sp, #4]", "str r1, [sp, #8]")
    yield from _pack(inputs, hidden, 12)
    yield from ("3:", "ldm r0!, {r1-r4}", *(f"mov {s}, r{k}" for k, s in enumerate(all_four, 1)))
    yield "add r1, sp, #12"
    yield from _dot_of_words((inputs + 1) // 2, all_four, end_x, "4")
    yield from _dot_of_words((hidden + 1) // 2, all_four, frame, "5")
    yield from ("movs r7, #1", "lsls r7, r7, #30", "mov r1, r10")
    yield from _then_tanh(shifts[2])
    yield from ("mov r10, r1", "mov r1, r8")
    yield from _then_tanh(shifts[0])
    yield from ("adds r2, r7, r1", "mov r1, r10", "bl 7f")
    yield from (f"adds r1, #{1 << (29 - bits)}", f"asrs r1, r1, #{30 - bits}", "mov r8, r1")
    yield "mov r1, r11"
    yield from _then_tanh(shifts[3])
    yield from ("adds r2, r7, r1", "mov r11, r2", "mov r1, r9")
    yield from _then_tanh(shifts[1])
    yield from ("ldr r6, [sp, #4]", f"ldr r3, [sp, #{frame + 36}]", "cmp r3, #0", "bne 11f")
    yield from ("adds r2, r7, r1", "ldr r1, [r6]")
    yield from ("bl 7f", "add r1, r8", *CELL_IN_TIME, "13:", "stm r6!, {r1}", "str r6, [sp, #4]")
    yield from ("movs r2, #1", f"lsls r2, r2, #{bits - 17}", "adds r1, r1, r2")
    yield from _then_tanh(bits - 16)
    yield from ("mov r2, r11", "bl 7f", "lsls r1, r1, #1", "ldr r6, [sp, #8]", "stm r6!, {r1}")
    yield from ("str r6, [sp, #8]", "ldr r1, [sp]", "cmp r6, r1", "beq 8f", "b 3b", "8:")
    yield from _leave(frame)
    yield from CELL_TOWARDS_REST
    yield from _tanh(small)
    yield from HIGH_PRODUCT
    yield from _tables(small)


def _enter(name: str, frame: int) -> Iterator[str]:
    yield from (".syntax unified", f".set zd_stack_{name}, {frame + 36}", "push {r4-r7, lr}")
    yield from (f"mov r{k}, r{k + 4}" for k in range(4, 8))
    yield "push {r4-r7}"
    yield from (f"sub sp, #{part}" for part in _split(frame))


def _split(frame: int) -> list[int]:
    return [frame] if frame <= 508 else [508, frame - 508]


def _leave(frame: int) -> Iterator[str]:
    yield from (f"add sp, #{part}" for part in _split(frame))
    yield "pop {r4-r7}"
    yield from (f"mov r{k + 4}, r{k}" for k in range(4, 8))
    yield "pop {r4-r7, pc}"


def _tanh(small: bool) -> Iterator[str]:
    yield from ("6:", "asrs r2, r1, #31", *(HALF_TANH if small else ALL_TANH))


def _tables(small: bool) -> Iterator[str]:
    prefix, ends = ("half_", ("", "")) if small else ("", (" + 512", " + 1024"))
    yield from (".align 2", "9:", f".word zd_tanh_{prefix}slope_q19{ends[0]}", "10:")
    yield f".word zd_tanh_{prefix}offset_q30{ends[1]}"


def _pack(inputs: int, hidden: int, first: int) -> Iterator[str]:
    """Features and rounded state, a word each."""
    yield from (f"add r4, sp, #{first}", "movs r5, #0", "1:")
    yield from ("ldrsh r6, [r2, r5]", "stm r4!, {r6}", "adds r5, #2", f"cmp r5, #{2 * inputs}")
    yield "bne 1b"
    if inputs % 2:
        yield from ("movs r6, #0", "stm r4!, {r6}")
    yield from ("movs r5, #1", "lsls r5, r5, #14")
    if hidden < 64:
        yield f"movs r6, #{4 * hidden}"
    else:
        yield from (f"movs r6, #{hidden}", "lsls r6, r6, #2")
    yield from ("adds r6, r6, r1", "str r6, [sp]", "2:")
    if hidden % 2:
        yield from ("ldm r1!, {r2}", "adds r2, r2, r5", "asrs r2, r2, #15", "stm r4!, {r2}")
    else:
        yield from ("ldm r1!, {r2, r3}", "adds r2, r2, r5", "adds r3, r3, r5")
        yield from ("asrs r2, r2, #15", "asrs r3, r3, #15", "stm r4!, {r2, r3}")
    yield from ("cmp r1, r6", "bne 2b")
    if hidden % 2:
        yield from ("movs r2, #0", "stm r4!, {r2}")


HALF_TANH = (
    *("asrs r4, r1, #11", "eors r4, r4, r2", f"movs r3, #{HALF_LINES - 1}", "subs r3, r3, r4"),
    *("asrs r5, r3, #31", "ands r3, r3, r5", "adds r4, r4, r3", "lsls r4, r4, #1", "ldr r3, 9f"),
    *("ldrh r3, [r3, r4]", "lsls r4, r4, #1", "ldr r5, 10f", "ldr r5, [r5, r4]"),
    *("eors r5, r5, r2", "subs r5, r5, r2", "muls r1, r3, r1", "adds r1, r1, r5", "bx lr"),
)
ALL_TANH = (
    *("asrs r3, r1, #19", "eors r3, r3, r2", "rsbs r3, r3, #0", "asrs r3, r3, #31"),
    *("asrs r4, r1, #11", "movs r5, #255", "eors r5, r5, r2", "eors r5, r5, r4"),
    *("ands r5, r5, r3", "eors r4, r4, r5", "lsls r4, r4, #1", "ldr r3, 9f"),
    *("ldrsh r3, [r3, r4]", "lsls r4, r4, #1", "ldr r2, 10f", "ldr r2, [r2, r4]"),
    *("muls r1, r3, r1", "adds r1, r1, r2", "bx lr"),
)
HIGH_PRODUCT = (
    *("7:", "asrs r3, r1, #16", "uxth r1, r1", "asrs r4, r2, #16", "uxth r2, r2"),
    *("movs r5, r2", "muls r5, r1, r5", "lsrs r5, r5, #16", "muls r2, r3, r2"),
    *("adds r2, r2, r5", "movs r5, #1", "lsls r5, r5, #15", "adds r2, r2, r5"),
    *("muls r1, r4, r1", "muls r3, r4, r3", "uxth r5, r2", "adds r1, r1, r5"),
    *("asrs r2, r2, #16", "asrs r1, r1, #16", "adds r1, r1, r2", "adds r1, r1, r3", "bx lr"),
)
CELL_IN_TIME = (
    *("lsrs r2, r7, #1", "subs r1, r1, r2", "asrs r3, r1, #31", "ands r1, r1, r3"),
    *("adds r1, r1, r2", "adds r1, r1, r2", "asrs r3, r1, #31", "bics r1, r1, r3"),
    *("subs r1, r1, r2", "lsls r1, r1, #1"),
)
"""Limited to 2^29 on either side, then doubled."""
CELL_TOWARDS_REST = (
    *("11:", "subs r7, r7, r1", "ldr r1, [r6]", "mov r2, r7", "bl 7f", "mov r2, r8"),
    *("subs r1, r2, r1", "movs r3, #0", "movs r4, #1", "lsls r4, r4, #30"),
    *("12:", "subs r5, r7, r4", "asrs r5, r5, #31", "subs r3, r3, r5", "lsrs r4, r4, #1"),
    *("lsrs r5, r4, #16", "bne 12b", "movs r4, #1", "lsls r4, r4, r3", "ldr r2, [r6]"),
    *("movs r5, #1", "lsls r5, r5, #30", "subs r2, r2, r5", "movs r3, r1", "muls r3, r4, r3"),
    *("adds r3, r3, r2", "uxth r5, r1", "muls r5, r4, r5", "uxth r7, r2", "adds r5, r5, r7"),
    *("lsrs r5, r5, #16", "asrs r1, r1, #16", "muls r1, r4, r1", "asrs r2, r2, #16"),
    *("adds r1, r1, r2", "adds r1, r1, r5", "asrs r1, r1, #16", "asrs r2, r1, #31"),
    *("ands r3, r3, r2", "ands r1, r1, r2", "movs r2, #0", "movs r4, #1", "lsls r4, r4, #31"),
    *("adds r3, r3, r4", "adcs r1, r1, r2", "asrs r1, r1, #31", "bics r3, r3, r1"),
    *("lsrs r4, r4, #1", "subs r1, r3, r4", "b 13b"),
)
"""By a quarter to half of the distance, limited to 2^30 on either side."""


def _then_tanh(shift: int) -> Iterator[str]:
    if shift:
        yield f"asrs r1, r1, #{shift}"
    yield "bl 6f"


def _dot_of_words(pairs: int, totals: Sequence[str], end: int, label: str) -> Iterator[str]:
    """A row for each total; blocks of two pairs in a loop, a last odd one after it."""
    blocks = pairs // 2
    if blocks > 1:
        yield from (f"add r2, sp, #{end - 8 * (pairs % 2)}", "mov lr, r2", f"{label}:")
    if blocks:
        yield from ("ldm r1!, {r2-r5}", "mov r12, r1")
        for total in totals:
            yield "ldm r0!, {r6, r7}"
            yield from _mac_pair("r6", "r2", "r3", "r1", total)
            yield from _mac_pair("r7", "r4", "r5", "r1", total)
        yield "mov r1, r12"
    if blocks > 1:
        yield from ("cmp r1, lr", f"bne {label}b")
    if pairs % 2:
        yield "ldm r1!, {r2, r3}"
        for some in (totals[:3], totals[3:]):
            if some:
                last = f"r4-r{3 + len(some)}" if len(some) > 1 else "r4"
                yield f"ldm r0!, {{{last}}}"
            for k, total in enumerate(some, 4):
                yield from _mac_pair(f"r{k}", "r2", "r3", "r7", total)


def _mac_pair(w: str, a: str, b: str, free: str, total: str) -> Iterator[str]:
    yield from (f"sxth {free}, {w}", f"muls {free}, {a}, {free}", f"add {total}, {free}")
    yield from (f"asrs {w}, {w}, #16", f"muls {w}, {b}, {w}", f"add {total}, {w}")
