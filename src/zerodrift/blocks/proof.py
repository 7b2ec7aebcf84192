"""No overflow, for any input codes and for any block of a set: the range rules over coefficients.

Each rule is that of the operation (`prove`, operations/NAME) with an interval in the place of every
number that a block holds. Sums are bounded in any order; rows of 16-bit weights by their L1 norm.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

from zerodrift.base.errors import CheckError
from zerodrift.base.records import OPTIONAL
from zerodrift.blocks.fields import FieldPlace
from zerodrift.blocks.gru import STREAM, prove_layer
from zerodrift.export.integer_model import IntegerModel
from zerodrift.operations.arithmetic import INT16_MAX, INT16_MIN, INT32_MAX
from zerodrift.operations.clip import IntegerClip
from zerodrift.operations.delay import IntegerDelay
from zerodrift.operations.dense import COPY_BITS, IntegerDense, IntegerFeatureDense
from zerodrift.operations.drift import IntegerDrift
from zerodrift.operations.exp2 import IntegerExp2
from zerodrift.operations.features import IntegerFeatures
from zerodrift.operations.formats import LOWPASS_FRACTION
from zerodrift.operations.gru import IntegerGruLayer
from zerodrift.operations.head import IntegerHead
from zerodrift.operations.input import IntegerInput
from zerodrift.operations.intervals import Bound, Interval
from zerodrift.operations.load import IntegerLoad
from zerodrift.operations.lowpass import IntegerLowpass
from zerodrift.operations.lowpass_after import IntegerLowpassAfter
from zerodrift.operations.node import IntegerNode
from zerodrift.operations.offset import IntegerOffset
from zerodrift.operations.play import IntegerPlay
from zerodrift.operations.product import IntegerProduct
from zerodrift.operations.sum import IntegerSum
from zerodrift.operations.tables import NODE_MAX, STEP_BITS

Proof = tuple[list[Interval], list[Bound]]


@dataclass(frozen=True)
class BlockField:
    """A field of a block and what its numbers may be."""

    place: FieldPlace
    low: int
    high: int
    norm: int = 0
    """Largest sum of the absolute values of each row; 0: no bound beside low and high."""
    row: int = 0
    """Numbers in a row of `norm`."""
    pairs: tuple[int, ...] = field(default=(), metadata=OPTIONAL)
    """Of a GRU's numbers: words of a row of features, and of the state; no sum of them may leave
    32 bits (`blocks/gru.py`)."""

    @property
    def interval(self) -> Interval:
        """What each number may be."""
        return Interval(self.low, self.high)


class _Known:
    """The intervals of one node's numbers: those of the block, else the model's own."""

    def __init__(self, node: IntegerNode, fields: Mapping[tuple[str, str], BlockField]) -> None:
        self._node, self._fields = node, fields

    def field(self, attribute: str) -> BlockField | None:
        """Return the block's field, if it holds this."""
        return self._fields.get((self._node.name, attribute))

    def of(self, attribute: str, own: int) -> Interval:
        """Return what a number may be."""
        field = self.field(attribute)
        return field.interval if field is not None else Interval(own, own)


def prove_set(model: IntegerModel, fields: Sequence[BlockField]) -> list[Bound]:
    """Return every bound that the arithmetic relies on, for any codes and any block of the set.

    Args:
        model: of the design; what no field holds is its own.
        fields: what blocks hold, and within what.

    Raises:
        CheckError: a bound does not hold for some block of the set.
    """
    by_place = {(f.place.node, f.place.attribute): f for f in fields}
    known: dict[str, list[Interval]] = {}
    bounds = [bound for by in model.conversions for bound in by.prove([])[1]]
    for node in model.nodes:
        rule = RULES.get(type(node))
        inputs = [known[name] for name in node.inputs]
        numbers = _Known(node, by_place)
        known[node.name], found = (
            rule(node, inputs, numbers) if rule is not None else node.prove(inputs)
        )
        bounds += found
    return [*bounds, *model.prove_times()]


