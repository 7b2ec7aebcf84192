"""`zerodrift history`: the staircase of held-out errors so far."""

import math
from collections.abc import Sequence
from pathlib import Path

import click

from zerodrift.base.config import Config
from zerodrift.base.errors import InputError
from zerodrift.base.extras import PAGE, require
from zerodrift.base.journal import hold_project
from zerodrift.cli.common import (
    directory_option,
    json_option,
    print_notes,
    print_result,
    sensor_option,
)
from zerodrift.cli.console import open_console, open_table
from zerodrift.diagnosis.history import Step

BAR_WIDTH = 48
EIGHTHS = " ▏▎▍▌▋▊▉█"


def draw_bar(ratio: float, largest: float, width: int = BAR_WIDTH) -> str:
    """Return a bar on a logarithmic scale from the floor, a ratio of 1, to the largest ratio."""
    if largest <= 1.0 or ratio <= 1.0:
        return ""
    eighths = round(8 * width * math.log(ratio) / math.log(largest))
    return "█" * (eighths // 8) + EIGHTHS[eighths % 8].strip()


@click.command()
@directory_option
@sensor_option
@click.option(
    "--html",
    type=click.Path(path_type=Path, dir_okay=False),
    default=None,
    help="Write the picture, output by output, as a self-contained page.",
)
@click.option(
    "--restore",
    type=click.IntRange(0),
    default=None,
    metavar="N",
    help="Write the effects of step N back into zerodrift.toml; the rest of the file stays.",
)
@json_option
def command(
    directory: Path, sensor: str | None, html: Path | None, restore: int | None, as_json: bool
) -> None:
    """Show every effect that was added or removed, with the held-out errors it brought.

    The table gives the errors in their units; the bars give them as multiples of the noise floor,
    root mean square over the outputs, on a logarithmic scale that begins at the floor.
    """
    if html is not None:
        require(PAGE, "zerodrift history --html")
    from zerodrift.diagnosis.history import list_steps
    from zerodrift.fleet.sensors import load_unit
    from zerodrift.tasks.project import tell_design
    from zerodrift.tasks.revise import open_history

    config = load_unit(directory, sensor)
    if restore is not None:
        with hold_project(directory):
            restore_step(config, restore)
        print_notes(tell_design(config, sensor))
    path, entries = open_history(config)
    steps = list_steps(entries)
    if html is not None:
        from zerodrift.base.journal import write_text
        from zerodrift.report.figures import draw_staircase, render_page

        title = f"{config.sensor_name}: history of the model"
        notes = [f"{step.label}: {step.reason}" for step in steps if step.reason]
        write_text(html, render_page(title, [draw_staircase(steps)], notes), directory)
    if as_json:
        from zerodrift.report.results import HistoryResult

        print_result(HistoryResult(tuple(step.summarise() for step in steps)))
        return
    if not steps:
        click.echo(f"No history yet in {path}: `zerodrift add EFFECT` begins one.")
        return
    print_steps(steps)
    if html is not None:
        click.echo(f"Wrote {html}")


def restore_step(config: Config, number: int) -> None:
    """Write the effects of a step into zerodrift.toml and append an entry to the history.

    Raises:
        InputError: there is no such step, it kept no settings, or the file cannot be edited.
    """
    from zerodrift.base.config import parse_config
    from zerodrift.base.journal import write_all
    from zerodrift.base.toml_edit import add_effect, remove_effect
    from zerodrift.diagnosis.history import (
        list_settings,
        list_steps,
        record_restored,
        render_history,
    )
    from zerodrift.tasks.revise import open_history, read_text

    path, entries = open_history(config)
    steps = list_steps(entries)
    if number >= len(steps):
        known = f"steps 0 to {len(steps) - 1}" if steps else "none yet"
        raise InputError(
            f"--restore {number}: there is no such step in {path} ({known}); expected one that "
            "`zerodrift history` lists."
        )
    step = steps[number]
    if step.effects and not step.settings:
        raise InputError(
            f"--restore {number}: step '{step.label}' was made by hand or by an older version, "
            f"which kept no settings; expected a step that has them. Its effects were "
            f"{', '.join(step.effects)}: write them into {config.path} by hand."
        )
    before = text = read_text(config.path)
    # Effects that the step has too stay as they are written, comments included.
    missing = list(step.settings)
    for place, settings in reversed(list(enumerate(list_settings(config.effects)))):
        if settings in missing:
            missing.remove(settings)
        else:
            text = remove_effect(text, place, path=config.path)
    for effect in missing:
        text = add_effect(text, effect.kind, effect.held, effect.options, path=config.path)
    written = list(list_settings(parse_config(text, config.path).effects))
    if sorted(written, key=repr) != sorted(step.settings, key=repr):
        raise InputError(
            f"{config.path}: its layout is not understood well enough to edit it; expected "
            "[[effect]] tables with one key to a line. Edit the effects by hand."
        )
    if text == before:
        click.echo(
            f"{config.path} has the effects of step {number} ({step.label}) already; nothing"
            " was written",
            err=True,
        )
        return
    entry = record_restored(steps, number, config.effects)
    write_all(
        config.directory, {path: render_history([*entries, entry]), config.path: text.encode()}
    )
    click.echo(
        f"restored the effects of step {number} ({step.label}); `zerodrift firmware` trains with"
        " them",
        err=True,
    )


def print_steps(steps: Sequence[Step]) -> None:
    """Print the table, the bars, and the reasons."""
    console = open_console()
    outputs = list(dict.fromkeys(name for step in steps for name in step.errors))
    units = {name: unit for step in steps for name, unit in step.units.items()}
    table = open_table(
        "Held-out RMSE, step by step", ("", "change"), [f"{n} {units.get(n, '')}" for n in outputs]
    )
    for number, step in enumerate(steps):
        errors = [f"{step.errors[n]:.4g}" if n in step.errors else "-" for n in outputs]
        table.add_row(str(number), step.label, *errors)
    floor = steps[-1].noise_floor
    table.add_section()
    table.add_row("", "noise floor", *(f"{floor[n]:.4g}" if n in floor else "-" for n in outputs))
    console.print(table)
    ratios = [step.ratio() for step in steps]
    largest = max((ratio for ratio in ratios if ratio is not None), default=1.0)
    width = max(len(step.label) for step in steps)
    for number, (step, ratio) in enumerate(zip(steps, ratios, strict=True)):
        if ratio is not None:
            bar = draw_bar(ratio, largest)
            console.print(f"{number:3} {step.label:<{width}} │{bar} {ratio:.2f} x floor")
    for number, step in enumerate(steps):
        if step.reason:
            console.print(f"{number:3} {step.label}: {step.reason}.")
