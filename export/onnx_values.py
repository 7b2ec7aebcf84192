"""What the values of a float ONNX graph are to the reader: constants, shapes, and affine signals.

A signal is `matrix source + bias` along one axis, the feature axis, where the source is the graph's
input, the state of a GRU or the output of an activation. Axes are objects: an axis keeps its
identity through transpositions, so that what is time, batch or feature need be found out only once,
where the GRU says it.
"""

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import onnx
from numpy.typing import NDArray
from onnx import numpy_helper

from zerodrift.base.arrays import Array
from zerodrift.operations.dense import FloatDense
from zerodrift.operations.gru.cell import FloatGru
from zerodrift.operations.layer_norm import FloatLayerNorm
from zerodrift.operations.lstm.cell import FloatLstm


class Unsupported(Exception):  # noqa: N818 - becomes the message of an InputError
    """An operator or a use of it that has no counterpart on the chip."""


@dataclass(eq=False)
class Axis:
    """One axis of a signal; two axes are the same only if they are the same object."""

    size: int | None = None
    role: str = ""
    """"time", "batch", "feature", "one" for an axis of length 1, or not known yet."""
    parts: tuple["Axis", ...] = ()
    """The axes that a reshape joined into this one."""

    def take_role(self, role: str) -> None:
        """Find out what the axis is.

        Raises:
            Unsupported: it is something else already.
        """
        if self.parts or (self.role not in ("", "one", role)):
            raise Unsupported(
                f"its {role} axis is the {self.role or 'joined'} axis of the values before it"
            )
        self.role = role

    @property
    def is_one(self) -> bool:
        """Whether the axis has length 1 for certain."""
        return self.size == 1


@dataclass(eq=False)
class OnnxSource:
    """Where a signal's numbers come from: the graph's input, a recurrent layer, an activation; or
    several of these side by side."""

    width: int
    """0 for an input of which it is not known yet."""
    below: "OnnxSource | None" = None
    """What the layer reads."""
    layer: FloatGru | FloatLstm | FloatDense | FloatLayerNorm | None = None
    """None for the graph's input, and for several side by side."""
    name: str = ""
    """The input's or the node's name."""
    time: Axis | None = None
    """A recurrent layer's time axis."""
    parts: tuple["OnnxSource", ...] = ()
    """The sources that stand here side by side, none of which has parts."""
    last_along: list[Axis] = field(default_factory=list)
    """Axes of an input of which the last entry is taken: each has to be the time."""

    @property
    def singles(self) -> tuple["OnnxSource", ...]:
        """The source itself, or its parts."""
        return self.parts or (self,)

    @property
    def recurrent(self) -> bool:
        """Whether it is a recurrent layer."""
        return isinstance(self.layer, FloatGru | FloatLstm)

    def chain(self) -> list["OnnxSource"]:
        """Return the inputs and layers that this depends on, itself included, from below."""
        found: list[OnnxSource] = []
        for single in self.singles:
            if single not in found:
                below = single.below.chain() if single.below is not None else []
                found += [source for source in below if source not in found]
                found.append(single)
        return found


@dataclass(frozen=True)
class Constant:
    """A tensor that lies in the file or follows from such."""

    array: NDArray[np.generic]


@dataclass(frozen=True)
class Fill:
    """A tensor of one value throughout, whose shape does not matter."""

    value: float


@dataclass(frozen=True)
class Dims:
    """Whole numbers made from shapes: known ones, or the length of an axis that is not known."""

    entries: tuple[int | Axis | None, ...]
    scalar: bool = False


@dataclass(frozen=True)
class Refused:
    """What an operator gives that is not supported; an error only where the answer needs it."""

    message: str


@dataclass(frozen=True)
class Pack:
    """Signals one after the other along an axis of length 1 each, such as the states of layers."""

    items: tuple["OnnxSignal", ...]
    axis: int


@dataclass(frozen=True)
class Pending:
    """An elementwise operation with a constant, before it is known which axis is the feature's."""

    op: str
    array: Array
    axes: tuple[Axis, ...]


