"""The assembly of the kernel for pairs: the one text that is known for a layer of some shape.

There are no rules for instructions. What is known is what the emulated cores have been compared
with, bit for bit; it is stated here a second time, and anything else is refused. Shares no code
with the generator and needs the standard library only.
"""

from collections.abc import Iterator, Mapping, Sequence

from zerodrift.verify.c_gru import PAIRS, GruStep, run_packed
from zerodrift.verify.c_intervals import IntervalMachine
from zerodrift.verify.c_values import (
    FaultError,
    Found,
    NotUnderstoodError,
    Pointer,
    Struct,
    Value,
    make_block,
)

HALF_LINES = 178
"""Of the table that is read at -Os."""
MOST_INPUTS, MOST_UNITS = 32, 128


NAMES = {
    f"ZD_TANH_{half}{field}_NAME": f"zd_tanh_{half.lower()}{field.lower()}_{digits}"
    for half in ("", "HALF_")
    for field, digits in (("OFFSET", "q30"), ("SLOPE", "q19"))
}
"""Macros of the runtime: what a table is called where the linker sees it."""


Text = tuple[Mapping[str, int], Mapping[str, tuple[str, ...]]]
"""What a build defines, and its functions of assembly."""


def run_assembly(
    machine: IntervalMachine, name: str, given: Sequence[Found], texts: list[Text]
) -> None:
    """Step a layer by a function of assembly, which must be the text that is known for its shape.

    Args:
        machine: stands at the call.
        name: of the function.
        given: stream, state, features, u_keep.
        texts: of every build for which the machine stands.

    Raises:
        NotUnderstoodError: another text, or more than assembly is written for.
        FaultError: arguments of other types, or another layer's.
    """
    layer = machine.constants.get(name.removesuffix("_assembly"))
    if not isinstance(layer, Struct) or layer.type != "zd_gru_pairs_t" or len(given) != 4:
        raise NotUnderstoodError(f"{name} belongs to no layer")
    rows = [p for p in given[:3] if isinstance(p, Pointer) and len(p.sizes) == 1]
    if len(rows) != 3:
        raise FaultError(f"{name} is given no arrays")
    (stream, h, x), u_keep = rows, machine.as_number(given[3])
    if stream != layer.tables["stream"] or h.constant or h.block.constant:
        raise FaultError(f"{name} is given other weights than its layer's, or a constant state")
    if (h.block.type, x.block.type) != ("int32_t", "int16_t"):
        raise FaultError(f"{name} is given other types than int32_t and int16_t")
    inputs, hidden = x.sizes[0], h.sizes[0]
    if inputs > MOST_INPUTS or hidden > MOST_UNITS:
        raise NotUnderstoodError(f"{name}: no assembly is known for {inputs} and {hidden}")
    shifts = [layer.fields["shift"].value(g).low for g in range(3)]
    for defined, assembly in texts:
        _require_known(name, inputs, hidden, shifts, defined, assembly.get(name, ()))
    scratch = make_block("scratch", "int32_t", [2 * (inputs + hidden + 2)], None)
    counts = (Value(inputs, inputs), Value(hidden, hidden))
    scratches = (Pointer(scratch, Value(0, 0), scratch.sizes),)
    run_packed(machine, PAIRS, layer, GruStep(*counts, x, h, scratches, u_keep))


def _require_known(
    name: str,
    inputs: int,
    hidden: int,
    shifts: list[int],
    defined: Mapping[str, int],
    written: tuple[str, ...],
) -> None:
    """Raise NotUnderstoodError unless the function is the text that is known for its shape."""
    small = "ZD_SMALL" in defined
    if defined["ZD_GRU_ASSEMBLY"] == 6:
        lines = list(_armv6m(name, inputs, hidden, shifts, small))
    else:
        lines = list(_armv7em(name, inputs, hidden, shifts, small, "ZD_UNALIGNED" in defined))
    text = "".join(NAMES.get(word, "") if word[0] != '"' else word[1:-1] for word in written)
    known = "".join(f"{line}\\n" for line in lines)
    if text != known:
        pairs = zip(text.split("\\n"), [*lines, ""], strict=False)
        found = next((f"'{a}' where '{b}' is known" for a, b in pairs if a != b), "too short")
        raise NotUnderstoodError(f"{name}: its assembly is another: {found}")


