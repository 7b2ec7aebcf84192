"""`zerodrift verify`: the files of the firmware folder and of build/, against the model."""

from pathlib import Path
from typing import TYPE_CHECKING

import click

from zerodrift.base.errors import CheckError, InputError
from zerodrift.base.progress import Progress
from zerodrift.cli.common import (
    directory_option,
    is_trusted,
    json_option,
    print_result,
    sensor_option,
    trust_option,
)
from zerodrift.tasks.trust import require_code

if TYPE_CHECKING:
    from collections.abc import Mapping

    from zerodrift.base.config import Config
    from zerodrift.verify.replay import Replay


@click.command()
@directory_option
@sensor_option
@trust_option
@json_option
@click.option(
    "--require",
    "required",
    metavar="CORE",
    multiple=True,
    help="Fail unless this was checked: a core such as cortex-m4, host, onnx, certificate or"
    " manifest."
    " May be given more than once.",
)
@click.option(
    "--certificate",
    is_flag=True,
    help="Do this alone: derive every bound of certificate.json again from the C. Needs no"
    " compiler.",
)
@click.option(
    "--prove",
    "proves",
    is_flag=True,
    help="Instead, show for every input that the C is the specification, part by part, and kernels"
    " in assembly from their object code.",
)
@click.option(
    "--elf",
    metavar="FILE",
    type=click.Path(path_type=Path, dir_okay=False, exists=True),
    help="With --prove: prove the kernels in assembly of this program too, your own build as the"
    " linker wrote it, not stripped.",
)
def command(
    directory: Path,
    sensor: str | None,
    as_json: bool,
    required: tuple[str, ...],
    certificate: bool,
    proves: bool,
    elf: Path | None,
) -> None:
    """Build and run what lies in the firmware folder, and hold it against the model.

    Every file is compared with firmware/manifest.json; the folder's own C and runtime are compiled
    in each of their layouts, for this host and for emulated cores, and run with build/integer.onnx
    over the golden vectors; names in the header are compared with the model, and every bound of
    certificate.json is derived again from the C. What cannot run here is told as not checked.

    Nothing is built or run of files that differ from the manifest, unless by --trust; the lines in
    which they differ from what is generated are told. C that this user's own zerodrift did not
    write is asked about first, once for each content.

    Exit code 1: a file was changed, is missing or stale, a bit or a name in the header differs, a
    claim of the certificate does not hold, a core of --require was not checked, or with --prove
    something is not proven.
    """
    from zerodrift.base.journal import read_together
    from zerodrift.cli.console import show_progress
    from zerodrift.fleet.sensors import load_unit
    from zerodrift.tasks.project import ProjectFolder, refuse_shared_program
    from zerodrift.verify.replay import replay

    if elf is not None and not proves:
        raise InputError("--elf goes with --prove: `zerodrift verify --prove --elf FILE`")
    refuse_shared_program(ProjectFolder(directory, sensor))
    config = load_unit(directory, sensor)
    if proves:
        _prove(config, as_json, elf)
        return
    if certificate:
        _check_certificate(config.firmware_out, as_json)
        return
    folders = (config.build_directory, config.firmware_out)
    with show_progress("verifying") as say:
        outcome = read_together(
            directory, folders, lambda: replay(config, say, required, consent=_Consent(config, say))
        )
    if as_json:
        print_result(outcome.summarise())
    outcome.require(required)
    if not as_json:
        _print(outcome)


class _Consent:
    """What the user agrees to have built and run; see `zerodrift.verify.replay.Consent`."""

    def __init__(self, config: "Config", progress: Progress) -> None:
        self.despite_changes = is_trusted()
        self._folder = config.firmware_out
        self._progress = progress

    def require(self, texts: "Mapping[str, str]") -> None:
        require_code(texts, self._folder, self._progress)


def _print(outcome: "Replay") -> None:
    if outcome.bit_exact:
        click.echo(
            f"bit-exact: {outcome.vectors} steps on the host, the golden vectors on"
            f" {' = '.join(outcome.backends)}, 0 LSB (model {outcome.model_hash[:12]})"
        )
    if outcome.certificate.holds:
        click.echo(
            f"no overflow for any input: {outcome.certificate.holds} claims of certificate.json,"
            " each derived again from the C"
        )
    for text in outcome.forced:
        click.echo(f"FORCED when it was built: {text}")
    for missing in outcome.not_checked:
        click.echo(f"NOT CHECKED: {missing.what}: {missing.why}")


