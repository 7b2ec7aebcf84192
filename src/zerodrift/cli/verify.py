"""`zerodrift verify`: the files of the firmware folder and of build/, against the model."""

from pathlib import Path

import click

from zerodrift.base.errors import CheckError, InputError
from zerodrift.cli.common import (
    directory_option,
    is_trusted,
    json_option,
    print_result,
    sensor_option,
    trust_option,
)
from zerodrift.cli.console import show_progress
from zerodrift.report.results import CertificateResult, ProofResult
from zerodrift.tasks.project import ProjectFolder
from zerodrift.tasks.verify import VerifyRequest, check_folder, prove, verify
from zerodrift.verify.certificate import FILE_NAME as CERTIFICATE
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
    certificate.json is derived again from the C. What cannot run here is reported as not checked.

    Nothing is built or run of files that differ from the manifest, unless by --trust; the lines in
    which they differ from what is generated are listed. C that this user's own zerodrift did not
    write is asked about first, once for each content.

    Exit code 1: a file was changed, is missing or stale, a bit or a name in the header differs, a
    claim of the certificate does not hold, a core of --require was not checked, or with --prove
    something is not proven.
    """
    if elf is not None and not proves:
        raise InputError("--elf goes with --prove: `zerodrift verify --prove --elf FILE`")
    request = VerifyRequest(ProjectFolder(directory, sensor), required, is_trusted(), elf)
    with show_progress() as progress:
        if proves:
            proof = prove(request, progress)
        elif certificate:
            claims = check_folder(request, progress)
        else:
            outcome = verify(request, progress)
    folder = request.project.config.firmware_out
    if proves:
        _print_proof(proof, folder, as_json)
        return
    if certificate:
        _print_claims(claims, folder / CERTIFICATE, as_json)
        return
    if as_json:
        print_result(outcome.summarise())
    outcome.require(required)
    if not as_json:
        _print(outcome)


def _print(outcome: Replay) -> None:
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


def _print_proof(proof: ProofResult, folder: Path, as_json: bool) -> None:
    """Print what is proven of the C, and what is only tested."""
    from zerodrift.verify.checkers import OPEN, TESTED  # zerodrift-proof may be missing

    if as_json:
        print_result(proof)
    tested = [one for one in proof.parts if one.verdict == TESTED]
    for one in () if as_json else tested:
        click.echo(f"TESTED, NOT PROVEN: {_name(one.what, one.build)}{_because(one.why)}")
    if not proof.proven:
        left = [one for one in proof.parts if one.verdict == OPEN]
        lines = "\n  ".join(f"{_name(one.what, one.build)}: {one.why}" for one in left)
        raise CheckError(
            f"{folder}: {len(left)} of {len(proof.parts)} parts of the C are not proven to"
            f" be what the model says:\n  {lines}\nRun `zerodrift verify`, which compares bits; if"
            " that fails too, do not flash this C."
        )
    if not as_json:
        click.echo(
            f"proven: {len(proof.parts) - len(tested)} parts of C and object code compute what the"
            f" specification says of model {proof.model_hash[:12]}, for every input and state"
        )


def _because(why: str) -> str:
    return f": {why}" if why else ""


def _name(what: str, build: str) -> str:
    return f"{what} ({build})" if build else what


def _print_claims(told: CertificateResult, file: Path, as_json: bool) -> None:
    """Print which claims of a certificate hold."""
    if as_json:
        print_result(told)
    if told.failures:
        lines = "\n  ".join(told.failures)
        raise CheckError(
            f"{file} is refused; {told.claims_that_hold} claims hold, these do not:\n"
            f"  {lines}\nDo not flash this C; run `zerodrift firmware` again."
        )
    if not as_json:
        click.echo(
            f"certificate holds: {told.claims_that_hold} bounds and shifts derived again from the C"
            " alone, for any input"
        )