def _armv7em(
    name: str, inputs: int, hidden: int, shifts: list[int], small: bool, unaligned: bool
) -> Iterator[str]:
    limit = 256 - HALF_LINES
    x_pairs, h_pairs = (inputs + 1) // 2, (hidden + 1) // 2
    frame = 20 + 4 * (x_pairs + h_pairs)
    frame += (4 - frame % 8) % 8
    yield from (".syntax unified", f".set zd_stack_{name}, {frame + 36}", "push {r4-r11, lr}")
    yield from (f"sub sp, sp, #{frame}", f"add r4, r1, #{4 * hidden}")
    if small:
        tables = (f"half_offset_q30 - {4 * limit}", f"half_slope_q19 - {2 * limit}")
    else:
        tables = ("offset_q30 + 1024", "slope_q19 + 512")
    for register, table in zip(("r5", "r6"), tables, strict=True):
        yield f"movw {register}, #:lower16:(zd_tanh_{table})"
        yield f"movt {register}, #:upper16:(zd_tanh_{table})"
    if small:
        yield f"mov r7, #{limit}"
    if small and shifts[1] > 1:
        yield f"and r8, r3, #{2 ** (32 - shifts[1])}"
    else:
        yield "mov r8, r3"
    yield "stm sp, {r4-r8}"
    if inputs > 1 and unaligned:
        for i in range(0, inputs - 1, 2):
            yield from (f"ldr r4, [r2, #{2 * i}]", f"str r4, [sp, #{20 + 2 * i}]")
        if inputs % 2:
            yield f"ldrh r4, [r2, #{2 * inputs - 2}]"
            yield f"str r4, [sp, #{18 + 2 * inputs}]"
    else:
        for i in range(0, inputs, 2):
            yield f"ldrh r4, [r2, #{2 * i}]"
            if i + 1 < inputs:
                yield from (f"ldrh r5, [r2, #{2 * i + 2}]", "orr r4, r4, r5, lsl #16")
            yield f"str r4, [sp, #{20 + 2 * i}]"
    yield from ("mov r12, r1", f"add r3, sp, #{20 + 4 * x_pairs}", "mov lr, #32768")
    yield from _pack_state(hidden)
    yield "1:"
    yield from _dot(20, x_pairs, 3, "r1-r4, ")
    yield from _dot(20 + 4 * x_pairs, h_pairs, 4, "")
    yield "ldm sp, {r7-r11}"
    yield from _gates_of_half(shifts) if small else _gates_of_all(shifts)
    yield from ("ldr r4, [r12]", "sub r3, r3, r4", "smmulr r3, r3, r2", "add r4, r4, r3, lsl #1")
    yield from ("str r4, [r12], #4", "cmp r12, r7", "bne 1b")
    yield from (f"add sp, sp, #{frame}", "pop {r4-r11, pc}")


