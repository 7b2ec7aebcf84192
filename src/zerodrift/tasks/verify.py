"""`verify`: the files of the firmware folder and of build/, against the model."""

import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from zerodrift.base.errors import CheckError, InputError
from zerodrift.base.journal import read_together
from zerodrift.base.progress import SILENT, Progress
from zerodrift.blocks.design import FILE_NAME as DESIGN
from zerodrift.c_runtime.cores import MEMORY, find_cross_compilers
from zerodrift.codegen.identifiers import name_prefix
from zerodrift.export.integer_model import IntegerModel
from zerodrift.export.model_files import load_model
from zerodrift.report.results import CertificateResult, ProofResult, ProvenPart
from zerodrift.tasks.project import ProjectFolder, refuse_shared_program
from zerodrift.tasks.trust import require_code
from zerodrift.verify.certificate import FILE_NAME as CERTIFICATE
from zerodrift.verify.checkers import (
    BuildError,
    NoCompilerError,
    ObjectBuild,
    ProgramError,
    ShownPart,
    list_shown,
    read_model,
)
from zerodrift.verify.replay import Replay, read_code, replay

# That the C is the specification, as zerodrift-proof shows it; builds the object code it asks
# for.

PROGRAM = """\
#include "{prefix}.c"
#include "zd_runtime.c"
{memory}{prefix}_state_t state;
{prefix}_input_t input;
int32_t drift[{count}];
void _start(void);
void _start(void) {{
    {prefix}_settle(&state, &input);
    (void){prefix}_step(&state, &input, drift);
}}
"""


def prove_model(
    model: IntegerModel,
    texts: Mapping[str, str],
    progress: Callable[[str], None] = lambda _: None,
    program: Path | None = None,
) -> tuple[ShownPart, ...]:
    """Return what is shown of a model's C, and of the object code of its kernels in assembly.

    Args:
        model: as its file has it.
        texts: file name -> content, of the model's header and source and of the runtime.
        progress: is told what is being done.
        program: a user's own program, whose kernels in assembly are proven too.

    Raises:
        InputError: `program` cannot be read, or holds no kernel of the model.
    """
    prefix, outputs = name_prefix(model), len(model.outputs)

    def build(one: ObjectBuild) -> bytes:
        with tempfile.TemporaryDirectory() as scratch:
            try:
                return build_program(texts, prefix, outputs, one, Path(scratch)).read_bytes()
            except InputError as error:
                raise NoCompilerError(str(error)) from error
            except CheckError as error:
                raise BuildError(str(error)) from error

    read = read_model(model.to_json())
    try:
        return tuple(list_shown(read, texts, progress, objects=build, program=program))
    except ProgramError as error:
        raise InputError(str(error)) from error


def build_program(
    texts: Mapping[str, str], prefix: str, outputs: int, build: ObjectBuild, folder: Path
) -> Path:
    """Compile and link a model's C for a core.

    Args:
        texts: file name -> content, of the model's header and source and of the runtime.
        prefix: of the model's names.
        outputs: how many it has.
        build: what to build it for.
        folder: to build it in.

    Raises:
        InputError: there is no compiler.
        CheckError: the C does not compile.
    """
    compilers = find_cross_compilers(build.core)
    if not compilers:
        raise InputError(f"no compiler for {build.core}: `pip install ziglang`")
    for name, text in texts.items():
        (folder / name).write_text(text, encoding="utf-8")
    main, program = folder / "zd_proof.c", folder / "proof.elf"
    main.write_text(PROGRAM.format(memory=MEMORY, prefix=prefix, count=outputs), encoding="utf-8")
    free = ["-std=c99", "-O2", *build.flags, "-ffreestanding", f"-I{folder}", str(main)]
    if compilers[0].name == "gcc":
        free += ["-nostdlib", "-Wl,-Ttext=0x10000,-Tdata=0x100000,--no-relax", "-lgcc"]
    compilers[0].run([*free, "-o", str(program)])
    return program


# `verify`: the files of the firmware folder and of build/, against the model.


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

    model = load_model(config.build_directory / "model.json")
    code = read_code(model, config.firmware_out)
    texts = {code.header_name: code.header, code.source_name: code.source, **(code.runtime or {})}
    # a compiler that searches the folder first would take these for C's own
    hiding = {name: "" for name in SYSTEM if (config.firmware_out / name).exists()}
    progress("proving")
    shown = prove_model(model, texts | hiding, progress, request.elf)
    parts = tuple(ProvenPart(one.what, one.build, one.verdict, one.why) for one in shown)
    return ProofResult(is_proven(shown), model.hash, parts)
