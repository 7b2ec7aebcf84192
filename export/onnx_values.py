"""What the values of a float ONNX graph are to the reader: constants, shapes, and affine signals.

A signal is `matrix source + bias` along one axis, the feature axis, where the source is the graph's
input, the state of a GRU or the output of an activation. Axes are objects: an axis keeps its
identity through transpositions, so that what is time, batch or feature need be found out only once,
where the GRU says it.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from zerodrift.operations.dense import FloatDense
from zerodrift.operations.gru.cell import FloatGru

Array = NDArray[np.float64]


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
    """Where a signal's numbers come from: the graph's input, a GRU, or an activation."""

    width: int
    below: "OnnxSource | None" = None
    layer: FloatGru | FloatDense | None = None
    """None for the graph's input."""
    name: str = ""
    """The input's or the node's name."""
    time: Axis | None = None
    """A GRU's time axis."""

    def chain(self) -> Iterator["OnnxSource"]:
        """Give this source and all below it, downwards."""
        source: OnnxSource | None = self
        while source is not None:
            yield source
            source = source.below


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


Value = Constant | Fill | Dims | Refused | Pack | RawInput | OnnxSignal | None
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
    axis.size = width
    signal = OnnxSignal(OnnxSource(width, name=raw.name), raw.axes, np.eye(width), np.zeros(width))
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
