"""The file of a trained recurrent network, run by onnxruntime: PyTorch is not needed."""

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from zerodrift.base.arrays import Array
from zerodrift.operations.gru.cell import FloatGru
from zerodrift.operations.lstm.cell import FloatLstm
from zerodrift.train.onnx_export import read_onnx_recurrent

if TYPE_CHECKING:
    import onnxruntime


WINDOWS_AT_ONCE = 4096


@dataclass(frozen=True)
class OnnxNetwork:
    """What `zerodrift.train.onnx_export.build_onnx` wrote."""

    content: bytes

    def run(self, features: Array, window: int) -> Array:
        """Return the network's drift [n, K] for features [n, I] of a run that starts at rest.

        Args:
            features: of the whole run.
            window: samples that each answer is from; 0 carries the state from sample to sample.
        """
        if not window:
            rest = self._cell.settle(features[:1])
            return self._ask(features[:, None, :], rest)[:, 0]
        padded = np.concatenate([np.repeat(features[:1], window - 1, axis=0), features])
        windows = np.lib.stride_tricks.sliding_window_view(padded, window, axis=0)  # [n, I, N]
        answers = []
        for begin in range(0, len(features), WINDOWS_AT_ONCE):
            part = windows[begin : begin + WINDOWS_AT_ONCE].transpose(2, 0, 1)
            zero = np.zeros((part.shape[1], self._carried))
            answers.append(self._ask(part, zero)[-1])
        return np.concatenate(answers)

    @cached_property
    def _cell(self) -> FloatGru | FloatLstm:
        return read_onnx_recurrent(self.content, "the trained network")

    @property
    def _carried(self) -> int:
        """Width of the state: h, of an LSTM beside c."""
        return int(self._cell.w_h.shape[1]) * (2 if isinstance(self._cell, FloatLstm) else 1)

    @cached_property
    def _session(self) -> "onnxruntime.InferenceSession":
        import onnxruntime

        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = options.inter_op_num_threads = 1
        options.log_severity_level = 3
        return onnxruntime.InferenceSession(
            self.content, options, providers=["CPUExecutionProvider"]
        )

    def _ask(self, features: Array, state: Array) -> Array:
        """Return drift [T, B, K] for features [T, B, I] and first states [B, carried]."""
        hidden = self._cell.w_h.shape[1]
        feed = {
            "features": np.ascontiguousarray(features, dtype=np.float32),
            "initial_h": state[None, :, :hidden].astype(np.float32),
        }
        if isinstance(self._cell, FloatLstm):
            feed["initial_c"] = state[None, :, hidden:].astype(np.float32)
        return np.asarray(self._session.run(["drift"], feed)[0], dtype=np.float64)
