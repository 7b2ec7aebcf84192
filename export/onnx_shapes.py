"""Operators of a float ONNX graph that change nothing but shapes: what each does to the values."""

import itertools
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import onnx
from numpy.typing import NDArray
from onnx import numpy_helper

from zerodrift.export.onnx_values import (
    Axes,
    Axis,
    Constant,
    Dims,
    Fill,
    OnnxSignal,
    Pack,
    RawInput,
    Unsupported,
    Value,
)

Attributes = dict[str, Any]
Operator = Callable[[onnx.NodeProto, Attributes, list[Value]], list[Value]]


def pick_array(value: Value, what: str, *, finite: bool = True) -> NDArray[Any]:
    """Return the array of a constant.

    Raises:
        Unsupported: it is computed, or holds what is not a finite number.
    """
    if isinstance(value, Constant):
        if finite and not np.isfinite(value.array).all():
            at = [int(i) for i in np.argwhere(~np.isfinite(value.array))[0]]
            raise Unsupported(f"its {what} has the value {value.array[tuple(at)]} at {at}")
        return value.array
    if isinstance(value, Fill):
        return np.array(value.value)
    raise Unsupported(f"its {what} is computed, not a constant")


def read_numbers(
    node: onnx.NodeProto, attributes: Attributes, values: list[Value], index: int, name: str
) -> list[int] | None:
    """Return whole numbers given as input `index`, or as an attribute in older opsets."""
    if name in attributes:
        given = attributes[name]
        return [int(given)] if isinstance(given, int) else [int(v) for v in given]
    if index >= len(values) or values[index] is None:
        return None
    known = values[index]
    if isinstance(known, Dims) and all(isinstance(n, int) for n in known.entries):
        return [n for n in known.entries if isinstance(n, int)]
    array = pick_array(known, f"input '{node.input[index]}'")
    return [int(v) for v in np.ravel(array)]


def axes_of(value: Value) -> tuple[Axis, ...]:
    """Return the axes of data."""
    if isinstance(value, RawInput | OnnxSignal):
        return value.axes
    raise Unsupported("it is used on something that is not followed")


def is_data(value: Value) -> bool:
    """Tell whether a value depends on the graph's input."""
    return isinstance(value, RawInput | OnnxSignal | Pack)


def keep(_: onnx.NodeProto, attributes: Attributes, values: list[Value]) -> list[Value]:
    """Identity, Dropout of an exported network, Cast to another float."""
    kinds = onnx.TensorProto
    floats = (kinds.FLOAT, kinds.DOUBLE, kinds.FLOAT16, kinds.BFLOAT16)
    if is_data(values[0]) and attributes.get("to", kinds.FLOAT) not in floats:
        raise Unsupported("it turns data into whole numbers")
    if isinstance(values[0], Constant) and "to" in attributes:
        kind = onnx.helper.tensor_dtype_to_np_dtype(attributes["to"])
        return [Constant(values[0].array.astype(kind))]
    return [values[0]]


def shape(_: onnx.NodeProto, attributes: Attributes, values: list[Value]) -> list[Value]:
    """Shape: what is known of it."""
    if isinstance(values[0], Constant):
        entries: tuple[int | Axis | None, ...] = tuple(values[0].array.shape)
    elif isinstance(values[0], RawInput | OnnxSignal):
        entries = tuple(a.size if a.size is not None else a for a in values[0].axes)
    else:
        raise Unsupported("it asks for the shape of something that is not followed")
    return [Dims(entries[attributes.get("start", 0) : attributes.get("end", len(entries))])]


def transpose(_: onnx.NodeProto, attributes: Attributes, values: list[Value]) -> list[Value]:
    """Transpose: the axes change places."""
    axes = axes_of(values[0])
    order = attributes.get("perm", range(len(axes) - 1, -1, -1))
    return [replace(values[0], axes=tuple(axes[i] for i in order))]  # type: ignore[type-var]


def unsqueeze(node: onnx.NodeProto, attributes: Attributes, values: list[Value]) -> list[Value]:
    """Unsqueeze: new axes of length 1."""
    at = read_numbers(node, attributes, values, 1, "axes") or []
    if isinstance(values[0], Dims):
        return [replace(values[0], scalar=False)]
    axes = list(axes_of(values[0]))
    rank = len(axes) + len(at)
    for position in sorted(a % rank for a in at):
        axes.insert(position, Axis(1, "one"))
    return [replace(values[0], axes=tuple(axes))]  # type: ignore[type-var]


def squeeze(node: onnx.NodeProto, attributes: Attributes, values: list[Value]) -> list[Value]:
    """Squeeze: axes of length 1 go."""
    at = read_numbers(node, attributes, values, 1, "axes")
    if isinstance(values[0], Dims):
        return [replace(values[0], scalar=True)]
    axes = axes_of(values[0])
    if at is None:
        at = [i for i, axis in enumerate(axes) if axis.is_one]
    gone = [axes[a] for a in at]
    return [_drop(values[0], gone)]


