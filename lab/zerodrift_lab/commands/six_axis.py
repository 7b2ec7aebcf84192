"""What `zerodrift twin --six-axis` records, and how it says so."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from zerodrift.base.errors import InputError
from zerodrift.cli.console import show_progress
from zerodrift_lab.twin.recipe import EffectChoice
from zerodrift_lab.twin.sensor import OUTPUTS, UNITS
from zerodrift_lab.twin.six_axis import (
    Protocol,
    Recording,
    Sensor,
    draw_sensor,
    load_protocol,
    record,
)
from zerodrift_lab.twin.six_axis.files import Campaign

DEFAULT_RUNS = 6
DEFAULT_PROTOCOL = "chamber"

#: Options of the other twin -> how they are written.
FOREIGN = {
    "kinds": "--kinds",
    "told": "--told",
    "mystery": "--mystery",
    "size": "--size",
    "duration": "--duration",
    "still": "--still",
    "network": "--network",
}


def refuse_foreign_options(given: Iterable[str]) -> None:
    """Refuse options that only the other twin knows.

    Raises:
        InputError: one of them was given, with what to use instead.
    """
    for name in given:
        if name in FOREIGN:
            raise InputError(
                f"twin: {FOREIGN[name]} is not an option of --six-axis: what a run does stands in "
                "its protocol (--protocol), an effect's size beside it (--hidden creep=3)."
            )


def list_runs(
    protocols: Sequence[str], runs: int | None, test: Sequence[str], dwell: bool, level: str
) -> list[tuple[str, str, str]]:
    """Return protocol, name and use (train | test | dwell | weights) of every run."""
    cycle = tuple(protocols) or (DEFAULT_PROTOCOL,)
    count = runs or (len(cycle) if protocols else DEFAULT_RUNS)
    wanted = [(cycle[number % len(cycle)], "train") for number in range(count)]
    wanted += [(name, "test") for name in test]
    wanted += [("dwell", "dwell")] if dwell else []
    wanted += [("weights", "weights")] if level == "adc" else []
    taken: dict[str, int] = {}
    named = []
    for source, use in wanted:
        stem = load_protocol(source).name
        stem = f"test_{stem}" if use == "test" else stem
        taken[stem] = taken.get(stem, 0) + 1
        name = "dwell" if use == "dwell" else f"{stem}_{taken[stem]}"
        named.append((source, name, use))
    return named


@dataclass(frozen=True)
class CampaignRequest:
    """Which recordings of which specimen are wanted."""

    specimen: int
    protocols: tuple[str, ...]
    runs: int | None
    """Training runs; None: one of each protocol, or the default."""
    test: tuple[str, ...]
    """Protocols of the test runs."""
    dwell: bool
    hidden: tuple[EffectChoice, ...]
    seed: int
    period_s: float
    noise: float
    """Factor on the noise."""
    tare: str
    level: str


def record_campaign(request: CampaignRequest) -> Campaign:
    """Return the recordings of one specimen.

    Raises:
        InputError: an unknown protocol or effect, or a value out of range.
    """
    named = list_runs(request.protocols, request.runs, request.test, request.dwell, request.level)
    loaded: dict[str, Protocol] = {source: load_protocol(source) for source, _, _ in named}
    sensor: Sensor = draw_sensor(request.specimen, request.hidden, noise=request.noise)
    pauses = sensor.stream("pauses", str(request.seed))
    clock_s = 0.0
    by_use: dict[str, list[Recording]] = {"train": [], "test": [], "dwell": [], "weights": []}
    with show_progress("recording ...") as tell:
        for source, name, use in named:
            tell(f"recording {name} ...")
            run = record(
                sensor,
                loaded[source],
                name,
                request.seed,
                request.period_s,
                tare=request.tare,
                clock_start_s=round(clock_s, 1),
            )
            by_use[use].append(run)
            clock_s += run.seconds + float(pauses.uniform(600.0, 5400.0))
    return Campaign(
        sensor,
        train=tuple(by_use["train"]),
        test=tuple(by_use["test"]),
        dwell=tuple(by_use["dwell"]),
        weights=tuple(by_use["weights"]),
    )


def describe_campaign(campaign: Campaign, directory: Path, files: Sequence[str], level: str) -> str:
    """Return what was written, without a word about what is hidden."""
    uses = {run.name: "train" for run in campaign.train}
    uses |= {run.name: "test" for run in campaign.test}
    uses |= {run.name: "dwell" for run in campaign.dwell}
    folder = "adc" if level == "adc" else "logs"
    lines = [f"Simulated logs of the six-axis twin, {campaign.sensor.name}, in {directory}:"]
    for run in campaign.runs:
        temperature = run.temperature_degC
        lines.append(
            f"  {folder}/{run.name + '.csv':<26}{uses.get(run.name, 'calibrate'):<10}"
            f"{run.seconds:7.0f} s  {temperature.min():6.1f} to {temperature.max():5.1f} degC"
        )
    lines.append("truth.json holds what the sensor is in fact; look only when you have decided.")
    if level == "adc":
        own = f"-C {directory} " if str(directory) != "." else ""
        lines.append(
            f"{len(files)} files. Next: zerodrift calibrate {own}"
            "adc/weights_1.csv --apply adc --out logs"
        )
    else:
        lines.append(f"{len(files)} files. Next: zerodrift compare -C {directory}")
    return "\n".join(lines)


def summarise_campaign(campaign: Campaign, directory: Path, files: Sequence[str]) -> dict[str, Any]:
    """Return what was written as plain data for JSON."""

    def floors(run: Recording) -> dict[str, float]:
        return dict(zip(OUTPUTS, run.floor.tolist(), strict=True))

    return {
        "simulated": True,
        "directory": str(directory),
        "sensor": campaign.sensor.seed,
        "files": list(files),
        "runs": {
            run.name: {"protocol": run.protocol, "noise_floor": floors(run)}
            for run in campaign.runs
        },
        "noise_rms": dict(zip(OUTPUTS, campaign.sensor.noise_rms.tolist(), strict=True)),
        "units": dict(zip(OUTPUTS, UNITS, strict=True)),
    }
