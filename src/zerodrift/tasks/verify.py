"""`verify`: the files of the firmware folder and of build/, against the model."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from zerodrift.base.errors import InputError
from zerodrift.base.journal import read_together
from zerodrift.base.progress import SILENT, Progress
from zerodrift.blocks.design import FILE_NAME as DESIGN
from zerodrift.export.model_files import load_model
from zerodrift.report.results import CertificateResult, ProofResult, ProvenPart
from zerodrift.tasks.project import ProjectFolder, refuse_shared_program
from zerodrift.tasks.trust import require_code
from zerodrift.verify.certificate import FILE_NAME as CERTIFICATE
from zerodrift.verify.replay import Replay, read_code, replay


@dataclass(frozen=True)
class VerifyRequest:
    """Which firmware is verified, and what has to be."""

    project: ProjectFolder
    required: tuple[str, ...] = ()
    """What must have been checked, such as a core."""
    despite_changes: bool = False
    """Build and run files, too, that differ from the manifest."""
    elf: Path | None = None
    """Of `prove`: a program whose kernels in assembly are proven with the folder's."""


def verify(request: VerifyRequest, progress: Progress = SILENT) -> Replay:
    """Build and run what lies in the firmware folder, and hold it against the model.

    Raises:
        InputError: there is no firmware, or the user does not agree to have its C run.
    """
    refuse_shared_program(request.project)
    config = request.project.config
    consent = _Consent(request.despite_changes, config.firmware_out, progress)
    return read_together(
        request.project.directory,
        (config.build_directory, config.firmware_out),
        lambda: replay(config, progress, request.required, consent=consent),
    )


@dataclass
class _Consent:
    """What the user agrees to have built and run; see `zerodrift.verify.replay.Consent`."""

    despite_changes: bool
    folder: Path
    progress: Progress

    def require(self, texts: Mapping[str, str]) -> None:
        """Ask for C of somebody else."""
        require_code(texts, self.folder, self.progress)


def check_folder(request: VerifyRequest, progress: Progress = SILENT) -> CertificateResult:
    """Derive every bound of a firmware folder's certificate again; nothing else is looked at.

    Raises:
        InputError: there is no certificate.
    """
    refuse_shared_program(request.project)
    from zerodrift.verify.checkers import check_certificate  # zerodrift-proof may be missing

    file = request.project.config.firmware_out / CERTIFICATE
    if not file.is_file():
        raise InputError(f"{file}: there is no certificate. Run `zerodrift firmware`.")
    progress("deriving every bound again from the C")
    outcome = check_certificate(file.parent)
    word = "refused" if outcome.failures else "holds"
    return CertificateResult(word, outcome.holds, tuple(outcome.failures))


def prove(request: VerifyRequest, progress: Progress = SILENT) -> ProofResult:
    """Return what is proven of the C, part by part, and of a program's kernels in assembly.

    Raises:
        InputError: there is no firmware, or its coefficients lie in a block.
    """
    refuse_shared_program(request.project)
    config = request.project.config
    if (config.firmware_out / DESIGN).is_file():
        raise InputError(
            f"{config.firmware_out / DESIGN}: the numbers of this C lie in a block, which --prove"
            " does not read yet. `zerodrift verify` compares bits with the block in place, and"
            " `zerodrift verify --certificate` shows that no block that the chip accepts overflows."
        )
    from zerodrift.verify.checkers import SYSTEM, is_proven  # zerodrift-proof may be missing
    from zerodrift.verify.proof import prove_model

    model = load_model(config.build_directory / "model.json")
    code = read_code(model, config.firmware_out)
    texts = {code.header_name: code.header, code.source_name: code.source, **(code.runtime or {})}
    # a compiler that searches the folder first would take these for C's own
    hiding = {name: "" for name in SYSTEM if (config.firmware_out / name).exists()}
    progress("proving")
    shown = prove_model(model, texts | hiding, progress, request.elf)
    parts = tuple(ProvenPart(one.what, one.build, one.verdict, one.why) for one in shown)
    return ProofResult(is_proven(shown), model.hash, parts)
