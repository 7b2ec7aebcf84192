"""`zerodrift verify`: the C that lies in the firmware folder, against the reference."""

from pathlib import Path

import click

from zerodrift.commands.common import directory_option, json_option, print_json
from zerodrift.errors import CheckError, InputError


@click.command()
@directory_option
@json_option
@click.option(
    "--certificate",
    is_flag=True,
    help="Instead, derive every bound of certificate.json again from the C alone.",
)
def command(directory: Path, as_json: bool, certificate: bool) -> None:
    """Replay the golden vectors on every back end there is.

    Takes build/model.json, build/golden.npz and the C in the firmware folder as they lie there, so
    a file that was edited by hand is found out. Exit code 1 when a bit differs, or with
    --certificate when a claim does not hold.
    """
    from zerodrift.commands.console import show_progress
    from zerodrift.config import load_config
    from zerodrift.verify.replay import replay

    if certificate:
        _check_certificate(load_config(directory).firmware_out, as_json)
        return
    with show_progress("replaying the golden vectors") as say:
        outcome = replay(load_config(directory), say)
    if as_json:
        print_json(
            {
                "bit_exact": outcome.failure is None,
                "vectors": outcome.vectors,
                "backends": list(outcome.backends),
                "model_hash": outcome.model_hash,
            }
        )
    if outcome.failure is not None:
        outcome.require()
    if not as_json:
        click.echo(
            f"bit-exact: {outcome.vectors} steps on {' = '.join(outcome.backends)}, every node,"
            f" state and flag, 0 LSB (model {outcome.model_hash[:12]})"
        )


def _check_certificate(folder: Path, as_json: bool) -> None:
    """Tell which claims hold; needs nothing but the firmware folder."""
    from zerodrift.commands.console import show_progress
    from zerodrift.verify.certificate import FILE_NAME
    from zerodrift.verify.certificate_check import check_certificate

    if not (folder / FILE_NAME).is_file():
        raise InputError(
            f"{folder / FILE_NAME}: there is no certificate. Run `zerodrift firmware`."
        )
    with show_progress("deriving every bound again from the C"):
        outcome = check_certificate(folder)
    if as_json:
        print_json(
            {
                "certificate": "refused" if outcome.failures else "holds",
                "claims_that_hold": outcome.holds,
                "failures": list(outcome.failures),
            }
        )
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
