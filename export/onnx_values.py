"""What the values of a float ONNX graph are to the reader: constants, shapes, and affine signals.

A signal is `matrix source + bias` along one axis, the feature axis, where the source is the graph's
input, the state of a GRU or the output of an activation. Axes are objects: an axis keeps its
identity through transpositions, so that what is time, batch or feature need be found out only once,
where the GRU says it.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

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