@dataclass(frozen=True)
class RawInput:
    """An input of the graph, as long as nothing tells data from initial states."""

    name: str
    axes: tuple[Axis, ...]
    pending: tuple[Pending, ...] = ()
    part: bool = False
    """Not all of the input; only an initial state may be that."""
    source: OnnxSource = field(default_factory=lambda: OnnxSource(0))
    """What its signals come from; the same for every branch of the graph that reads it."""
    last: bool = False
    """The last entry along an axis that may turn out to be the time."""


@dataclass(frozen=True)
class OnnxSignal:
    """matrix source + bias along the feature axis."""

    source: OnnxSource
    axes: tuple[Axis, ...]
    matrix: Array
    """[n, source.width]"""
    bias: Array
    """[n]"""
    last: bool = False
    """Only the last sample of the sequence."""

    @property
    def of_one(self) -> bool:
        """Whether the sequence has one sample only, which is the last one too."""
        times = [source.time for source in self.source.chain() if source.recurrent]
        return all(time is not None and time.is_one for time in times)

    def mix(self, weight: Array, bias: Array) -> "OnnxSignal":
        """Return weight signal + bias, on a new feature axis."""
        axes = (*self.axes[:-1], Axis(weight.shape[0], "feature"))
        return replace(self, axes=axes, matrix=weight @ self.matrix, bias=weight @ self.bias + bias)

    def apply(self, op: str, array: Array, axes: Sequence[Axis]) -> "OnnxSignal":
        """Return the signal after an elementwise operation with a constant."""
        vector = take_feature_vector(array, axes, self.matrix.shape[0])
        match op:
            case "Add":
                return replace(self, bias=self.bias + vector)
            case "Sub":
                return replace(self, bias=self.bias - vector)
            case "Mul":
                return replace(self, matrix=self.matrix * vector[:, None], bias=self.bias * vector)
            case _:
                if not vector.all():
                    raise Unsupported("it divides by 0")
                return replace(self, matrix=self.matrix / vector[:, None], bias=self.bias / vector)


def join_signals(signals: Sequence[OnnxSignal]) -> list[OnnxSignal]:
    """Return signals as ones of one source, whose parts stand side by side.

    Raises:
        Unsupported: they are of different samples.
    """
    if all(s.source is signals[0].source for s in signals):
        return list(signals)
    if len({s.last for s in signals}) > 1:
        if all(s.of_one for s in signals):
            return join_signals([replace(s, last=True) for s in signals])
        raise Unsupported("it joins the last sample with all samples of the sequence")
    parts: list[OnnxSource] = []
    for signal in signals:
        parts += [single for single in signal.source.singles if single not in parts]
    starts = dict(zip(map(id, parts), np.cumsum([0, *(p.width for p in parts)]), strict=False))
    joined = OnnxSource(sum(p.width for p in parts), parts=tuple(parts))
    found = []
    for signal in signals:
        matrix, first = np.zeros((signal.matrix.shape[0], joined.width)), 0
        for single in signal.source.singles:
            at = int(starts[id(single)])
            matrix[:, at : at + single.width] = signal.matrix[:, first : first + single.width]
            first += single.width
        found.append(replace(signal, source=joined, matrix=matrix))
    return found


@dataclass(frozen=True)
class Moment:
    """A part of the normalisation of a signal, which means something as such a part only."""

    of: OnnxSignal
    stage: str
    """mean | centered | square | variance | deviation | inverse"""
    epsilon: float = 0.0


Value = Constant | Fill | Dims | Refused | Pack | RawInput | OnnxSignal | Moment | None
"""None is an optional input that is left out."""


def take_feature_vector(array: Array, axes: Sequence[Axis], width: int) -> Array:
    """Return a constant's values [width] along the feature axis.

    Raises:
        Unsupported: the constant is not one number per feature.
    """
    extra = array.ndim - len(axes)
    if extra > 0:
        if any(n != 1 for n in array.shape[:extra]):
            raise Unsupported(f"its constant of shape {array.shape} adds an axis")
        array = array.reshape(array.shape[extra:])
    for n, axis in zip(reversed(array.shape), reversed(axes), strict=False):
        if n != 1 and (axis.role != "feature" or n != width):
            raise Unsupported(
                f"its constant of shape {array.shape} varies along the {axis.role or 'same'} axis;"
                " one number, or one per feature, is supported"
            )
    return np.array(np.broadcast_to(array.ravel(), (width,)), dtype=np.float64)


