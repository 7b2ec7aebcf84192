"""Known assembly of Armv7E-M and Armv8-M with DSP (Cortex-M4, M7, M33), line by line.

Known assembly of Armv7E-M and Armv8-M with DSP: how the tables of tanh and sigmoid are read.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

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


PUSHED = 36
"""Bytes of the registers that a function saves."""


@dataclass(frozen=True)
class LayerShape:
    """What a function of assembly is written for, and how it is built."""

    name: str
    """Of the function."""
    inputs: int
    hidden: int
    shifts: Sequence[int]
    small: bool
    unaligned: bool

    @property
    def x_pairs(self) -> int:
        """Words that hold the features, two in each."""
        return (self.inputs + 1) // 2

    @property
    def h_pairs(self) -> int:
        """Words that hold the state."""
        return (self.hidden + 1) // 2

    def frame(self, constants: int, further: int = 0) -> int:
        """Bytes of the stack frame: words of constants, the pairs, and further words."""
        size = 4 * (constants + self.x_pairs + self.h_pairs + further)
        return size + (4 - size % 8) % 8


def write_gru(layer: LayerShape) -> Iterator[str]:
    """Reset after the product, 16-bit weights: the stack is pushed block by block, downwards."""
    x, h = layer.x_pairs, layer.h_pairs
    beside = x if x <= 4 else 0  # pairs of features that are pushed with the constants
    unused = (x + h) % 2  # words: what is saved and pushed makes whole eights of bytes
    at_h = 20 + 4 * (beside + unused)
    x_at = _stack_up(20, x, x) if beside else _stack_up(at_h + 4 * h, x, 8)
    h_at = _stack_up(at_h, h, 4)
    frame = 4 * (5 + x + h + unused)
    yield from (".syntax unified", f".set zd_stack_{layer.name}, {frame + PUSHED}")
    yield "push {r4-r11, lr}"
    if not beside:
        for first in range(0, layer.inputs, 16):
            count = min(16, layer.inputs - first)
            yield from _load_features(layer, first, count, _registers(4, 8), "r12")
            yield _push(4, (count + 1) // 2)
    yield from _push_state(layer.hidden, layer.small)
    yield from find_tables(layer.small)
    yield keep_update(8, layer.shifts[1])
    further = ("r9", "r10", "r11", "r12", "lr")
    if beside:
        yield from _load_features(layer, 0, layer.inputs, further, "r4")
    yield f"push {{{', '.join(('r1', 'r5-r8', *further[: beside + unused]))}}}"
    yield from (f"sub r12, r1, #{4 * layer.hidden}", "1:")
    units = 1 if layer.small or layer.hidden % 2 else 4 if layer.hidden % 4 == 0 else 2
    if units > 1:
        yield f".rept {units}"
    yield from _dot(x_at, 3, "r1-r4, ")
    yield from _dot(h_at, 4, "")
    yield from _gates(layer)
    if units > 1:
        yield ".endr"
    yield from _end(frame)


def _registers(first: int, count: int) -> tuple[str, ...]:
    return tuple(f"r{k}" for k in range(first, first + count))


def _push(first: int, count: int) -> str:
    return f"push {{r{first}-r{first + count - 1}}}" if count > 1 else f"push {{r{first}}}"


def _stack_up(lowest: int, pairs: int, block: int) -> list[int]:
    """Where each pair lies from sp on, if blocks of so many were pushed one after another."""
    blocks = [range(i, min(i + block, pairs)) for i in range(0, pairs, block)]
    order = [i for each in reversed(blocks) for i in each]
    return [lowest + 4 * order.index(i) for i in range(pairs)]


def _load_features(
    layer: LayerShape, first: int, count: int, registers: Sequence[str], free: str
) -> Iterator[str]:
    """Pairs of features to registers."""
    for i, to in zip(range(first, first + count, 2), registers, strict=False):
        alone = i + 1 == first + count
        if layer.unaligned and count > 1 and not alone:
            yield f"ldr {to}, [r2, #{2 * i}]"
            continue
        yield f"ldrh {to}, [r2, #{2 * i}]"
        if not alone:
            yield from (f"ldrh {free}, [r2, #{2 * i + 2}]", f"orr {to}, {to}, {free}, lsl #16")


def _push_state(hidden: int, small: bool) -> Iterator[str]:
    """State to 16 bits, rounded, in pairs, pushed by eight units; r1 <- where it ends."""
    yield "mov lr, #32768"
    eights, looped = hidden // 8, small and hidden >= 16
    if looped:
        yield from (f"add r12, r1, #{32 * eights}", "9:")
    for _ in range(1 if looped else eights):
        yield from _pack_units(8)
        yield _push(4, 4)
    if looped:
        yield from ("cmp r1, r12", "bne 9b")
    if hidden % 8:
        yield from _pack_units(hidden % 8)
        yield _push(4, (hidden % 8 + 1) // 2)


def _pack_units(units: int) -> Iterator[str]:
    yield f"ldm r1!, {{r4-r{3 + units}}}" if units > 1 else "ldr r4, [r1], #4"
    yield from (f"add r{k}, lr, r{k}, lsl #1" for k in range(4, 4 + units))
    for k in range(units // 2):
        yield f"pkhtb r{4 + k}, r{5 + 2 * k}, r{4 + 2 * k}, asr #16"
    if units % 2:
        yield f"lsr r{4 + units // 2}, r{3 + units}, #16"


def _enter_gru(layer: LayerShape, frame: int) -> Iterator[str]:
    yield from _enter(layer, frame)
    yield keep_update(8, layer.shifts[1])
    yield "stm sp, {r4-r8}"
    yield from _pack(layer, 20)


def write_gru_of_bytes(layer: LayerShape, scales: Sequence[int]) -> Iterator[str]:
    """Reset after the product, 8-bit recurrent weights; `scales` are the multipliers' shifts."""
    at_h, fours = 20 + 4 * layer.x_pairs, -(-layer.hidden // 4)
    frame = layer.frame(5, 2 * fours - layer.h_pairs)
    yield from _enter_gru(layer, frame)
    if layer.h_pairs % 2:
        yield from ("mov r4, #0", f"str r4, [sp, #{at_h + 4 * layer.h_pairs}]")
    yield "1:"
    yield from _dot(range(20, at_h, 4), 3, "r1-r3, ")
    totals = ("r10", "r11", "lr")
    for four in range(fours):
        yield from (f"ldrd r8, r9, [sp, #{at_h + 8 * four}]", "ldm r0!, {r5-r7}")
        for word, total in zip(("r5", "r6", "r7"), totals, strict=True):
            yield from (f"sxtb16 r4, {word}", f"sxtb16 {word}, {word}, ror #8")
            yield f"smlad {total}, r8, r4, {total}" if four else f"smuad {total}, r8, r4"
            yield f"smlad {total}, r9, {word}, {total}"
    yield "ldm r0!, {r4, r7-r9}"
    for gate, (total, product) in enumerate(zip(("r1", "r2", "r4"), totals, strict=True)):
        yield f"smull r5, r6, {product}, r{7 + gate}"
        if scale := scales[gate]:
            yield from (f"lsrs r5, r5, #{scale}", f"adcs {total}, {total}, r5")
            yield f"add {total}, {total}, r6, lsl #{32 - scale}"
        else:
            yield f"add {total}, {total}, r5"
    yield from _gates(layer)
    yield from _end(frame)


def write_gru_before(layer: LayerShape) -> Iterator[str]:
    """Reset before the product, 16-bit weights: r and u of all units, then n of all."""
    hidden, shifts, small = layer.hidden, layer.shifts, layer.small
    at_h = 24 + 4 * layer.x_pairs
    at_rh = at_h + 4 * layer.h_pairs
    frame = layer.frame(6, layer.h_pairs + hidden)
    of_x, constants = _list_pairs(24, layer.x_pairs), "ldm sp, {r3, r7-r11}"
    yield from _enter(layer, frame)
    yield from (f"add r8, sp, #{at_rh + 4 * layer.h_pairs}", "sub r8, r8, r1")
    yield from (keep_update(3, shifts[1]), "stm sp, {r3-r8}")
    yield from _pack(layer, 24)
    yield from (f"add r4, sp, #{at_rh}", "1:")
    yield from _queue(2, [*of_x, *_list_pairs(at_h, layer.h_pairs)])
    yield constants
    yield from activate(1, shifts[0], small, half=True)
    yield from update(3, shifts[1], small)
    yield "str r2, [r12, r11]"
    yield from ("ldr r5, [r12], #4", "smmul r5, r5, r1", "add r5, r5, #8192", "asr r5, r5, #14")
    yield from ("strh r5, [r4], #2", "cmp r12, r7", "bne 1b")
    if hidden % 2:
        yield from ("mov r5, #0", "strh r5, [r4]")
    yield from (f"sub r12, r12, #{4 * hidden}", "2:")
    yield from _queue(1, [*of_x, *_list_pairs(at_rh, layer.h_pairs)])
    yield constants
    yield from activate(1, shifts[2], small, half=False)
    yield from ("ldr r2, [r12, r11]", "ldr r4, [r12]", "sub r1, r1, r4", "smmulr r1, r1, r2")
    yield from ("add r4, r4, r1, lsl #1", "str r4, [r12], #4", "cmp r12, r7", "bne 2b")
    yield from (f"add sp, sp, #{frame}", "pop {r4-r11, pc}")


def _gates(layer: LayerShape) -> Iterator[str]:
    """From the sums of a GRU's unit to its new state."""
    yield "ldm sp, {r7-r11}"
    yield from gates_of_half(layer.shifts) if layer.small else gates_of_all(layer.shifts)
    yield from ("ldr r4, [r12]", "sub r3, r3, r4", "smmulr r3, r3, r2", "add r4, r4, r3, lsl #1")
    yield "str r4, [r12], #4"


def _end(frame: int) -> Iterator[str]:
    """The loop's end and the function's."""
    yield from ("cmp r12, r7", "bne 1b", f"add sp, sp, #{frame}", "pop {r4-r11, pc}")


def write_lstm(layer: LayerShape, bits: int) -> Iterator[str]:
    """16-bit weights; `bits` are the cell state's fractional ones."""
    frame, at_h = layer.frame(6), 24 + 4 * layer.x_pairs
    yield from _enter_lstm(layer, frame)
    yield "1:"
    yield from _queue(4, [*_list_pairs(24, layer.x_pairs), *_list_pairs(at_h, layer.h_pairs)])
    yield from _leave_lstm(layer, bits, frame)


def write_lstm_of_bytes(layer: LayerShape, bits: int, scales: Sequence[int]) -> Iterator[str]:
    """8-bit recurrent weights; `scales` are the multipliers' shifts."""
    at_h, fours = 24 + 4 * layer.x_pairs, -(-layer.hidden // 4)
    frame = layer.frame(6, 2 * fours - layer.h_pairs)
    yield from _enter_lstm(layer, frame)
    if layer.h_pairs % 2:
        yield from ("mov r4, #0", f"str r4, [sp, #{at_h + 4 * layer.h_pairs}]")
    yield "1:"
    for four in range(fours):
        yield from (f"ldrd r8, r9, [sp, #{at_h + 8 * four}]", "ldm r0!, {r5-r7, r10}")
        for total, word in (("r1", "r5"), ("r2", "r6"), ("r3", "r7"), ("r4", "r10")):
            yield from (f"sxtb16 r11, {word}", f"sxtb16 {word}, {word}, ror #8")
            yield f"smlad {total}, r8, r11, {total}" if four else f"smuad {total}, r8, r11"
            yield f"smlad {total}, r9, {word}, {total}"
    yield "ldm r0!, {r5-r11, lr}"
    for k, (high, scale) in enumerate(zip(("r9", "r10", "r11", "lr"), scales, strict=True), 1):
        yield f"smull r{k}, {high}, r{k}, {high}"
        if scale:
            yield from (f"lsrs r{k}, r{k}, #{scale}", f"adcs r{k}, r{k}, r{4 + k}")
            yield f"add r{k}, r{k}, {high}, lsl #{32 - scale}"
        else:
            yield f"add r{k}, r{k}, r{4 + k}"
    yield from _queue(4, _list_pairs(24, layer.x_pairs), first="")
    yield from _leave_lstm(layer, bits, frame)


def _enter_lstm(layer: LayerShape, frame: int) -> Iterator[str]:
    yield from _enter(layer, frame)
    yield from ("sub r8, r3, r1", f"ldr r9, [sp, #{frame + PUSHED}]", "stm sp, {r4-r9}")
    yield from _pack(layer, 24)


def _leave_lstm(layer: LayerShape, bits: int, frame: int) -> Iterator[str]:
    """From the sums to cell state and output, in time and towards rest."""
    yield "ldm sp, {r7-r11}"
    for gate, shift in enumerate(layer.shifts):
        yield from activate(gate + 1, shift, layer.small, half=gate != 2)
    yield from ("ldr r5, [r12, r11]", "smmulr r3, r3, r1", f"add r3, r3, #{1 << (29 - bits)}")
    yield from ("ldr r6, [sp, #20]", "cbnz r6, 3f", "smmulr r6, r5, r2")
    yield from (f"add r3, r6, r3, asr #{30 - bits}", "ssat r3, #31, r3, lsl #1")
    yield from ("lsrs r5, r3, #1", "adc r3, r3, #0", "2:", "str r3, [r12, r11]")
    yield f"add r3, r3, #{1 << (bits - 17)}"
    yield from activate(3, bits - 16, layer.small, half=False)
    yield from ("smmulr r3, r3, r4", "lsl r3, r3, #1", "str r3, [r12], #4")
    yield from ("cmp r12, r7", "bne 1b", f"add sp, sp, #{frame}", "pop {r4-r11, pc}")
    yield from ("3:", f"asr r3, r3, #{30 - bits}", "rsb r2, r2, #0x80000000", "smmulr r6, r5, r2")
    yield from ("sub r3, r3, r6", "clz r6, r2", "sub r6, r6, #1", "mov lr, #1", "lsl lr, lr, r6")
    yield from ("smull r6, lr, r3, lr", "adds r6, r6, r5", "adc lr, lr, r5, asr #31")
    yield from ("mvn r3, #0x80000000", "eor r3, r3, lr, asr #31", "cmp lr, r6, asr #31", "it eq")
    yield from ("moveq r3, r6", "ssat r6, #31, r3", "sub r3, r6, r3", "sub r3, r6, r3, asr #31")
    yield "b 2b"


def _enter(layer: LayerShape, frame: int) -> Iterator[str]:
    """What is saved, where the state ends (r4) and where the tables lie (r5 - r7)."""
    yield from (".syntax unified", f".set zd_stack_{layer.name}, {frame + PUSHED}")
    yield from ("push {r4-r11, lr}", f"sub sp, sp, #{frame}", f"add r4, r1, #{4 * layer.hidden}")
    yield from find_tables(layer.small)


def _pack(layer: LayerShape, first: int) -> Iterator[str]:
    """Features at sp + first and the state behind them, in pairs; r12 <- the state."""
    inputs = layer.inputs
    if inputs > 1 and layer.unaligned:
        for i in range(0, inputs - 1, 2):
            yield from (f"ldr r4, [r2, #{2 * i}]", f"str r4, [sp, #{first + 2 * i}]")
        if inputs % 2:
            yield f"ldrh r4, [r2, #{2 * inputs - 2}]"
            yield f"str r4, [sp, #{first - 2 + 2 * inputs}]"
    else:
        for i in range(0, inputs, 2):
            yield f"ldrh r4, [r2, #{2 * i}]"
            if i + 1 < inputs:
                yield from (f"ldrh r5, [r2, #{2 * i + 2}]", "orr r4, r4, r5, lsl #16")
            yield f"str r4, [sp, #{first + 2 * i}]"
    yield from ("mov r12, r1", f"add r3, sp, #{first + 4 * layer.x_pairs}", "mov lr, #32768")
    yield from _pack_state(layer.hidden, layer.small)


def _list_pairs(first: int, pairs: int) -> list[tuple[int, int]]:
    """Where the blocks of a row lie from sp on, and whether each has one pair or two."""
    return [(first + 4 * i, min(2, pairs - i)) for i in range(0, pairs, 2)]


def _queue(rows: int, blocks: list[tuple[int, int]], first: str | None = None) -> Iterator[str]:
    """Sums r1 ... of so many rows, their `first` values and then the weights six at a time."""
    registers = ("r7", "r8", "r9", "r10", "r11", "lr")
    left = rows * sum(width for _, width in blocks)
    taken = 0
    if first is None:
        first = f"r1-r{rows}, " if rows > 1 else "r1, "
    for at, width in blocks:
        yield f"ldrd r5, r6, [sp, #{at}]" if width == 2 else f"ldr r5, [sp, #{at}]"
        for row in range(1, rows + 1):
            for k in range(width):
                if taken % 6 == 0:
                    some = registers[: left - taken]
                    listed = ", ".join(some)
                    yield (
                        f"ldm r0!, {{{'' if taken else first}{listed}}}"
                        if len(some) > 1
                        else "ldr r7, [r0], #4"
                    )
                yield f"smlad r{row}, r{5 + k}, {registers[taken % 6]}, r{row}"
                taken += 1


def _pack_state(hidden: int, small: bool) -> Iterator[str]:
    """State to 16 bits, rounded, in pairs."""
    eights, looped = hidden // 8, small and hidden >= 16
    if looped:
        yield from (f"add r2, r1, #{32 * eights}", "9:")
    for _ in range(1 if looped else eights):
        yield from _pack_units(8)
        yield "stm r3!, {r4-r7}"
    if looped:
        yield from ("cmp r1, r2", "bne 9b")
    for _ in range(hidden // 8 * 8, hidden - 1, 2):
        yield from ("ldrd r4, r5, [r1], #8", "add r4, lr, r4, lsl #1", "add r5, lr, r5, lsl #1")
        yield from ("pkhtb r4, r5, r4, asr #16", "str r4, [r3], #4")
    if hidden % 2:
        yield from ("ldr r4, [r1]", "add r4, lr, r4, lsl #1", "lsr r4, r4, #16", "str r4, [r3]")


def _dot(places: Sequence[int], third: int, before: str) -> Iterator[str]:
    """Sums r1, r2 and r<third> of pairs on the stack; `before` is loaded with the first weights."""
    pairs = len(places)
    for i in range(0, pairs - 1, 2):
        yield f"ldrd r5, r6, [sp, #{places[i]}]"
        yield f"ldm r0!, {{{before if i == 0 else ''}r7-r11, lr}}"
        for total, weights in ((1, ("r7", "r8")), (2, ("r9", "r10")), (third, ("r11", "lr"))):
            for v, w in zip(("r5", "r6"), weights, strict=True):
                yield f"smlad r{total}, {v}, {w}, r{total}"
    if pairs % 2:
        yield f"ldr r5, [sp, #{places[-1]}]"
        yield f"ldm r0!, {{{before if pairs == 1 else ''}r7-r9}}"
        for total, k in ((1, 7), (2, 8), (third, 9)):
            yield f"smlad r{total}, r5, r{k}, r{total}"
