"""Float ONNX graphs made by hand, as other exporters write them."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import onnx
from numpy.typing import NDArray
from onnx import TensorProto, helper, numpy_helper

Array = NDArray[np.float64]


class Graph:
    """Collects nodes and constants; values go by their names."""

    def __init__(self, opset: int = 17) -> None:
        self.nodes: list[onnx.NodeProto] = []
        self.constants: list[onnx.TensorProto] = []
        self.opset = opset

    def constant(self, value: Any, dtype: Any = np.float32) -> str:
        name = f"c{len(self.constants)}"
        self.constants.append(numpy_helper.from_array(np.array(value, dtype=dtype), name))
        return name

    def op(self, op_type: str, *inputs: str, outputs: int = 1, **attributes: Any) -> Any:
        names = [f"v{len(self.nodes)}_{i}" for i in range(outputs)]
        node = helper.make_node(
            op_type, list(inputs), names, name=f"{op_type}_{len(self.nodes)}", **attributes
        )
        self.nodes.append(node)
        return names[0] if outputs == 1 else names

    def gru(
        self,
        x: str,
        rng: np.random.Generator,
        features: int,
        hidden: int,
        initial: str = "",
        scale: float = 0.6,
        **attributes: Any,
    ) -> tuple[str, str]:
        """Add a GRU with random weights; return Y and Y_h."""
        weights = [
            rng.normal(scale=scale, size=shape)
            for shape in ((1, 3 * hidden, features), (1, 3 * hidden, hidden), (1, 6 * hidden))
        ]
        names = [self.constant(w) for w in weights]
        y, y_h = self.op("GRU", x, *names, "", initial, outputs=2, hidden_size=hidden, **attributes)
        return y, y_h

    def build(
        self,
        inputs: dict[str, Sequence[str | int]],
        outputs: Sequence[str],
        domains: Sequence[str] = (),
    ) -> bytes:
        graph = helper.make_graph(
            self.nodes,
            "g",
            [helper.make_tensor_value_info(n, TensorProto.FLOAT, s) for n, s in inputs.items()],
            [helper.make_tensor_value_info(n, TensorProto.FLOAT, None) for n in outputs],
            self.constants,
        )
        opsets = [helper.make_opsetid("", self.opset)]
        opsets += [helper.make_opsetid(domain, 1) for domain in domains]
        model = helper.make_model(graph, opset_imports=opsets, ir_version=8)
        inferred = onnx.shape_inference.infer_shapes(model)
        for output, known in zip(model.graph.output, inferred.graph.output, strict=True):
            output.type.CopyFrom(known.type)
            output.type.tensor_type.shape.SetInParent()  # a file without it is not valid
        return bytes(model.SerializeToString())


def keras(
    form: str,
    reset_after: bool,
    opset: int = 17,
    mean: Sequence[float] = (0.3, -0.2, 0.5),
    gain: Sequence[float] = (0.7, 0.7, 0.7),
) -> bytes:
    """Return what tf2onnx makes of Normalization, GRU and Dense; batch first, dynamic batch.

    Args:
        form: "last" (return_sequences=False), "sequence" (a Dense on each step as MatMul and Add),
            or "reshaped" (the same through a reshape to [batch * time, units] and back).
        reset_after: Keras' flag, the default of TensorFlow 2.
        opset: 17, or an old one where axes are attributes.
        mean: taken off the features.
        gain: then applied to them.
    """
    g, rng = Graph(opset), np.random.default_rng(3)

    def squeeze(x: str, axis: int) -> str:
        if opset < 13:
            return str(g.op("Squeeze", x, axes=[axis]))
        return str(g.op("Squeeze", x, g.constant([axis], np.int64)))

    centred = g.op("Sub", "x", g.constant(np.reshape(mean, (1, 1, 3))))
    scaled = g.op("Mul", centred, g.constant(gain))
    shape = g.op("Shape", scaled)
    batch = (
        g.op("Slice", shape, starts=[0], ends=[1], axes=[0])
        if opset < 10
        else g.op("Slice", shape, g.constant([0], np.int64), g.constant([1], np.int64))
    )
    sizes = g.op("Concat", g.constant([1], np.int64), batch, g.constant([6], np.int64), axis=0)
    zeros = g.op("Expand", g.constant(np.zeros((1, 1, 1))), sizes)
    y, y_h = g.gru(
        g.op("Transpose", scaled, perm=[1, 0, 2]),
        rng,
        3,
        6,
        zeros,
        linear_before_reset=int(reset_after),
    )
    kernel, bias = g.constant(rng.normal(size=(6, 2))), g.constant(rng.normal(size=2))
    if form == "last":
        answer = g.op("Add", g.op("MatMul", squeeze(y_h, 0), kernel), bias)
    else:
        steps = g.op("Transpose", squeeze(y, 1), perm=[1, 0, 2])
        if form == "sequence":
            answer = g.op("Add", g.op("MatMul", steps, kernel), bias)
        else:
            flat = g.op("Reshape", steps, g.constant([-1, 6], np.int64))
            dense = g.op("Add", g.op("MatMul", flat, kernel), bias)
            two = g.op("Slice", g.op("Shape", steps), *(g.constant([n], np.int64) for n in (0, 2)))
            back = g.op("Concat", two, g.constant([2], np.int64), axis=0)
            answer = g.op("Reshape", dense, back)
    return g.build({"x": ("batch", "time", 3)}, [answer])