def bind(raw: RawInput, width: int, position: int) -> OnnxSignal:
    """Return a graph input as a signal whose feature axis stands at `position`.

    Raises:
        Unsupported: the axis has another length, or what came before mixes axes.
    """
    if raw.part:
        raise Unsupported(f"it reads a part of input '{raw.name}'; expected all of it")
    axis = raw.axes[position]
    axis.take_role("feature")
    if axis.size not in (None, width):
        raise Unsupported(f"it reads {width} features, input '{raw.name}' has {axis.size}")
    axis.size = raw.source.width = width
    raw.source.name = raw.name
    signal = OnnxSignal(raw.source, raw.axes, np.eye(width), np.zeros(width), raw.last)
    for step in raw.pending:
        signal = signal.apply(step.op, step.array, step.axes)
    return signal


@dataclass
class Axes:
    """The axes of a value taken apart and put together again by Reshape."""

    given: tuple[Axis, ...]
    dropped: list[Axis] = field(default_factory=list)
    """Axes of length 1 that are gone."""

    def reshape(self, target: Sequence[int | Axis | None]) -> tuple[Axis, ...]:
        """Return the axes for a Reshape's target, entry by entry from both ends.

        Raises:
            Unsupported: the reshape mixes features with time or batch, or cannot be followed.
        """
        atoms = [part for axis in self.given for part in (axis.parts or (axis,))]
        atoms = [axis for axis in atoms if axis.role != "one"]
        entries = [
            self.given[i] if e == 0 and i < len(self.given) else e for i, e in enumerate(target)
        ]
        free = [i for i, entry in enumerate(entries) if entry == -1]
        if len(free) > 1 or any(entry is None for entry in entries):
            raise Unsupported("its target shape is computed in a way that is not followed")
        cut = free[0] if free else len(entries)
        front = [self._take(entry, atoms, 0) for entry in entries[:cut]]
        back = [self._take(entry, atoms, -1) for entry in reversed(entries[cut + 1 :])]
        middle = []
        if free:
            moving = [axis for axis in atoms if not axis.is_one] or atoms[:1]
            self.dropped += [axis for axis in atoms if axis not in moving]
            middle = [_join(moving)]
        elif any(not axis.is_one for axis in atoms):
            raise Unsupported("its target shape does not hold all axes")
        else:
            self.dropped += atoms
        return (*front, *middle, *reversed(back))

    def _take(self, entry: int | Axis | None, atoms: list[Axis], end: int) -> Axis:
        """Return the axis for one entry of the target, taken off one end of `atoms`."""
        if isinstance(entry, Axis) and entry.role == "one":
            return Axis(1, "one")
        joined = entry if isinstance(entry, Axis) and entry.parts else None
        while atoms:
            axis = atoms[end]
            wanted = entry if joined is None else joined.parts[end]
            if wanted is axis or wanted == axis.size:
                if joined is not None:
                    return self._take_all(joined, atoms, end)
                return atoms.pop(end)
            if wanted == 1:
                return Axis(1, "one")
            if axis.size is None and isinstance(wanted, int):
                axis.size = wanted
                return atoms.pop(end)
            if not axis.is_one:
                break
            self.dropped.append(atoms.pop(end))
        if entry == 1:
            return Axis(1, "one")
        raise Unsupported("it joins or splits axes in a way that is not followed")

    def _take_all(self, entry: Axis, atoms: list[Axis], end: int) -> Axis:
        for _ in entry.parts:
            atoms.pop(end)
        return entry


def _join(axes: list[Axis]) -> Axis:
    if not axes:
        return Axis(1, "one")
    if len(axes) == 1:
        return axes[0]
    if any(axis.role == "feature" for axis in axes):
        raise Unsupported("it joins features with time or batch")
    return Axis(None, "", tuple(axes))


# Operators of a float ONNX graph that change nothing but shapes: what each does to the values.

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