def _drop(value: Value, gone: Sequence[Axis]) -> Value:
    """Return data without some axes of length 1; without time, it is the last sample."""
    assert isinstance(value, RawInput | OnnxSignal)
    last = False
    for axis in gone:
        if axis.role in ("batch", "") and axis.size is None:
            axis.size = 1
        if not axis.is_one:
            raise Unsupported(f"it takes out the {axis.role or 'unknown'} axis, longer than 1")
        last |= axis.role == "time"
    axes = tuple(axis for axis in value.axes if axis not in gone)
    if isinstance(value, OnnxSignal):
        return replace(value, axes=axes, last=value.last or last)
    return replace(value, axes=axes)


def reshape(_: onnx.NodeProto, attributes: Attributes, values: list[Value]) -> list[Value]:
    """Reshape, as far as each axis can be told in the result."""
    data, wanted = values[0], values[1]
    if isinstance(data, Dims):
        return [replace(data, scalar=False)]
    if isinstance(wanted, Constant):
        target: tuple[int | Axis | None, ...] = tuple(int(n) for n in wanted.array.ravel())
    elif isinstance(wanted, Dims):
        target = wanted.entries
    else:
        raise Unsupported("its target shape is computed in a way that is not followed")
    if attributes.get("allowzero", 0) and 0 in target:
        raise Unsupported("its target is empty")
    work = Axes(axes_of(data))
    axes = work.reshape(target)
    result = _drop(data, work.dropped)
    return [replace(result, axes=axes)]  # type: ignore[type-var]


def flatten(_: onnx.NodeProto, attributes: Attributes, values: list[Value]) -> list[Value]:
    """Flatten: everything before and after an axis joined."""
    axes = axes_of(values[0])
    at = attributes.get("axis", 1) % (len(axes) + 1)
    work = Axes(axes)
    if at == len(axes) - 1:
        target = [-1, axes[-1].size if axes[-1].size is not None else axes[-1]]
        result = work.reshape(target)
    elif at == 1:
        result = work.reshape([axes[0].size if axes[0].size is not None else axes[0], -1])
    else:
        raise Unsupported(f"it joins axes at {at}")
    return [replace(_drop(values[0], work.dropped), axes=result)]  # type: ignore[type-var]


def gather(node: onnx.NodeProto, attributes: Attributes, values: list[Value]) -> list[Value]:
    """Gather: the last sample, one of the packed states, or some features."""
    indices = pick_array(values[1], f"input '{node.input[1]}'").astype(np.int64)
    data, at = values[0], attributes.get("axis", 0)
    if isinstance(data, Dims):
        entries = tuple(data.entries[i] for i in indices.ravel())
        return [Dims(entries, indices.ndim == 0)]
    if indices.ndim > 1:
        raise Unsupported("its indices have more than one axis")
    picks = [int(i) for i in indices.ravel()]
    return [_pick(data, at, picks, remove=indices.ndim == 0)]


def _pick(data: Value, at: int, picks: list[int], *, remove: bool) -> Value:
    """Return the entries `picks` along an axis, and the axis removed if wanted."""
    if isinstance(data, Pack):
        if at % (data.axis + 1) != data.axis or len(picks) != 1:
            raise Unsupported("it takes the packed states apart in a way that is not followed")
        data = data.items[picks[0]]
        return _drop(data, [data.axes[at]]) if remove else data
    axes = axes_of(data)
    axis = axes[at]
    if isinstance(data, RawInput) and not axis.is_one:
        if picks == [-1] or (axis.size is not None and picks == [axis.size - 1]):
            return _pick_last(data, at, remove=remove)
        return _pick_input(data, at, None if remove else Axis())
    if axis.is_one and axis.role != "feature":
        if picks not in ([0], [-1]):
            raise Unsupported(f"it takes {picks} of an axis of length 1")
        return _drop(data, [axis]) if remove else data
    if isinstance(data, OnnxSignal) and axis.role == "feature":
        rest = () if remove else (Axis(len(picks), "feature"),)
        place = at % len(axes)
        return replace(
            data,
            axes=(*axes[:place], *rest, *axes[place + 1 :]),
            matrix=data.matrix[picks],
            bias=data.bias[picks],
        )
    if isinstance(data, OnnxSignal) and axis.role == "time":
        ends = {-1} | ({axis.size - 1} if axis.size is not None else set())
        if len(picks) != 1 or picks[0] not in ends:
            raise Unsupported(f"it takes sample {picks} of the sequence, not the last")
        rest = () if remove else (Axis(1, "one"),)
        place = at % len(axes)
        return replace(data, axes=(*axes[:place], *rest, *axes[place + 1 :]), last=True)
    raise Unsupported(f"it takes {picks} of the {axis.role or 'input'} axis")


def _pick_input(data: RawInput, at: int, axis: Axis | None) -> RawInput:
    """Return a part of an input, which only an initial state may be."""
    place = at % len(data.axes)
    kept = () if axis is None else (axis,)
    return replace(data, axes=(*data.axes[:place], *kept, *data.axes[place + 1 :]), part=True)


