"""Formats for everything from the features to the head, the finest that provably fit."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from zerodrift.base.arrays import Array, IntArray
from zerodrift.base.errors import CheckError
from zerodrift.export.float_network import FloatNetwork, width_of
from zerodrift.export.lowering import Lowering
from zerodrift.operations.arithmetic import INT16_MAX, INT16_MIN, INT32_MAX, choose_exponent
from zerodrift.operations.dense import (
    COPY_BITS,
    FloatDense,
    IntegerDense,
    IntegerFeatureDense,
)
from zerodrift.operations.gru import IntegerGruLayer
from zerodrift.operations.gru.cell import GATES, FloatGru, IntegerGru
from zerodrift.operations.gru_stack import IntegerGruStack
from zerodrift.operations.head import IntegerHead, IntegerJoinHead
from zerodrift.operations.intervals import Interval
from zerodrift.operations.join import IntegerJoin
from zerodrift.operations.layer_norm import (
    EPSILON_LIMIT,
    MOST_WIDTH,
    PART_BITS,
    RAISED_BITS,
    FloatLayerNorm,
    IntegerLayerNorm,
)
from zerodrift.operations.lstm import IntegerLstmLayer
from zerodrift.operations.lstm.cell import (
    CELL_BITS,
    CELL_LIMIT,
    FloatLstm,
    IntegerLstm,
)
from zerodrift.operations.lstm.cell import GATES as LSTM_GATES
from zerodrift.operations.node import IntegerNode
from zerodrift.operations.tables import TABLE_BITS

# Formats for a dense layer, the finest that are provably safe.


SHIFT_LIMIT = 30


def quantize_dense(
    layer: FloatDense,
    name: str,
    source: str,
    exponents: IntArray,
    inputs: Sequence[Interval],
    of_features: bool = False,
) -> tuple[IntegerDense, IntArray]:
    """Return a dense layer with the finest formats that are provably safe.

    A row of "clip" keeps the largest result that its inputs can give, so that int16 never
    saturates where the float layer would not.

    Args:
        layer: float weights.
        name: of the node.
        source: name of the node that it reads.
        exponents: [N] f with input = int16 copy * 2**-f.
        inputs: [N] range of the int16 copies.
        of_features: whether the layer reads the features themselves.

    Returns:
        The node, and [M] the exponents of its own int16 copies.

    Raises:
        CheckError: not finite, or no scale is safe.
    """
    if not (np.isfinite(layer.weight).all() and np.isfinite(layer.bias).all()):
        raise CheckError(f"{name}: a weight or bias is not finite; the model is refused")
    count = layer.weight.shape[0]
    rows = np.zeros(layer.weight.shape, dtype=np.int16)
    bias = np.zeros(count, dtype=np.int32)
    shifts, lows, highs = [], [], []
    own = np.full(count, COPY_BITS)
    magnitudes = np.array([x.magnitude for x in inputs], dtype=np.float64)
    for i in range(count):
        scaled = layer.weight[i] * 2.0 ** -exponents.astype(np.float64)
        reach = float(np.abs(scaled) @ magnitudes) + abs(float(layer.bias[i]))
        # the half of the shift, and half a unit of rounding per weight, beside the sum itself
        spare = int(magnitudes.sum()) // 2 + (1 << SHIFT_LIMIT >> 1)
        exponent = min(
            choose_exponent(float(np.abs(scaled).max()), INT16_MAX),
            choose_exponent(reach, INT32_MAX - spare) if spare < INT32_MAX else -1,
        )
        if layer.activation == "tanh":
            exponent = min(exponent, TABLE_BITS + SHIFT_LIMIT)
            shift = exponent - TABLE_BITS
        else:
            largest = min(reach, max(abs(layer.low), abs(layer.high)))
            own[i] = min(choose_exponent(largest, INT16_MAX), exponent)
            exponent = min(exponent, int(own[i]) + SHIFT_LIMIT)
            shift = exponent - int(own[i])
        if shift < 0:
            raise CheckError(
                f"{name}, row {i}: weights that reach {reach:.3g} leave no safe 32-bit format;"
                " the model is refused. Train with weight decay or clip that row."
            )
        rows[i] = np.round(scaled * 2.0**exponent)
        bias[i] = round(float(layer.bias[i]) * 2.0**exponent) + (1 << shift >> 1)
        shifts.append(shift)
        if layer.activation == "clip":
            unit = 2.0 ** float(own[i])
            lows.append(int(np.clip(np.round(layer.low * unit), INT16_MIN, INT16_MAX)))
            highs.append(int(np.clip(np.round(layer.high * unit), INT16_MIN, INT16_MAX)))
    node = (IntegerFeatureDense if of_features else IntegerDense)(
        name=name,
        inputs=(source,),
        weights=rows,
        bias=bias,
        shift=tuple(shifts),
        activation=layer.activation,
        low=tuple(lows),
        high=tuple(highs),
    )
    return node, own


# Formats for gates and for a head, chosen from the weights so that no accumulator can overflow.


LOWEST_EXPONENT = 17
"""The accumulator of every gate keeps at least the bits that the table reads."""


@dataclass(frozen=True)
class GateRows:
    """One gate of a recurrent layer in float."""

    name: str
    """For messages, such as "GRU gate r"."""
    w_x: Array  # [H, I]
    w_h: Array  # [H, H]
    bias: Array  # [H]
    table_bits: int
    """Fractional bits of the table's argument in the gate's own: 16, 15 for a sigmoid, which reads
    the table at half its argument."""
    inside: Array | None = None
    """[H] the bias inside the product of a gate whose recurrent part is multiplied by another."""


@dataclass(frozen=True)
class GateFormat:
    """Integer rows of one gate at scale 2**exponent (the n gate's features at one bit less)."""

    w_x: IntArray
    w_h: IntArray
    bias: IntArray  # outside the reset product
    bias_inside: IntArray
    shift: int
    multiplier: IntArray | None
    multiplier_shift: int

    def fits(self, inside: bool) -> bool:
        """Tell whether every int32 accumulator holds for any int16 features and any state.

        Args:
            inside: True for the n gate with the reset after the recurrent product.
        """
        product = np.abs(self.w_h).sum(axis=1) * 32767
        if self.multiplier is not None:
            product = (product * self.multiplier >> self.multiplier_shift) + 1
        from_x = np.abs(self.w_x).sum(axis=1) * 32768 + np.abs(self.bias)
        if inside:
            product = product + np.abs(self.bias_inside)
            if product.max() > INT32_MAX:
                return False
            product = product // 2 + 1
        largest = max(int(np.abs(self.w_x).max(initial=0)), int(np.abs(self.w_h).max()))
        return largest <= INT16_MAX and int((from_x + product).max()) <= INT32_MAX


def quantize_gru(gru: FloatGru, feature_exponents: IntArray, weights: str) -> IntegerGru:
    """Return the integer GRU with the finest power-of-two scale per gate that is provably safe.

    Args:
        gru: float weights.
        feature_exponents: [I] f with feature = integer * 2**-f.
        weights: "int16", or "int8" for 8-bit recurrent weights with a multiplier per row (the
            feature weights stay int16: they are few, and one row scale for both would cost the
            recurrent ones up to three bits).

    Raises:
        CheckError: a gate's weights are so large that no scale is safe, or not finite.
    """
    refuse_not_finite("GRU", gru)
    formats = [
        choose_gate(
            GateRows(
                f"GRU gate {name}",
                gru.w_x[gate],
                gru.w_h[gate],
                gru.bias[gate],
                16 if name == "n" else 15,
                gru.bias[3] if name == "n" and gru.reset == "after" else None,
            ),
            feature_exponents,
            weights,
        )
        for gate, name in enumerate(GATES)
    ]
    multiplier = None
    if weights == "int8":
        stacked = [f.multiplier for f in formats if f.multiplier is not None]
        multiplier = np.stack(stacked).astype(np.int32)
    bias = np.stack([f.bias for f in formats] + [formats[2].bias_inside]).astype(np.int32)
    w_h = np.stack([f.w_h for f in formats])
    return IntegerGru(
        w_x=np.stack([f.w_x for f in formats]).astype(np.int16),
        w_h=w_h.astype(np.int16) if weights == "int16" else w_h.astype(np.int8),
        bias=bias,
        shift=(formats[0].shift, formats[1].shift, formats[2].shift),
        reset=gru.reset,
        multiplier=multiplier,
        multiplier_shift=(
            formats[0].multiplier_shift,
            formats[1].multiplier_shift,
            formats[2].multiplier_shift,
        ),
    )


def refuse_not_finite(kind: str, layer: FloatGru | FloatLstm) -> None:
    """Raise CheckError where a weight of a layer is infinite or no number.

    Args:
        kind: for the message: "GRU", "LSTM".
        layer: its weights in float.
    """
    for name, array in (("w_x", layer.w_x), ("w_h", layer.w_h), ("bias", layer.bias)):
        if not np.isfinite(array).all():
            at = tuple(int(i) for i in np.argwhere(~np.isfinite(array))[0])
            raise CheckError(f"{kind} {name}{list(at)} is not finite; the model is refused")


def choose_gate(gate: GateRows, feature_exponents: IntArray, weights: str) -> GateFormat:
    """Return a gate's rows at the finest scale that is provably safe.

    Args:
        gate: its rows in float.
        feature_exponents: [I] f with feature = integer * 2**-f.
        weights: "int16", or "int8" for 8-bit recurrent weights with a multiplier per row.

    Raises:
        CheckError: the weights are so large that no scale is safe; names gate and row.
    """
    for exponent in range(15 + SHIFT_LIMIT, LOWEST_EXPONENT - 1, -1):
        with np.errstate(over="ignore"):  # infinite is too large as well
            candidate = _format_gate(gate, feature_exponents, weights, exponent)
        if candidate is not None and candidate.fits(gate.inside is not None):
            return candidate
    rows = np.abs(gate.w_x).sum(axis=1) + np.abs(gate.w_h).sum(axis=1)
    worst = int(rows.argmax())
    raise CheckError(
        f"{gate.name}, row {worst}: weights with a sum of {rows[worst]:.3g} leave no"
        " safe 32-bit format; the model is refused. Train with weight decay or clip that row."
    )


def _format_gate(
    gate: GateRows, feature_exponents: IntArray, weights: str, exponent: int
) -> GateFormat | None:
    """Return the gate's rows with its accumulator at 2**exponent, or None if one cannot fit."""
    inside = gate.inside
    outer = exponent if inside is None else exponent - 1  # mul_high by r halves the inner sum
    shift = outer - gate.table_bits
    half = 1 << shift >> 1
    bias_int = np.round(gate.bias * 2.0**outer) + half
    inside_int = np.zeros_like(bias_int) if inside is None else np.round(inside * 2.0**exponent)
    if max(np.abs(bias_int).max(), np.abs(inside_int).max()) > INT32_MAX:
        return None
    from_x = np.round(gate.w_x * 2.0 ** (outer - feature_exponents))
    recurrent = _format_recurrent(gate.w_h, exponent - 15, weights)
    if np.abs(from_x).max(initial=0.0) > INT16_MAX or recurrent is None:
        return None
    rows, multiplier, multiplier_shift = recurrent
    return GateFormat(
        w_x=from_x.astype(np.int64),
        w_h=rows,
        bias=bias_int.astype(np.int64),
        bias_inside=inside_int.astype(np.int64),
        shift=shift,
        multiplier=multiplier,
        multiplier_shift=multiplier_shift,
    )


def _format_recurrent(
    w_h: Array, exponent: int, weights: str
) -> tuple[IntArray, IntArray | None, int] | None:
    """Return integer rows, and for int8 the multipliers and their shift; None if one cannot fit."""
    if weights == "int16":
        scaled = np.round(w_h * 2.0**exponent)
        return None if np.abs(scaled).max() > INT16_MAX else (scaled.astype(np.int64), None, 0)
    step = np.abs(w_h).max(axis=1, keepdims=True) / 127.0
    rows = np.round(np.divide(w_h, step, out=np.zeros_like(w_h), where=step > 0.0))
    scale = step[:, 0] * 2.0**exponent
    shift = min(choose_exponent(float(scale.max()), INT32_MAX), 31)
    if shift < 0:
        return None
    return rows.astype(np.int64), np.round(scale * 2.0**shift).astype(np.int64), shift


def quantize_head(weights: Array) -> tuple[NDArray[np.int16], IntArray]:
    """Return int16 rows [K, H] for the head and the exponent of each row's 32-bit sum.

    Args:
        weights: [K, H] in output units per unit of hidden state.

    Returns:
        rows and exponents e: real = sum * 2**-e.
    """
    rows = np.zeros(weights.shape, dtype=np.int16)
    exponents = np.zeros(weights.shape[0], dtype=np.int64)
    for k, row in enumerate(weights):
        limit = min(
            choose_exponent(float(np.abs(row).max()), INT16_MAX - 1),
            choose_exponent(float(np.abs(row).sum()), INT32_MAX // 32768 - row.size),
        )
        exponent = min(limit, 40)
        rows[k] = np.round(row * 2.0**exponent).astype(np.int16)
        exponents[k] = exponent + 15
    return rows, exponents


# Formats for an LSTM, chosen from the weights so that no accumulator can overflow.

LARGEST_CODE = 32768.0


def quantize_lstm(lstm: FloatLstm, feature_exponents: IntArray, weights: str) -> IntegerLstm:
    """Return the integer LSTM with the finest power-of-two scale per gate that is provably safe.

    Args:
        lstm: float weights.
        feature_exponents: [I] f with feature = integer * 2**-f.
        weights: "int16", or "int8" for 8-bit recurrent weights with a multiplier per row.

    Raises:
        CheckError: a gate's weights are so large that no scale is safe, or not finite.
    """
    refuse_not_finite("LSTM", lstm)
    formats = [
        choose_gate(
            GateRows(
                f"LSTM gate {name}",
                lstm.w_x[gate],
                lstm.w_h[gate],
                lstm.bias[gate],
                16 if name == "g" else 15,
            ),
            feature_exponents,
            weights,
        )
        for gate, name in enumerate(LSTM_GATES)
    ]
    w_h = np.stack([f.w_h for f in formats])
    multipliers = [f.multiplier for f in formats if f.multiplier is not None]
    i, f, g, o = formats
    return IntegerLstm(
        w_x=np.stack([f.w_x for f in formats]).astype(np.int16),
        w_h=w_h.astype(np.int16) if weights == "int16" else w_h.astype(np.int8),
        bias=np.stack([f.bias for f in formats]).astype(np.int32),
        shift=(i.shift, f.shift, g.shift, o.shift),
        cell_bits=choose_cell_bits(lstm, feature_exponents),
        multiplier=np.stack(multipliers).astype(np.int32) if multipliers else None,
        multiplier_shift=(
            i.multiplier_shift,
            f.multiplier_shift,
            g.multiplier_shift,
            o.multiplier_shift,
        ),
    )


def choose_cell_bits(lstm: FloatLstm, feature_exponents: IntArray) -> int:
    """Return the fractional bits of the cell state: as many as its proven range leaves, 24 to 27.

    |c| is at most i g / (1 - f) with the largest i, g and f that features of 16 bits and |h| <= 1
    can give: a sum that c never passes, since c' = f c + i g.
    """
    most = np.abs(lstm.w_x) @ (LARGEST_CODE * 2.0 ** -feature_exponents.astype(np.float64))
    most = np.minimum(most + np.abs(lstm.w_h).sum(axis=2), 700.0)
    reach = np.minimum(lstm.bias + most, 700.0)
    i, f = (1.0 / (1.0 + np.exp(-reach[k])) for k in (0, 1))
    largest = float(np.max(i / np.maximum(1.0 - f, 2.0**-16)))
    least, bits = CELL_BITS
    while bits > least and 1.01 * largest * 2.0**bits > CELL_LIMIT:
        bits -= 1
    return bits


# Formats for a layer normalisation, the finest that are provably safe.

GAIN_LIMIT = 2**30
NORM_SHIFT_LIMIT = 62
FINEST = 24
"""Most fractional bits of a copy: those of a layer that gives next to nothing."""


def quantize_layer_norm(
    layer: FloatLayerNorm, name: str, source: str, exponents: IntArray
) -> tuple[IntegerLayerNorm, IntArray]:
    """Return a layer normalisation with the finest formats that are provably safe.

    Args:
        layer: float gain and bias.
        name: of the node.
        source: name of the layer's node that it reads.
        exponents: [M] f with input = int16 copy * 2**-f.

    Returns:
        The node, and [M] the exponents of its own int16 copies.

    Raises:
        CheckError: too wide, not finite, without a positive epsilon, or no scale is safe.
    """
    width = layer.gain.size
    if width > MOST_WIDTH:
        raise CheckError(
            f"{name}: normalises {width} values; up to {MOST_WIDTH} can be. Train a narrower layer."
        )
    if not (np.isfinite(layer.gain).all() and np.isfinite(layer.bias).all()):
        raise CheckError(f"{name}: a gain or bias is not finite; the model is refused")
    if not 0.0 < layer.epsilon < math.inf:
        raise CheckError(
            f"{name}: epsilon is {layer.epsilon:g}; expected one above 0, since equal values would"
            " be divided by 0. Train with the usual 1e-5."
        )
    common = int(exponents.min()) + RAISED_BITS
    while width * layer.epsilon * 4.0**common > EPSILON_LIMIT:
        common -= 1
    align = exponents + RAISED_BITS - common
    if align.max() > NORM_SHIFT_LIMIT:
        raise CheckError(
            f"{name}: its values have scales {int(np.ptp(exponents))} bits apart, or epsilon"
            f" {layer.epsilon:g} is far above their squares; the model is refused."
        )
    gains, biases, shifts = [], [], []
    own = np.zeros(width, dtype=np.int64)
    for i, (gain, bias) in enumerate(zip(layer.gain, layer.bias, strict=True)):
        largest = abs(float(gain)) * math.sqrt(width) + abs(float(bias))
        of_gain = choose_exponent(abs(float(gain)), GAIN_LIMIT)
        finest = choose_exponent(largest, INT16_MAX - 1)
        own[i] = min(finest, FINEST, of_gain + PART_BITS - COPY_BITS)
        of_gain = min(of_gain, int(own[i]) + COPY_BITS - PART_BITS + NORM_SHIFT_LIMIT)
        gains.append(round(float(gain) * 2.0**of_gain))
        biases.append(round(float(bias) * 2.0 ** float(own[i] + COPY_BITS)))
        shifts.append(PART_BITS + of_gain - int(own[i]) - COPY_BITS)
    node = IntegerLayerNorm(
        name=name,
        inputs=(source,),
        align=tuple(int(a) for a in align),
        gain=np.array(gains, dtype=np.int32),
        shift=tuple(shifts),
        bias=np.array(biases, dtype=np.int32),
        epsilon=max(1, round(width * layer.epsilon * 4.0**common)),
    )
    return node, own


# Formats for everything from the features to the head, and the nodes.


def quantize_grus(
    grus: Sequence[FloatGru], feature_exponents: IntArray, weights: str
) -> list[IntegerGru]:
    """Return GRUs on top of each other; each but the first reads the state of the one below.

    Raises:
        CheckError: a gate has no safe scale.
    """
    below = [feature_exponents, *(np.full(width_of(gru), COPY_BITS) for gru in grus)]
    return [quantize_gru(g, e, weights) for g, e in zip(grus, below, strict=False)]


@dataclass(frozen=True)
class LayerScales:
    """What the integers of a network stand for."""

    layers: Mapping[str, tuple[int, IntArray]]
    """Node -> the layer whose output it gives, counted from 1, and [M] e: value * 2**-e."""
    head: IntArray
    """[K]: a sum stands for sum * 2**-e."""


def group_layers(network: FloatNetwork) -> list[list[int]]:
    """Return the layers, counted from 1, in groups that become one node each.

    Recurrent layers of one kind on top of each other, the lower read by nothing else, are one.
    """
    readers: dict[int, int] = {}
    for reads in (*(n.reads for n in network.layers), network.reads):
        for k in reads:
            readers[k] = readers.get(k, 0) + 1
    groups: list[list[int]] = []
    for k, layer in enumerate(network.layers, 1):
        below = layer.reads[0]
        alone = layer.recurrent and len(layer.reads) == 1 and below and readers[below] == 1
        same = alone and type(network.layers[below - 1].cell) is type(layer.cell)
        group = next((g for g in groups if g[-1] == below), None) if same else None
        if group is None:
            groups.append([k])
        else:
            group.append(k)
    return sorted(groups, key=lambda group: group[-1])


def append_network(
    lowering: Lowering,
    network: FloatNetwork,
    feature_exponents: IntArray,
    weights: str,
    window: int,
) -> LayerScales:
    """Add all layers and the head after the node "features"; return what they stand for.

    Args:
        lowering: takes the nodes.
        network: the float network.
        feature_exponents: [I] f with feature = integer * 2**-f.
        weights: "int16", or "int8" for 8-bit recurrent weights.
        window: 0, or the number of samples of a window.

    Raises:
        CheckError: a layer has no safe format; names it and its row. Or, with a window, a recurrent
            layer reads what another recurrent one does not hand up directly.
    """
    names, exponents = {0: "features"}, {0: feature_exponents}
    found: dict[str, tuple[int, IntArray]] = {}
    for group in group_layers(network):
        if window:
            _refuse_split_window(network, group)
        reads = network.layers[group[0] - 1].reads
        source = _append_join(lowering, reads, names, exponents)
        given = np.concatenate([exponents[k] for k in reads])
        top = group[-1]
        node, own = _make_node(lowering, network, group, source, given, weights, window)
        names[top], exponents[top] = lowering.append(node), own
        found[node.name] = top, own + COPY_BITS
    source = _append_join(lowering, network.reads, names, exponents)
    given = np.concatenate([exponents[k] for k in network.reads])
    rows, head = quantize_head(network.head * 2.0 ** (COPY_BITS - given))
    of_layer = len(network.reads) == 1 and network.reads[0] != 0
    lowering.append((IntegerHead if of_layer else IntegerJoinHead)("head", (source,), rows))
    return LayerScales(found, head)


def _append_join(
    lowering: Lowering,
    reads: Sequence[int],
    names: Mapping[int, str],
    exponents: Mapping[int, IntArray],
) -> str:
    """Return the node that gives all of some sources; a join is added where it needs one."""
    if len(reads) == 1:
        return names[reads[0]]
    return lowering.append(
        IntegerJoin(
            _name(lowering, "join"),
            tuple(names[k] for k in reads),
            tuple(COPY_BITS if k else 0 for k in reads),
            tuple(exponents[k].size for k in reads),
        )
    )


def _name(lowering: Lowering, kind: str) -> str:
    """Return a name that no node has; no digits at its end, which number the layers of one."""
    taken = {node.name for node in lowering.nodes}
    letters = (chr(ord("a") + k) + chr(ord("a") + m) for k in range(26) for m in range(26))
    names = (kind, *(f"{kind}_{both}" for both in letters))
    return next(name for name in names if name not in taken)


def _make_node(
    lowering: Lowering,
    network: FloatNetwork,
    group: Sequence[int],
    source: str,
    given: IntArray,
    weights: str,
    window: int,
) -> tuple[IntegerNode, IntArray]:
    """Return the node of a group of layers, and the exponents of its int16 copies."""
    copied = _is_layer(lowering, source)
    cells = [network.layers[k - 1].cell for k in group]
    if isinstance(cells[0], FloatDense):
        reach = lowering.intervals[source]
        copies = [x.round_shift(COPY_BITS) for x in reach] if copied else reach
        name = _name(lowering, "dense")
        if network.is_chain:
            name = f"dense_{group[0] - len(network.grus) - 1}"
        return quantize_dense(cells[0], name, source, given, copies, not copied)
    if isinstance(cells[0], FloatLayerNorm):
        return quantize_layer_norm(cells[0], _name(lowering, "layer_norm"), source, given)
    if copied:  # a recurrent layer reads 16 bits
        source = lowering.append(
            IntegerJoin(_name(lowering, "join"), (source,), (COPY_BITS,), (given.size,))
        )
    own = np.full(width_of(cells[-1]), COPY_BITS)
    grus = [cell for cell in cells if isinstance(cell, FloatGru)]
    if grus:
        name, (*lower, top) = _name(lowering, "gru"), quantize_grus(grus, given, weights)
        if not lower:
            return IntegerGruLayer(name, (source,), gru=top, window=window), own
        return IntegerGruStack(name, (source,), gru=top, window=window, lower=tuple(lower)), own
    below = [given, *(np.full(width_of(cell), COPY_BITS) for cell in cells)]
    lstms = tuple(
        quantize_lstm(cell, scales, weights)
        for cell, scales in zip(cells, below, strict=False)
        if isinstance(cell, FloatLstm)
    )
    return IntegerLstmLayer(_name(lowering, "lstm"), (source,), layers=lstms, window=window), own


def _is_layer(lowering: Lowering, name: str) -> bool:
    """Tell whether a node's values have 15 bits more than their int16 copies."""
    node = next(n for n in lowering.nodes if n.name == name)
    return name != "features" and not isinstance(node, IntegerJoin)


def _refuse_split_window(network: FloatNetwork, group: Sequence[int]) -> None:
    """Refuse a windowed recurrent layer that stands on another one, but not in one node with it."""
    if not network.layers[group[0] - 1].recurrent:
        return
    below, stack = set[int](), list(network.layers[group[0] - 1].reads)
    while stack:
        k = stack.pop()
        if k and k not in below:
            below.add(k)
            stack += network.layers[k - 1].reads
    if any(network.layers[k - 1].recurrent for k in below):
        raise CheckError(
            f"layer {group[0]}: with a window, a recurrent layer has to read the features, dense"
            " layers, or the recurrent layer of its own kind right below it; something else stands"
            " between. Give --memory stream, or train the network with a carried state."
        )
