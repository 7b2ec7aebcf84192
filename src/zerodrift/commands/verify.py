"""`zerodrift verify`: the C that lies in the firmware folder, against the reference."""

from pathlib import Path

import click

from zerodrift.commands.common import directory_option, json_option, print_json


@click.command()
@directory_option
@json_option
def command(directory: Path, as_json: bool) -> None:
    """Replay the golden vectors on every back end there is.

    Takes build/model.json, build/golden.npz and the C in the firmware folder as they lie there, so
    a file that was edited by hand is found out. Exit code 1 when a bit differs.
    """
    from zerodrift.config import load_config
    from zerodrift.verify.replay import replay

    outcome = replay(load_config(directory))
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