def _saturate(x: Interval, low: Interval, high: Interval, where: str) -> Interval:
    """Return the limited x; every low is at most every high, so that limits never cross."""
    if low.high > high.low:
        raise CheckError(f"{where}: a lower limit of the set may lie above an upper one")
    return Interval(min(max(x.low, low.low), high.high), min(max(x.high, low.low), high.high))


def _add_row(
    where: str, row: Sequence[Interval], bias: Interval, inputs: Sequence[Interval], bits: int
) -> tuple[Interval, Bound]:
    total, reach = bias, bias.magnitude
    for coefficient, x in zip(row, inputs, strict=True):
        total = total + coefficient * x
        reach += coefficient.magnitude * x.magnitude
    return total, Bound(where, Interval(-reach, reach), bits).check()


def _shift(total: Interval, by: Interval) -> Interval:
    ends = [end >> s for end in (total.low, total.high) for s in (by.low, by.high)]
    return Interval(min(ends), max(ends))


def _input(node: IntegerInput, inputs: list[list[Interval]], known: _Known) -> Proof:
    low, high = known.of("low", node.low), known.of("high", node.high)
    if low.high > high.low:
        raise CheckError(f"{node.name}: a lower limit of the set may lie above an upper one")
    code = Interval(low.low, high.high) - known.of("origin", node.origin)
    out = code.scale(1 << node.shift)
    return [out], [Bound(f"{node.name}.code", code, 32).check(), Bound(node.name, out, 32).check()]


def _load(node: IntegerLoad, inputs: list[list[Interval]], known: _Known) -> Proof:
    """The rule of `IntegerLoad.prove` between the widest limits."""
    low, high = known.of("low", node.low), known.of("high", node.high)
    if low.high > high.low:
        raise CheckError(f"{node.name}: a lower limit of the set may lie above an upper one")
    return replace(node, low=low.low, high=high.high).prove(inputs)


def _exp2(node: IntegerExp2, inputs: list[list[Interval]], known: _Known) -> Proof:
    """The result rises with the exponent, and the exponent is at most the highest of the set."""
    x, coefficient = inputs[0][0], known.of("coefficient", node.coefficient)
    bias, high = known.of("bias", node.bias), known.of("high", node.high)
    widest = replace(node, high=high.high)
    found = widest.prove(inputs)  # the limits, the polynomial
    total, bound = _add_row(f"{node.name}.sum", [coefficient], bias, [x], 64)
    t = Interval(total.low >> node.shift, total.high >> node.shift)
    t = _saturate(t, Interval(node.low, node.low), high, node.name)
    low_end, high_end = (widest.raise_to(end) for end in (t.low, t.high))
    out = Interval(low_end, high_end)
    changed = {
        bound.where: bound,
        f"{node.name}.exponent": Bound(f"{node.name}.exponent", t, 32).check(),
        node.name: Bound(node.name, out, 32).check(),
    }
    return [out], [changed.get(line.where, line) for line in found[1]]


def _play(node: IntegerPlay, inputs: list[list[Interval]], known: _Known) -> Proof:
    """The rule of `IntegerPlay.prove` for the widest slack; y stays within x's range with any."""
    half = known.of("half_width", node.half_width)
    if half.low < 0:
        raise CheckError(f"{node.name}: the set holds a half-width below 0")
    return replace(node, half_width=half.high).prove(inputs)


def _delay(node: IntegerDelay, inputs: list[list[Interval]], known: _Known) -> Proof:
    """The result lies between two samples with any share of the newer one."""
    share = known.of("newer_q31", node.newer_q31)
    if share.low < 0:
        raise CheckError(f"{node.name}: the set holds a share below 0")
    return replace(node, newer_q31=share.high).prove(inputs)


