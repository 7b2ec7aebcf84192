"""Builds a generated model for the host and holds it against the reference on every sequence."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from zerodrift.base.arrays import IntArray
from zerodrift.base.errors import CheckError
from zerodrift.c_runtime.compilers import find_compiler
from zerodrift.c_runtime.host import HostModel
from zerodrift.codegen.generate import GeneratedCode
from zerodrift.export.integer_model import IntegerModel
from zerodrift.export.reference import Reference
from zerodrift.operations.arithmetic import CodeArray
from zerodrift.verify.host_check import HostCheck, check_host
from zerodrift.verify.mismatch import Mismatch, find_mismatch
from zerodrift.verify.onnx_model import OnnxModel

# Proves the integer ONNX equal to the host C, which is shown equal to the reference beside it.
#
# The C runs through the whole sequence; onnxruntime starts a batch of chunks from the states that
# the C hands over, as in `zerodrift.verify.host_check`.


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


# Builds a generated model for the host and holds it against the reference on every sequence.

Progress = Callable[[str], None]


@dataclass(frozen=True)
class Failure:
    """A back end that differs, and where."""

    backend: str
    sequence: str
    mismatch: Mismatch

    def __str__(self) -> str:
        return f"{self.backend}, sequence '{self.sequence}', {self.mismatch}"


@dataclass(frozen=True)
class FirmwareCheck:
    """What was compared, and the first failure if there was one."""

    vectors: int
    """Steps compared, each with all nodes, states, flags and drifts."""
    backends: tuple[str, ...]
    failure: Failure | None
    host: HostModel
    """The plain host build, exactly the source that is flashed."""
    observed: HostModel
    """The host build that tells every node's value."""

    def require(self) -> "FirmwareCheck":
        """Return self.

        Raises:
            CheckError: the C is not the reference's equal; names the first difference.
        """
        if self.failure is not None:
            raise CheckError(f"the C differs from the reference: {self.failure}. Nothing written.")
        return self


def check_firmware(
    model: IntegerModel,
    code: GeneratedCode,
    sequences: Mapping[str, CodeArray],
    directory: Path,
    progress: Progress = lambda _: None,
) -> FirmwareCheck:
    """Compare host builds with the reference, and the integer ONNX with both.

    Each is run twice: with every node observed, and as it is flashed or handed over.

    Args:
        model: the integer model.
        code: its C.
        sequences: name -> raw codes [T, C].
        directory: for the host builds.
        progress: is told what is being done.
    """
    compiler = find_compiler()
    progress(f"compiling for the host with {compiler.name}")
    observed = HostModel(model, code, directory / "observed", compiler)
    plain = HostModel(model, code, directory / "plain", compiler, observe=False)
    backends = ("reference", "host")
    runtimes = [OnnxModel(model, observe=observe) for observe in (True, False)]
    vectors = 0
    for name, codes in sequences.items():
        for settled in (True, False):
            part = codes if settled else codes[:2000]
            progress(f"comparing '{name}', {len(part)} steps")
            for backend, host in (("host", observed), ("host as flashed", plain)):
                outcome = check_host(host, part, settled=settled)
                if outcome.mismatch is not None:
                    failure = Failure(backend, name, outcome.mismatch)
                    return FirmwareCheck(vectors, backends, failure, plain, observed)
            for runtime, host in zip(runtimes, (observed, plain), strict=True):
                outcome = check_onnx(runtime, host, part, settled=settled)
                if outcome.mismatch is not None:
                    failure = Failure("onnx", name, outcome.mismatch)
                    return FirmwareCheck(vectors, backends, failure, plain, observed)
            vectors += len(part)
    if plain.selftest() != 0:
        failure = Failure("host self-test", "selftest", Mismatch(0, "selftest", 0, 1))
        return FirmwareCheck(vectors, backends, failure, plain, observed)
    return FirmwareCheck(vectors, (*backends, "onnx"), None, plain, observed)
