"""`zerodrift diagnose` in a fleet's folder: what the design lacks, and the units that differ."""

from pathlib import Path
from typing import TYPE_CHECKING

from zerodrift.base.config import Config
from zerodrift.base.errors import InputError, ZerodriftError
from zerodrift.base.progress import Progress

if TYPE_CHECKING:
    from rich.console import Console

    from zerodrift.fleet.differing import Difference
    from zerodrift.fleet.joint_summary import FleetDiagnosis
    from zerodrift.physics.catalogue import Catalogue

MOST_LISTED = 8
"""Candidates, and units that differ, that the terminal shows; --json has all."""


def diagnose_fleet(
    config: Config, skip_invalid: bool, say: Progress
) -> "tuple[FleetDiagnosis, Catalogue]":
    """Return the diagnosis of a design from all of its units together.

    A unit whose logs cannot be read is named, and the others are examined.

    Raises:
        InputError: zerodrift.toml does not say where the units are, or none can be examined.
    """
    from zerodrift.dataset.load import load_dataset
    from zerodrift.fleet.differing import find_differences
    from zerodrift.fleet.evidence import look_at_unit, pool_units
    from zerodrift.fleet.joint_summary import summarise_joint
    from zerodrift.fleet.sensors import configure_sensor, find_sensors
    from zerodrift.physics.catalogue import load_catalogue
    from zerodrift.tasks.trust import require_trust

    require_trust(config.plugin_files, config.directory, say)
    catalogue = load_catalogue(config.plugin_files)
    names = find_sensors(config)
    units, errors = [], {}
    for number, name in enumerate(names, start=1):
        say(f"{name}: {number} of {len(names)}")
        try:
            dataset = load_dataset(configure_sensor(config, name), skip_invalid)
            units.append(look_at_unit(name, dataset, catalogue, config.effects))
        except ZerodriftError as error:
            errors[name] = str(error)
    if not units:
        first = next(iter(errors.values()))
        raise InputError(f"{config.path}: no unit of {len(names)} can be examined. {first}")
    found = pool_units(units, catalogue, config.effects, say)
    say("looking for units that differ")
    limit = config.fleet.outlier_z
    differ = find_differences(found.units, found.missing, catalogue, config.effects, limit)
    return summarise_joint(config.sensor_name, found, differ, errors), catalogue


def print_fleet_diagnosis(
    found: "FleetDiagnosis", catalogue: "Catalogue", directory: Path, console: "Console"
) -> None:
    """Print candidates, verdict, units that differ, and units that could not be examined."""
    from zerodrift.cli.console import open_table, print_not_testable, write_values

    table = open_table(
        "Effects that the design's model lacks, one at a time, over all units",
        ("effect", "term", "values (median)"),
        ("error left", "p", "units gaining", "size"),
    )
    for candidate in found.candidates[:MOST_LISTED]:
        effect = catalogue[candidate.effect]
        table.add_row(
            effect.kind,
            effect.title,
            write_values(effect, candidate.parameters),
            f"{100.0 * candidate.rmse_left_out_ratio:.1f} %",
            f"{candidate.p_value:.2g}",
            f"{candidate.gaining} of {len(found.units)}",
            f"{candidate.size:.2f}",
        )
    if found.candidates:
        console.print(table)
        console.print(
            "Error left: RMSE in runs left out, over that of the model as it is; mean over the "
            "units. p: how often signs by chance rank some effect as high. Size: RMS in noise "
            "floors, in the median unit.\n"
        )
    print_not_testable(found.not_testable, console)
    _print_verdict(found, catalogue, console)
    for one in found.differ[:MOST_LISTED]:
        console.print(f"UNLIKE THE OTHERS: {tell_difference(one, directory)}")
    if len(found.differ) > MOST_LISTED:
        console.print(f"{len(found.differ) - MOST_LISTED} more differ; --json lists all.")
    for name, error in found.errors.items():
        console.print(f"not examined: {name}: {error}")


def _print_verdict(found: "FleetDiagnosis", catalogue: "Catalogue", console: "Console") -> None:
    from zerodrift.cli.console import write_values

    if found.effect is not None:
        effect = catalogue[found.effect]
        console.print(
            f"MISSING in the design: {effect.kind} ({effect.title}), p {found.p_value:.2g}."
        )
        values = write_values(effect, found.parameters)
        if values:
            console.print(f"Fitted, median of the units: {values}.")
        if found.lookalikes:
            console.print(f"These units cannot tell it from: {', '.join(found.lookalikes)}.")
        if found.also:
            console.print(f"Missing beside it: {', '.join(found.also)}.")
        console.print(effect.physics)
        choices = [p for p in effect.parameters if p.choices and p.name in found.parameters]
        held = "".join(f", {p.name} = {found.parameters[p.name]:g}" for p in choices)
        console.print(
            f'To add it to the design: [[effect]] with kind = "{effect.kind}"{held} in '
            "zerodrift.toml, then zerodrift fleet."
        )
    elif found.verdict == "complete":
        console.print("COMPLETE: no effect that these units can test helps the design.")
    else:
        console.print(
            "UNKNOWN: something is missing in most units that no effect of the catalogue explains."
        )
        if found.nearest is not None:
            console.print(f"Nearest, and not all of it: {found.nearest}.")
    console.print(f"Evidence: {found.evidence}.")


def tell_difference(one: "Difference", directory: Path) -> str:
    """Return a sentence on how a unit differs, and what to do."""
    from zerodrift.diagnosis.changes import name_directory
    from zerodrift.fleet.differing import ERROR, GAIN, SIZE

    z = f"z = {one.z:+.1f}"
    look = f"zerodrift diagnose --sensor {one.sensor}{name_directory(directory)}"
    if one.quantity == GAIN:
        return f"{one.sensor} lacks {one.effect}, the others do not ({z}). Look at it: {look}"
    what = f"{one.value:.3g} against {one.median:.3g} in the median unit ({z})"
    if one.quantity == ERROR:
        nearest = f", nearest {one.effect}" if one.effect else ""
        return f"{one.sensor}: the error is {what}, in noise floors{nearest}. Look at it: {look}"
    if one.quantity == SIZE:
        return f"{one.sensor}: {one.effect} is {what}, in noise floors. Look at it: {look}"
    return f"{one.sensor}: {one.effect} {one.quantity} is {what}. Look at it: {look}"