def _offset(node: IntegerOffset, inputs: list[list[Interval]], known: _Known) -> Proof:
    out = inputs[0][0] - known.of("offset", node.offset)
    return [out], [Bound(node.name, out, 32).check()]


def _clip(node: IntegerClip, inputs: list[list[Interval]], known: _Known) -> Proof:
    low, high = known.of("low", node.low), known.of("high", node.high)
    out = _saturate(inputs[0][0], low, high, node.name)
    limits = Interval(low.low, high.high)
    return [out], [Bound(f"{node.name}.limits", limits, 32).check(), Bound(node.name, out, 32)]


def _product(node: IntegerProduct, inputs: list[list[Interval]], known: _Known) -> Proof:
    product = inputs[0][0] * inputs[1][0]
    half = Interval(0, 1 << node.shift >> 1)
    out = product.round_shift(node.shift)
    if node.limited or known.field("low") is not None:
        low, high = known.of("low", node.low), known.of("high", node.high)
        out = _saturate(out, low, high, node.name)
    return [out], [
        Bound(f"{node.name}.product", product + half, 64).check(),
        Bound(node.name, out, 32).check(),
    ]


def _lowpass(node: IntegerLowpass, inputs: list[list[Interval]], known: _Known) -> Proof:
    """The invariant of `IntegerLowpass.prove`, for the slowest and the quickest of the set.

    v is within the range of all blocks, of which its own block's is a part: it tends there from
    anywhere in the former. So y = v + c x is taken for any v and any c.
    """
    c, m = known.of("c_q24", node.c_q24), known.of("m_q31", node.m_q31)
    one, a_one = 1 << LOWPASS_FRACTION, 1 << (node.shift + 22)
    if c.low < 0 or c.high > one or m.low < 1 or m.high > min(a_one, INT32_MAX):
        raise CheckError(f"{node.name}: the set holds what is no low-pass")
    x = inputs[0][0]
    a_inverse = -(-a_one // m.low)
    margin = Interval(-(1 << 21) - a_inverse, (1 << 21) + a_inverse)
    v = x * Interval(one - c.high, one - c.low) + margin
    y = v + x * c
    gap = (x.scale(one) - y).round_shift(22)
    scaled = gap * m
    half = Interval(0, 1 << node.shift >> 1)
    out = y.round_shift(LOWPASS_FRACTION)
    return [out], [
        Bound(f"{node.name}.v", v, 64).check(),
        Bound(f"{node.name}.y", y, 64).check(),
        Bound(f"{node.name}.gap", gap, 32).check(),
        Bound(f"{node.name}.scaled", scaled + half, 64).check(),
        Bound(node.name, out, 32).check(),
    ]


def _lowpass_after(node: IntegerLowpassAfter, inputs: list[list[Interval]], known: _Known) -> Proof:
    """The invariant holds for any rate; the slowest collects the longest time."""
    rate = known.of("rate_q31", node.rate_q31)
    for end in (rate.high, rate.low):
        found = replace(node, rate_q31=end).prove(inputs)
    return found


def _sum(node: IntegerSum, inputs: list[list[Interval]], known: _Known) -> Proof:
    if known.field("coefficients") is None:
        return node.prove(inputs)
    row = [known.of("coefficients", c) for c in node.coefficients]
    bias = known.of("bias", node.bias)
    total, bound = _add_row(f"{node.name}.sum", row, bias, [x[0] for x in inputs], 64)
    out = Interval(total.low >> node.shift, total.high >> node.shift)
    if node.limited or known.field("low") is not None:
        low, high = known.of("low", node.low), known.of("high", node.high)
        out = _saturate(out, low, high, node.name)
    return [out], [bound, Bound(node.name, out, 32).check()]


def _features(node: IntegerFeatures, inputs: list[list[Interval]], known: _Known) -> Proof:
    flat = [x[0] for x in inputs]
    out, bounds = [], []
    for i in range(node.width):
        row = [known.of("matrix", int(c)) for c in node.matrix[i]]
        bias = known.of("bias", int(node.bias[i]))
        total, bound = _add_row(f"{node.name}[{i}]", row, bias, flat, 64)
        by = known.of("shift", node.shift[i])
        _require_shift(node.name, by, 63)
        out.append(_shift(total, by).saturate(INT16_MIN, INT16_MAX))
        bounds.append(bound)
    return out, bounds


def _require_shift(where: str, by: Interval, most: int) -> None:
    if by.low < 0 or by.high > most:
        raise CheckError(f"{where}: the set holds shifts of {by.low} .. {by.high} bits of {most}")


def _gru(node: IntegerGruLayer, inputs: list[list[Interval]], known: _Known) -> Proof:
    if known.field(STREAM) is None:
        return node.prove(inputs)
    return prove_layer(node)


def _reach_rows(
    where: str, width: int, field: BlockField, bias: Interval, inputs: Sequence[Interval]
) -> list[Bound]:
    """Return the bound of each row: its norm times the largest input."""
    reach = bias.magnitude + field.norm * max(x.magnitude for x in inputs)
    return [Bound(f"{where}[{k}]", Interval(-reach, reach), 32).check() for k in range(width)]


def _dense(node: IntegerDense, inputs: list[list[Interval]], known: _Known) -> Proof:
    weights, bias = known.field("weights"), known.field("bias")
    if weights is None or bias is None:
        return node.prove(inputs)
    copies = inputs[0]
    if not isinstance(node, IntegerFeatureDense):
        copies = [x.round_shift(COPY_BITS) for x in copies]
    _require_shift(node.name, known.of("shift", 0), 31)
    end = NODE_MAX << STEP_BITS
    bounds = _reach_rows(node.name, node.width, weights, bias.interval, copies)
    return [Interval(-end, end)] * node.width, bounds


def _head(node: IntegerHead, inputs: list[list[Interval]], known: _Known) -> Proof:
    weights = known.field("weights")
    if weights is None:
        return node.prove(inputs)
    copies = [x.round_shift(15) for x in inputs[0]]
    bounds = _reach_rows(node.name, node.width, weights, Interval(0, 0), copies)
    return [bound.interval for bound in bounds], bounds


def _drift(node: IntegerDrift, inputs: list[list[Interval]], known: _Known) -> Proof:
    scalars = [x[0] for x in (inputs[:-1] if node.head else inputs)]
    out, bounds = [], []
    for k in range(node.width):
        row = [known.of("coefficients", int(c)) for c in node.coefficients[k]]
        terms = list(scalars)
        if node.head:
            row.append(known.of("head_coefficients", int(node.head_coefficients[k])))
            terms.append(inputs[-1][k])
        bias = known.of("bias", int(node.bias[k]))
        total, bound = _add_row(f"{node.name}[{k}]", row, bias, terms, 64)
        shifted = Interval(total.low >> node.shift[k], total.high >> node.shift[k])
        low, high = known.of("low", node.low[k]), known.of("high", node.high[k])
        out.append(_saturate(shifted, low, high, f"{node.name}[{k}]"))
        bounds.append(bound)
    return out, bounds


Rule = Callable[..., Proof]
"""(node, intervals of its inputs, those of its numbers) -> its outputs and bounds."""
RULES: dict[type[IntegerNode], Rule] = {
    IntegerInput: _input,
    IntegerLoad: _load,
    IntegerExp2: _exp2,
    IntegerPlay: _play,
    IntegerDelay: _delay,
    IntegerOffset: _offset,
    IntegerClip: _clip,
    IntegerProduct: _product,
    IntegerLowpass: _lowpass,
    IntegerLowpassAfter: _lowpass_after,
    IntegerSum: _sum,
    IntegerFeatures: _features,
    IntegerGruLayer: _gru,
    IntegerDense: _dense,
    IntegerFeatureDense: _dense,
    IntegerHead: _head,
    IntegerDrift: _drift,
}