def _pick_last(data: RawInput, at: int, *, remove: bool) -> RawInput:
    """Return the last entry of an input along an axis, which has to turn out to be the time."""
    place = at % len(data.axes)
    data.source.last_along.append(data.axes[place])
    kept = () if remove else (Axis(1, "one"),)
    return replace(data, axes=(*data.axes[:place], *kept, *data.axes[place + 1 :]), last=True)


def split(node: onnx.NodeProto, attributes: Attributes, values: list[Value]) -> list[Value]:
    """Split of features, or of an input into the initial states of layers."""
    data = values[0]
    if isinstance(data, OnnxSignal):
        at = attributes.get("axis", 0) % len(data.axes)
        if data.axes[at].role != "feature":
            raise Unsupported(f"it takes the {data.axes[at].role or 'unknown'} axis apart")
        sizes = read_numbers(node, attributes, values, 1, "split")
        width, parts = data.matrix.shape[0], len(node.output)
        if sizes is None:  # equal parts, the last one smaller
            each = -(-width // parts)
            sizes = [min(each, width - k * each) for k in range(parts)]
        ends = np.cumsum([0, *sizes])
        rows = [list(range(a, b)) for a, b in itertools.pairwise(ends)]
        return [_pick(data, at, picks, remove=False) for picks in rows]
    if not isinstance(data, RawInput):
        raise Unsupported("it takes data apart")
    return [_pick_input(data, attributes.get("axis", 0), Axis())] * len(node.output)


def slice_(node: onnx.NodeProto, attributes: Attributes, values: list[Value]) -> list[Value]:
    """Slice: the last sample, one of the packed states, or some features."""
    starts = read_numbers(node, attributes, values, 1, "starts") or []
    ends = read_numbers(node, attributes, values, 2, "ends") or []
    at = read_numbers(node, attributes, values, 3, "axes") or list(range(len(starts)))
    steps = read_numbers(node, attributes, values, 4, "steps") or [1] * len(starts)
    data = values[0]
    for start, end, position, step in zip(starts, ends, at, steps, strict=True):
        if isinstance(data, Dims):
            data = Dims(data.entries[start:end:step])
            continue
        if isinstance(data, RawInput):
            size = data.axes[position].size
            newest = start == -1 or (size is not None and start == size - 1)
            if newest and step == 1 and end >= (size or 2**31 - 1) and size != 1:
                data = _pick_last(data, position, remove=False)
            elif start or step != 1 or end < (size or 2**31 - 1):
                data = _pick_input(data, position, data.axes[position])
            continue
        length = len(data.items) if isinstance(data, Pack) else axes_of(data)[position].size
        if start == 0 and step == 1 and end >= (length or 2**31 - 1):
            continue
        if length is None:
            if start != -1 or step != 1 or end < 2**31 - 1:
                raise Unsupported("it takes more than the last sample of the sequence")
            picks = [-1]
        else:
            picks = list(range(length))[start:end:step]
            picks = [-1] if picks == [length - 1] else picks
        data = _pick(data, position, picks, remove=False)
    return [data]


def concat_shapes(_: onnx.NodeProto, attributes: Attributes, values: list[Value]) -> list[Value]:
    """Concat of shapes, of equal fills, or of states."""
    at = attributes["axis"]
    if any(isinstance(v, Dims) for v in values):
        entries: list[int | Axis | None] = []
        for value in values:
            if isinstance(value, Dims):
                entries += value.entries
            else:
                entries += [int(n) for n in pick_array(value, "shape").ravel()]
        return [Dims(tuple(entries))]
    if len(values) == 1:
        return values
    if all(isinstance(v, Fill) for v in values) and len({v.value for v in values}) == 1:  # type: ignore[union-attr]
        return [values[0]]
    signals = tuple(v for v in values if isinstance(v, OnnxSignal))
    if len(signals) != len(values) or not all(s.axes[at].is_one for s in signals):
        raise Unsupported("it joins values other than states of layers")
    return [Pack(signals, at % len(signals[0].axes))]


def fill(node: onnx.NodeProto, attributes: Attributes, values: list[Value]) -> list[Value]:
    """ConstantOfShape and Expand: one value, whatever the shape."""
    if node.op_type == "ConstantOfShape":
        given = attributes.get("value")
        return [Fill(float(numpy_helper.to_array(given).ravel()[0]) if given else 0.0)]
    array = pick_array(values[0], "input")
    if array.size == 0 or (array != array.ravel()[0]).any():
        raise Unsupported("it repeats values that differ")
    return [Fill(float(array.ravel()[0]))]


RESHAPING: dict[str, Operator] = {
    "Transpose": transpose,
    "Unsqueeze": unsqueeze,
    "Squeeze": squeeze,
    "Reshape": reshape,
    "Flatten": flatten,
    "Gather": gather,
    "Slice": slice_,
    "Split": split,
}
"""Operators that rearrange one value: what is the same number everywhere stays so."""
RESHAPED = RESHAPING | {
    "Identity": keep,
    "Dropout": keep,
    "Cast": keep,
    "Shape": shape,
    "ConstantOfShape": fill,
    "Expand": fill,
}
"""All of this module's operators."""
