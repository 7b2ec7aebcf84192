"""Writes ONNX graphs of exact int64 arithmetic: constants stored once, shifts that floor.

ONNX shifts unsigned numbers only and divides signed ones towards zero. With the remainder that
`Mod` takes as Python does (never negative for a positive divisor), `(x - Mod(x, 2^s)) / 2^s` leaves
no remainder, hence floors, for every int64 x.

The operators Max, Min and Clip are avoided: onnxruntime up to 1.31 on x86 computes them wrongly for
some int64 numbers beyond 32 bits (github.com/microsoft/onnxruntime/pull/25280). `tests/onnx` tries
every operator that is used on such numbers.
"""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import TypeAlias

import numpy as np
import onnx
from numpy.typing import ArrayLike
from onnx import TensorProto, helper, numpy_helper

from zerodrift.base.arrays import IntArray

OPSET, IR_VERSION = 17, 8
Shape = tuple[str | int, ...]
AttributeValue: TypeAlias = (
    int | float | str | Sequence[int] | Sequence[str] | onnx.TensorProto | onnx.GraphProto
)
"""What an attribute of a node is written from."""
Body = Callable[..., tuple[Sequence[str], Sequence[str]]]
"""Called with the names of carried values and slices; returns new carried values and scanned."""


@dataclass
class OnnxWriter:
    """Collects the nodes of a graph and of the subgraphs within it.

    Names are counted, so that the same calls give the same file. Constants belong to the outermost
    graph, which every subgraph sees.
    """

    initializers: dict[str, onnx.TensorProto] = field(default_factory=dict)
    _known: dict[tuple[str, tuple[int, ...], bytes], str] = field(default_factory=dict)
    _nodes: list[list[onnx.NodeProto]] = field(default_factory=lambda: [[]])
    _label: str = ""
    _count: int = 0

    @contextmanager
    def label(self, label: str) -> Iterator[None]:
        """Within this context, names start with `label`."""
        before, self._label = self._label, label
        yield
        self._label = before

    def name(self, what: str) -> str:
        """Return a name that no other value has."""
        self._count += 1
        return f"{self._label}/{what}_{self._count}" if self._label else f"{what}_{self._count}"

    def constant(self, value: ArrayLike) -> str:
        """Return the name of an int64 constant of any shape."""
        array = np.array(value, dtype=np.int64, order="C")
        key = (array.dtype.name, array.shape, array.tobytes())
        if key not in self._known:
            name = self.name("constant")
            self.initializers[name] = numpy_helper.from_array(array, name)
            self._known[key] = name
        return self._known[key]

    def op(self, op_type: str, *inputs: str, **attributes: AttributeValue) -> str:
        """Add a node with one output and return the output's name."""
        return self.ops(op_type, 1, *inputs, **attributes)[0]

    def ops(
        self, op_type: str, outputs: int, *inputs: str, **attributes: AttributeValue
    ) -> list[str]:
        """Add a node and return its outputs' names."""
        names = [self.name(op_type.lower()) for _ in range(outputs)]
        node = helper.make_node(op_type, list(inputs), names, name=names[0])
        node.attribute.extend(helper.make_attribute(k, v) for k, v in sorted(attributes.items()))
        self._nodes[-1].append(node)
        return names

    def rename(self, value: str, name: str) -> None:
        """Give a value an additional, chosen name."""
        self._nodes[-1].append(helper.make_node("Identity", [value], [name], name=f"{name}/name"))

    @property
    def nodes(self) -> list[onnx.NodeProto]:
        """The nodes of the outermost graph."""
        return self._nodes[0]

    def add(self, a: str, b: str) -> str:
        """Return a + b."""
        return self.op("Add", a, b)

    def sub(self, a: str, b: str) -> str:
        """Return a - b."""
        return self.op("Sub", a, b)

    def mul(self, a: str, b: str) -> str:
        """Return a * b."""
        return self.op("Mul", a, b)

    def minimum(self, a: str, b: str) -> str:
        """Return the smaller of two numbers, by comparison (see the module)."""
        return self.op("Where", self.op("Less", a, b), a, b)

    def maximum(self, a: str, b: str) -> str:
        """Return the larger of two numbers, by comparison (see the module)."""
        return self.op("Where", self.op("Greater", a, b), a, b)

    def floor_shift(self, x: str, shift: int | Sequence[int] | IntArray) -> str:
        """Return floor(x / 2**shift) for shift 0 .. 63, one for all or one per column."""
        shifts = np.array(shift, dtype=np.int64)
        if not shifts.any():
            return x
        while (shifts > 62).any():  # 2**63 is no int64
            x = self.floor_shift(x, (shifts > 62).astype(np.int64))
            shifts = shifts - (shifts > 62)
        divisor = self.constant(np.left_shift(1, shifts))
        return self.op("Div", self.sub(x, self.op("Mod", x, divisor)), divisor)

    def round_shift(self, x: str, shift: int | Sequence[int] | IntArray) -> str:
        """Return x / 2**shift to the nearest integer, halves upwards, for shift 0 .. 62."""
        shifts = np.array(shift, dtype=np.int64)
        if not shifts.any():
            return x
        half = np.left_shift(1, shifts) >> 1
        return self.floor_shift(self.add(x, self.constant(half)), shifts)

    def shift_left(self, x: str, shift: int) -> str:
        """Return x * 2**shift."""
        return x if shift == 0 else self.mul(x, self.constant(1 << shift))

    def saturate(self, x: str, low: ArrayLike, high: ArrayLike) -> str:
        """Return x limited to low .. high, each a number or one per column."""
        return self.minimum(self.maximum(x, self.constant(low)), self.constant(high))

    def flag(self, condition: str, weight: int = 1) -> str:
        """Return `weight` where a condition holds, else 0."""
        number = self.op("Cast", condition, to=TensorProto.INT64)
        return number if weight == 1 else self.mul(number, self.constant(weight))

    def column(self, x: str, index: int) -> str:
        """Return column `index` of a batch of vectors [B, n], as [B]."""
        return self.op("Gather", x, self.constant(index), axis=1)

    def zeros(self, x: str, width: int) -> str:
        """Return [B, width] zeros for the batch of x [B, n]."""
        zero = self.mul(self.op("Gather", x, self.constant([0]), axis=1), self.constant(0))
        return self.op("Tile", zero, self.constant([1, width]))

    def stack(self, scalars: Sequence[str]) -> str:
        """Return scalars [B] side by side, as [B, n]."""
        columns = [self.op("Unsqueeze", s, self.constant([1])) for s in scalars]
        return columns[0] if len(columns) == 1 else self.op("Concat", *columns, axis=1)

    def split(self, x: str, sizes: Sequence[int]) -> list[str]:
        """Return the parts of a batch of vectors [B, sum(sizes)]."""
        return self.ops("Split", len(sizes), x, self.constant(sizes), axis=1)

    @contextmanager
    def subgraph(self) -> Iterator[list[onnx.NodeProto]]:
        """Collect the nodes written inside for a subgraph."""
        self._nodes.append([])
        yield self._nodes[-1]
        self._nodes.pop()

    def scan(
        self,
        body: Body,
        carried: Sequence[tuple[str, Shape]],
        scanned: Sequence[tuple[str, Shape]],
        outputs: Sequence[tuple[int, Shape]],
    ) -> list[str]:
        """Add a Scan over the first axis of the scanned values.

        Args:
            body: called once with the names of the carried values and of one slice of each scanned
                value; returns the next carried values and what is collected.
            carried: initial values and their shapes.
            scanned: values and the shapes of their slices.
            outputs: element types and shapes of one slice of what is collected.

        Returns:
            The last carried values, then the collected ones, all int64 unless `outputs` says else.
        """
        ins = [(self.name("carried"), shape) for _, shape in carried]
        slices = [(self.name("slice"), shape) for _, shape in scanned]
        with self.subgraph() as nodes:
            after, collected = body([n for n, _ in ins], [n for n, _ in slices])
            # a body's output may not be its input or another output: each gets a name of its own
            results = [self.op("Identity", name) for name in (*after, *collected)]
            shapes = [(TensorProto.INT64, shape) for _, shape in carried] + list(outputs)
            graph = helper.make_graph(
                nodes,
                self.name("body"),
                [
                    helper.make_tensor_value_info(n, TensorProto.INT64, s)
                    for n, s in (*ins, *slices)
                ],
                [
                    helper.make_tensor_value_info(n, kind, shape)
                    for n, (kind, shape) in zip(results, shapes, strict=True)
                ],
            )
        names = [n for n, _ in (*carried, *scanned)]
        return self.ops("Scan", len(results), *names, body=graph, num_scan_inputs=len(scanned))

    def repeat(
        self,
        times: int,
        body: Callable[[Sequence[str]], Sequence[str]],
        carried: Sequence[tuple[str, Shape]],
    ) -> list[str]:
        """Add a Loop that runs `body` over the carried int64 values a fixed number of times."""
        ins = [(self.name("carried"), shape) for _, shape in carried]
        turn, go, still = self.name("turn"), self.name("go"), self.name("still")
        with self.subgraph() as nodes:
            results = [self.op("Identity", name) for name in body([n for n, _ in ins])]
            nodes.append(helper.make_node("Identity", [go], [still], name=still))
            graph = helper.make_graph(
                nodes,
                self.name("body"),
                [
                    helper.make_tensor_value_info(turn, TensorProto.INT64, []),
                    helper.make_tensor_value_info(go, TensorProto.BOOL, []),
                    *(helper.make_tensor_value_info(n, TensorProto.INT64, s) for n, s in ins),
                ],
                [
                    helper.make_tensor_value_info(still, TensorProto.BOOL, []),
                    *(
                        helper.make_tensor_value_info(n, TensorProto.INT64, shape)
                        for n, (_, shape) in zip(results, carried, strict=True)
                    ),
                ],
            )
        return self.ops(
            "Loop", len(results), self.constant(times), "", *(n for n, _ in carried), body=graph
        )

    def either(
        self,
        condition: str,
        then: Callable[[], Sequence[str]],
        otherwise: Callable[[], Sequence[str]],
        shapes: Sequence[Shape],
    ) -> list[str]:
        """Add an If with int64 results."""
        branches = {}
        for key, branch in (("then_branch", then), ("else_branch", otherwise)):
            with self.subgraph() as nodes:
                results = [self.op("Identity", name) for name in branch()]
                branches[key] = helper.make_graph(
                    nodes,
                    self.name(key),
                    [],
                    [
                        helper.make_tensor_value_info(n, TensorProto.INT64, shape)
                        for n, shape in zip(results, shapes, strict=True)
                    ],
                )
        return self.ops("If", len(shapes), condition, **branches)
