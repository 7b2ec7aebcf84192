"""Builds a generated model for the host and holds it against the reference on every sequence."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from zerodrift.base.errors import CheckError
from zerodrift.c_runtime.compilers import find_compiler
from zerodrift.c_runtime.host import HostModel
from zerodrift.codegen.generate import GeneratedCode
from zerodrift.export.integer_model import IntegerModel
from zerodrift.operations.arithmetic import CodeArray
from zerodrift.verify.host_check import check_host
from zerodrift.verify.mismatch import Mismatch
from zerodrift.verify.onnx_check import check_onnx
from zerodrift.verify.onnx_model import OnnxModel

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