def _pack_state(hidden: int) -> Iterator[str]:
    """State to 16 bits, rounded, in pairs."""
    for _ in range(hidden // 8):
        yield "ldm r1!, {r4-r11}"
        yield from (f"add r{k}, lr, r{k}, lsl #1" for k in range(4, 12))
        yield from (f"pkhtb r{4 + k}, r{5 + 2 * k}, r{4 + 2 * k}, asr #16" for k in range(4))
        yield "stm r3!, {r4-r7}"
    for _ in range(hidden // 8 * 8, hidden - 1, 2):
        yield from ("ldrd r4, r5, [r1], #8", "add r4, lr, r4, lsl #1", "add r5, lr, r5, lsl #1")
        yield from ("pkhtb r4, r5, r4, asr #16", "str r4, [r3], #4")
    if hidden % 2:
        yield from ("ldr r4, [r1]", "add r4, lr, r4, lsl #1", "lsr r4, r4, #16", "str r4, [r3]")


def _dot(offset: int, pairs: int, third: int, before: str) -> Iterator[str]:
    """Sums r1, r2 and r<third>; `before` is loaded with the first weights."""
    for i in range(0, pairs - 1, 2):
        yield f"ldrd r5, r6, [sp, #{offset + 4 * i}]"
        yield f"ldm r0!, {{{before if i == 0 else ''}r7-r11, lr}}"
        for total, weights in ((1, ("r7", "r8")), (2, ("r9", "r10")), (third, ("r11", "lr"))):
            for v, w in zip(("r5", "r6"), weights, strict=True):
                yield f"smlad r{total}, {v}, {w}, r{total}"
    if pairs % 2:
        yield f"ldr r5, [sp, #{offset + 4 * (pairs - 1)}]"
        yield f"ldm r0!, {{{before if pairs == 1 else ''}r7-r9}}"
        for total, k in ((1, 7), (2, 8), (third, 9)):
            yield f"smlad r{total}, r5, r{k}, r{total}"


def _shifted(shift: int) -> str:
    return f", asr #{shift}" if shift else ""


def _line_of_all(k: int, shift: int) -> Iterator[str]:
    yield from (f"ssat r{k}, #20, r{k}{_shifted(shift)}", f"asr r5, r{k}, #11")
    yield from ("ldr r6, [r8, r5, lsl #2]", "ldrsh lr, [r9, r5, lsl #1]")
    yield f"mla r{k}, lr, r{k}, r6"


def _gates_of_all(shifts: list[int]) -> Iterator[str]:
    yield from _line_of_all(1, shifts[0])
    yield from ("add r1, r1, #0x40000000", "smmlar r3, r4, r1, r3")
    yield from _line_of_all(2, shifts[1])
    yield from ("and r2, r2, r11", "add r2, r2, #0x40000000")
    yield from _line_of_all(3, shifts[2])


def _limited(k: int, shift: int) -> Iterator[str]:
    yield from (f"ssat r{k}, #20, r{k}{_shifted(shift)}", f"asr r5, r{k}, #11")
    yield f"eors r5, r5, r{k}, asr #31"


def _line_of_half(k: int) -> Iterator[str]:
    yield from ("uqadd8 r5, r5, r10", "ldr r6, [r8, r5, lsl #2]", "ldrh lr, [r9, r5, lsl #1]")
    yield from (f"eor r6, r6, r{k}, asr #31", f"mla r{k}, lr, r{k}, r6")


def _gates_of_half(shifts: list[int]) -> Iterator[str]:
    yield from _limited(1, shifts[0])
    yield from _line_of_half(1)
    yield from ("adc r1, r1, #0x40000000", "smmlar r3, r4, r1, r3")
    if shifts[1] > 1:
        yield from ("smmul r2, r2, r11", "eors r5, r2, r2, asr #31", "usat r5, #8, r5, asr #11")
    else:
        yield "and r2, r2, r11"
        yield from _limited(2, shifts[1])
    yield from _line_of_half(2)
    yield "adc r2, r2, #0x40000000"
    yield from _limited(3, shifts[2])
    yield from _line_of_half(3)
    yield "adc r3, r3, #0"


def _armv6m(name: str, inputs: int, hidden: int, shifts: list[int], small: bool) -> Iterator[str]:
    x_pairs, h_pairs = (inputs + 1) // 2, (hidden + 1) // 2
    frame = 12 + 8 * (x_pairs + h_pairs)
    parts = [frame] if frame <= 508 else [508, frame - 508]
    yield from (".syntax unified", f".set zd_stack_{name}, {frame + 36}", "push {r4-r7, lr}")
    yield from (f"mov r{k}, r{k + 4}" for k in range(4, 8))
    yield "push {r4-r7}"
    yield from (f"sub sp, #{part}" for part in parts)
    yield from ("str r3, [sp, #4]", "str r1, [sp, #8]", "add r4, sp, #12", "movs r5, #0", "1:")
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
    yield from ("3:", "ldm r0!, {r1-r4}")
    yield from (f"mov r{7 + k}, r{k}" for k in range(1, 5))
    yield "add r1, sp, #12"
    yield from _dot_of_words(x_pairs, "r10", 8 * x_pairs + 12, "4")
    yield from _dot_of_words(h_pairs, "r11", 8 * (x_pairs + h_pairs) + 12, "5")
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
    yield from (f"add sp, #{part}" for part in parts)
    yield "pop {r4-r7}"
    yield from (f"mov r{k + 4}, r{k}" for k in range(4, 8))
    yield from ("pop {r4-r7, pc}", "6:", "asrs r2, r1, #31")
    yield from (HALF_TANH if small else ALL_TANH)
    yield from HIGH_PRODUCT
    prefix, ends = ("half_", ("", "")) if small else ("", (" + 512", " + 1024"))
    yield from (".align 2", "9:", f".word zd_tanh_{prefix}slope_q19{ends[0]}", "10:")
    yield f".word zd_tanh_{prefix}offset_q30{ends[1]}"


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


def _then_tanh(shift: int) -> Iterator[str]:
    if shift:
        yield f"asrs r1, r1, #{shift}"
    yield "bl 6f"


def _dot_of_words(pairs: int, third: str, end: int, label: str) -> Iterator[str]:
    """Sums r8, r9 and `third`; blocks of two pairs in a loop, a last odd one after it."""
    blocks = pairs // 2
    if blocks > 1:
        yield from (f"add r2, sp, #{end - 8 * (pairs % 2)}", "mov lr, r2", f"{label}:")
    if blocks:
        yield from ("ldm r1!, {r2-r5}", "mov r12, r1")
        for total in ("r8", "r9", third):
            yield "ldm r0!, {r6, r7}"
            yield from _mac_pair("r6", "r2", "r3", "r1", total)
            yield from _mac_pair("r7", "r4", "r5", "r1", total)
        yield "mov r1, r12"
    if blocks > 1:
        yield from ("cmp r1, lr", f"bne {label}b")
    if pairs % 2:
        yield from ("ldm r1!, {r2, r3}", "ldm r0!, {r4-r6}")
        for k, total in enumerate(("r8", "r9", third), 4):
            yield from _mac_pair(f"r{k}", "r2", "r3", "r7", total)


def _mac_pair(w: str, a: str, b: str, free: str, total: str) -> Iterator[str]:
    yield from (f"sxth {free}, {w}", f"muls {free}, {a}, {free}", f"add {total}, {free}")
    yield from (f"asrs {w}, {w}, #16", f"muls {w}, {b}, {w}", f"add {total}, {w}")
