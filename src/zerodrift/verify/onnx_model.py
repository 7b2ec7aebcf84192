"""The integer ONNX run by onnxruntime: a back end like any other."""

from dataclasses import dataclass

import numpy as np
import onnxruntime
from numpy.typing import NDArray
from onnxruntime.capi import onnxruntime_pybind11_state

from zerodrift.base.arrays import IntArray
from zerodrift.base.errors import CheckError
from zerodrift.export.integer_model import IntegerModel
from zerodrift.export.integer_onnx import (
    START_COLD,
    START_GO_ON,
    START_SETTLED,
    build_integer_onnx,
    list_state,
)
from zerodrift.operations.arithmetic import CodeArray

REFUSALS: tuple[type[Exception], ...] = (
    ValueError,
    RuntimeError,
    *(
        kind
        for kind in vars(onnxruntime_pybind11_state).values()
        if isinstance(kind, type) and issubclass(kind, Exception)
    ),
)
"""What onnxruntime raises where a file is damaged or is another model's."""


@dataclass(frozen=True)
class OnnxTrace:
    """What onnxruntime gave for a batch of sequences."""

    drift: NDArray[np.int32]  # [B, T, K]
    flags: NDArray[np.uint32]  # [B, T]
    nodes: IntArray
    """[B, T, N] the values of all nodes in order; N = 0 if not observed."""
    state: IntArray
    """[B, n] the state afterwards, in the order of `ModelState.pack`."""


class OnnxModel:
    """An integer model in onnxruntime, on one thread of the CPU.

    Args:
        model: the integer model.
        observe: record every node's value; False runs the file exactly as it is written for users.
        content: the file to run, without its nodes' values; made anew if None.

    Raises:
        CheckError: onnxruntime does not take the file.
    """

    def __init__(
        self, model: IntegerModel, *, observe: bool = True, content: bytes | None = None
    ) -> None:
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = options.inter_op_num_threads = 1
        options.log_severity_level = 3
        self.model = model
        if content is None:
            content = build_integer_onnx(model, observe=observe)
        elif observe:
            raise ValueError("a file as it lies there has no nodes to observe")
        try:
            self._session = onnxruntime.InferenceSession(
                content, options, providers=["CPUExecutionProvider"]
            )
        except REFUSALS as error:
            raise CheckError(f"onnxruntime does not take the file: {error}") from error
        self._fields = list_state(model)
        self._observed = [f"node:{node.name}" for node in model.nodes] if observe else []

    def run(
        self,
        codes: CodeArray,
        *,
        settled: bool = True,
        state: IntArray | None = None,
    ) -> OnnxTrace:
        """Run T steps over codes [B, T, C], from a packed state [B, n] or from a start."""
        batch, steps, _ = codes.shape
        feed: dict[str, NDArray[np.generic]] = {
            "codes": np.ascontiguousarray(codes.swapaxes(0, 1), dtype=self.model.code_type),
            "start": np.array(
                START_GO_ON if state is not None else START_SETTLED if settled else START_COLD
            ),
        }
        column = 0
        for name, shape in self._fields.items():
            size = int(np.prod(shape, dtype=np.int64))
            part = np.zeros((batch, size)) if state is None else state[:, column : column + size]
            feed[name] = part.reshape((batch, *shape)).astype(np.int64)
            column += size
        ends = [f"{name}.next" for name in self._fields]
        try:
            results = self._session.run(["drift", "flags", *ends, *self._observed], feed)
        except REFUSALS as error:
            raise CheckError(f"onnxruntime cannot run the file: {error}") from error
        drift, flags = results[:2]
        after = [end.reshape(batch, -1) for end in results[2 : 2 + len(ends)]]
        nodes = [value.reshape(steps, batch, -1) for value in results[2 + len(ends) :]]
        return OnnxTrace(
            drift=np.ascontiguousarray(drift.swapaxes(0, 1)),
            flags=np.ascontiguousarray(flags.T),
            nodes=np.ascontiguousarray(np.concatenate(nodes, axis=2).swapaxes(0, 1))
            if nodes
            else np.empty((batch, steps, 0), dtype=np.int64),
            state=np.concatenate(after, axis=1),
        )
