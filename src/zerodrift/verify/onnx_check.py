"""Proves the integer ONNX equal to the host C, which is shown equal to the reference beside it.

The C runs through the whole sequence; onnxruntime starts a batch of chunks from the states that the
C hands over, as in `zerodrift.verify.host_check`.
"""

import numpy as np

from zerodrift.c_runtime.host import HostModel
from zerodrift.export.reference import Reference
from zerodrift.operations.arithmetic import CodeArray, IntArray
from zerodrift.verify.host_check import HostCheck, check_host
from zerodrift.verify.mismatch import find_mismatch
from zerodrift.verify.onnx_model import OnnxModel


def check_onnx(
    runtime: OnnxModel, host: HostModel, codes: CodeArray, *, settled: bool = True
) -> HostCheck:
    """Compare onnxruntime with a host build at every step, and its start with the reference's.

    Args:
        runtime: the integer ONNX; observes its nodes if and only if the host does.
        host: the compiled model.
        codes: [T, C] one sequence of raw inputs.
        settled: start from `settle` rather than `init`.
    """
    start = Reference(runtime.model).start(codes[:1].astype(np.int64), settled=settled)
    first = codes[None, :1]
    own = runtime.run(first, settled=settled).state
    continued = runtime.run(first, state=start.pack()).state
    labels = [f"state[{n}]" for n in range(own.shape[1])]
    mismatch = find_mismatch(runtime.model, continued, own, labels)
    if mismatch is not None:
        return HostCheck(0, own.size, mismatch)

    def run(batch: CodeArray, state: IntArray) -> tuple[IntArray, IntArray]:
        trace = runtime.run(batch, state=state)
        flags = trace.flags[:, :, None].astype(np.int64)
        values = np.concatenate([trace.nodes, flags, trace.drift.astype(np.int64)], axis=2)
        return values, trace.state

    return check_host(host, codes, settled=settled, peer=run)