def _prove(config: "Config", as_json: bool, elf: Path | None) -> None:
    """Print what is proven of the C, part by part, and of a program; needs the model's file and
    the firmware folder."""
    from zerodrift.base.errors import InputError
    from zerodrift.blocks.design import FILE_NAME as DESIGN

    if (config.firmware_out / DESIGN).is_file():
        raise InputError(
            f"{config.firmware_out / DESIGN}: the numbers of this C lie in a block, which --prove"
            " does not read yet. `zerodrift verify` compares bits with the block in place, and"
            " `zerodrift verify --certificate` shows that no block that the chip accepts overflows."
        )
    from zerodrift.cli.console import show_progress
    from zerodrift.export.model_files import load_model
    from zerodrift.report.results import ProofResult, ProvenPart
    from zerodrift.verify.prove import is_proven, list_shown
    from zerodrift.verify.prove_parts import OPEN, TESTED
    from zerodrift.verify.prove_reader import SYSTEM
    from zerodrift.verify.replay import read_code

    model = load_model(config.build_directory / "model.json")
    code = read_code(model, config.firmware_out)
    texts = {code.header_name: code.header, code.source_name: code.source, **(code.runtime or {})}
    # a compiler that searches the folder first would take these for C's own
    hiding = {name: "" for name in SYSTEM if (config.firmware_out / name).exists()}
    with show_progress("proving") as say:
        shown = tuple(list_shown(model, texts | hiding, say, objects=True, program=elf))
    proven = is_proven(shown)
    if as_json:
        parts = tuple(ProvenPart(one.what, one.build, one.verdict, one.why) for one in shown)
        print_result(ProofResult(proven, model.hash, parts))
    else:
        for one in shown:
            if one.verdict == TESTED:
                click.echo(f"TESTED, NOT PROVEN: {_name(one.what, one.build)}{_because(one.why)}")
    if not proven:
        left = [one for one in shown if one.verdict == OPEN]
        lines = "\n  ".join(f"{_name(one.what, one.build)}: {one.why}" for one in left)
        raise CheckError(
            f"{config.firmware_out}: {len(left)} of {len(shown)} parts of the C are not proven to"
            f" be what the model says:\n  {lines}\nRun `zerodrift verify`, which compares bits; if"
            " that fails too, do not flash this C."
        )
    if not as_json:
        count = sum(one.verdict != TESTED for one in shown)
        click.echo(
            f"proven: {count} parts of C and object code compute what the specification says of"
            f" model {model.hash[:12]}, for every input and state"
        )


def _because(why: str) -> str:
    return f": {why}" if why else ""


def _name(what: str, build: str) -> str:
    return f"{what} ({build})" if build else what


def _check_certificate(folder: Path, as_json: bool) -> None:
    """Print which claims hold; needs nothing but the firmware folder."""
    from zerodrift.cli.console import show_progress
    from zerodrift.report.results import CertificateResult
    from zerodrift.verify.certificate import FILE_NAME
    from zerodrift.verify.certificate_check import check_certificate

    if not (folder / FILE_NAME).is_file():
        raise InputError(
            f"{folder / FILE_NAME}: there is no certificate. Run `zerodrift firmware`."
        )
    with show_progress("deriving every bound again from the C"):
        outcome = check_certificate(folder)
    if as_json:
        word = "refused" if outcome.failures else "holds"
        print_result(CertificateResult(word, outcome.holds, tuple(outcome.failures)))
    if outcome.failures:
        lines = "\n  ".join(outcome.failures)
        raise CheckError(
            f"{folder / FILE_NAME} is refused; {outcome.holds} claims hold, these do not:\n"
            f"  {lines}\nDo not flash this C; run `zerodrift firmware` again."
        )
    if not as_json:
        click.echo(
            f"certificate holds: {outcome.holds} bounds and shifts derived again from the C alone,"
            " for any input"
        )
