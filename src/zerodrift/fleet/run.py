"""A fleet from its directory to results: batches, where they go, and what is written at the end."""

from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import dataclass

from zerodrift.base.config import locate_key
from zerodrift.base.errors import InputError, ZerodriftError
from zerodrift.base.files import refuse_foreign
from zerodrift.base.fleet_config import PLACEHOLDER, SHARED_RUNTIME
from zerodrift.base.journal import write_all
from zerodrift.c_runtime.compilers import RUNTIME_FILES
from zerodrift.codegen.identifiers import sanitize_prefix
from zerodrift.fleet.design import Design
from zerodrift.fleet.executors import Batch, Executor
from zerodrift.fleet.parcels import at_hand
from zerodrift.fleet.result import RESULT, SensorOutcome, SensorResult, load_result
from zerodrift.fleet.sensors import configure_sensor, find_sensors
from zerodrift.verify.manifest import check_manifest

BATCH = 32
"""Sensors in a batch: compiled together, and with a network trained together."""


@dataclass(frozen=True)
class FleetProgress:
    """Where a fleet stands, for a bar."""

    done: int
    total: int
    kept: int
    failed: int


def run_fleet(
    design: Design,
    executor: Executor,
    *,
    jobs: int = 1,
    batch: int | None = None,
    fresh: bool = False,
    report: Callable[[FleetProgress], None] = lambda _: None,
) -> tuple[SensorOutcome, ...]:
    """Return the outcome of every sensor, sorted by name.

    Args:
        design: what they share.
        executor: where the work is done.
        jobs: processes that want work at the same time.
        batch: sensors in a batch; by default as many as are worth it.
        fresh: compute anew what is kept.
        report: called whenever a batch is done.

    Raises:
        InputError: zerodrift.toml does not say where the sensors are.
        CheckError: the executor was lost; finished results are kept.
    """
    sensors = find_sensors(design.config)
    refuse_equal_prefixes(design, sensors)
    if design.firmware:
        write_runtime(design)
    outcomes: dict[str, SensorOutcome] = {}

    def tell() -> None:
        kept = sum(o.kept for o in outcomes.values())
        failed = sum(o.result is None for o in outcomes.values())
        report(FleetProgress(len(outcomes), len(sensors), kept, failed))

    tell()
    for sensor in () if fresh else sensors:
        kept = find_kept(design, sensor)
        if kept is not None:
            outcomes[sensor] = SensorOutcome(sensor, kept, kept=True)
            tell()
    left = [sensor for sensor in sensors if sensor not in outcomes]
    batches = cut_batches(left, jobs, batch)
    if batches:
        with closing(executor.run(design, batches)) as found:
            for part in found:
                outcomes |= {outcome.sensor: outcome for outcome in part}
                tell()
    return tuple(outcomes[sensor] for sensor in sensors)


def cut_batches(sensors: Sequence[str], jobs: int, batch: int | None) -> list[Batch]:
    """Return the sensors in batches, as many in each as are worth it unless that is told."""
    size = batch or max(1, min(BATCH, -(-len(sensors) // jobs)))
    return [tuple(sensors[i : i + size]) for i in range(0, len(sensors), size)]


def refuse_equal_prefixes(design: Design, sensors: Sequence[str]) -> None:
    """Refuse prefixes that are equal for two sensors.

    Raises:
        InputError: two sensors' C would have the same names.
    """
    text = design.config.firmware_prefix
    if PLACEHOLDER not in text:
        return
    taken: dict[str, str] = {}
    for sensor in sensors:
        prefix = sanitize_prefix(text.replace(PLACEHOLDER, sensor))
        if prefix in taken:
            where = locate_key(design.config.path, "firmware", "prefix")
            raise InputError(
                f"{where}: sensors {taken[prefix]} and {sensor} would both be '{prefix}' in the C;"
                " expected prefixes that differ in their first 31 letters and digits. Shorten the"
                " prefix, or rename a sensor."
            )
        taken[prefix] = sensor


def find_kept(design: Design, sensor: str) -> SensorResult | None:
    """Return a sensor's result if neither its logs, nor the design, nor its files have changed."""
    folder = design.build_folder(sensor)
    if not (folder / RESULT).is_file():
        return None
    try:
        config = configure_sensor(design.config, sensor)
        with at_hand(design, sensor) as near:
            mark = near.mark_sensor(configure_sensor(near.config, sensor))
        kept = load_result(folder, design.directory, mark)
        if kept is None or not design.firmware:
            return kept
        if kept.refused and kept.forced != design.force:
            return None
        if (kept.refused and not kept.forced) or design.in_block:
            return kept
        place = design.firmware_folder(sensor)  # logs and design are in the mark
        check = check_manifest(config, folder=place, build=folder, wants_inputs=False)
    except (ZerodriftError, OSError):
        return None  # told when it is worked on
    return None if check.manifest is None or check.findings else kept


def write_runtime(design: Design) -> None:
    """Write the C that all sensors share, where it differs from what is there.

    Raises:
        InputError: a file that zerodrift did not write stands in the place of one.
    """
    folder = design.config.firmware_out / SHARED_RUNTIME
    contents = {folder / path.name: path.read_bytes() for path in RUNTIME_FILES}
    changed = {
        target: content
        for target, content in contents.items()
        if not target.is_file() or target.read_bytes() != content
    }
    refuse_foreign(changed, folder)
    write_all(design.directory, changed)
