"""Which other unit is in place: the known units' models over the logs since the change."""

import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from zerodrift.base.arrays import Array, Mask
from zerodrift.base.config import Config, load_config
from zerodrift.base.errors import CheckError, InputError
from zerodrift.blocks.block import apply, decode
from zerodrift.blocks.design import find_design, load_design
from zerodrift.c_runtime.host import build_host_batch
from zerodrift.codegen.generate import generate
from zerodrift.export.integer_model import IntegerModel
from zerodrift.export.model_files import load_model
from zerodrift.field.registry import FILE_NAME as REGISTRY
from zerodrift.field.registry import open_registry
from zerodrift.field.state import MonitorState, SearchedOutput, UnitSearch, shorten
from zerodrift.field.summary import NAMED, NONE, POSSIBLE, TOO_LITTLE, UnitSought
from zerodrift.field.swapped import FALSE_NAME, MOST, Before, Foretold, add_look, find_unit
from zerodrift.field.watch import (
    OTHER_MODEL,
    OTHER_UNIT,
    BlockMeans,
    Rules,
    join_blocks,
    make_blocks,
)
from zerodrift.fleet.sensors import FOLDER, find_sensors
from zerodrift.tasks.apply import Chip
from zerodrift.tasks.built import load_uncertainty
from zerodrift.tasks.monitored_log import Deployed, MonitoredLog, apply_to, open_log
from zerodrift.verify.uncertainty import Uncertainty

BATCH = 32
"""Models that are compiled together."""
SHOWN = 5
"""Units that a sentence lists."""


@dataclass(frozen=True)
class KnownUnit:
    """Another unit of the design."""

    serial: str
    model: IntegerModel
    calibrated: Mapping[str, float]
    """Output -> standard uncertainty of a mean inside the model's range, in its unit; where it is
    not known, as of a block in the registry, that of the unit that should be there is taken."""


@dataclass(frozen=True)
class LogPart:
    """Steps of a log that were new when it was read."""

    log: Path
    skip_invalid: bool
    shift_s: float
    """What was added to the log's own time."""
    after_s: float | None
    """Only steps that are later are new; None: all."""


@dataclass(frozen=True)
class _Swap:
    """Since when another unit is in place."""

    place: int
    """Number of the last block that may hold steps of the unit that should be there."""
    is_first: bool
    """Whether it was there from the first sample on."""


def find_systematic(found: Uncertainty | None) -> dict[str, float]:
    """Return output -> standard uncertainty of a mean, as far as it is told apart from noise."""
    told = {}
    for name, one in found.outputs.items() if found else ():
        whole = one.standard**2
        least = whole * np.sqrt(2.0 / one.degrees_of_freedom)
        told[name] = float(np.sqrt(max(whole - one.noise**2, least)))
    return told


def wants_name(state: MonitorState) -> bool:
    """Return whether another unit is in place that has no name yet."""
    return _find_change(state) is not None


def _find_change(state: MonitorState) -> _Swap | None:
    """Return when another unit took the place; None where none did."""
    changes = [
        _Swap(max(one.place[f.since], f.begun[1] - 1 if f.begun else 0), f.cause == OTHER_MODEL)
        for one in state.outputs.values()
        if (f := one.finding) is not None
        and f.told is not None
        and f.cause in (OTHER_UNIT, OTHER_MODEL)
    ]
    if not changes:
        return None
    if all(change.is_first for change in changes):
        return _Swap(min(change.place for change in changes) - 1, True)
    return _Swap(max(change.place for change in changes if not change.is_first), False)


def seek_unit(
    deployed: Deployed,
    own: Chip,
    state: MonitorState,
    parts: Sequence[LogPart],
    units: Sequence[KnownUnit],
) -> MonitorState:
    """Return the state with what the logs tell of each known unit.

    Args:
        deployed: the unit that should be there.
        own: its model.
        state: as the last test left it.
        parts: the logs that were read since the last call, which are read again.
        units: the other units; the search begins anew where they are not those of the last call.
    """
    change = _find_change(state)
    if change is None:
        return replace(state, sought=None)
    models = {unit.serial: unit.model.hash for unit in units}
    sought = state.sought
    if sought is None or dict(sought.models) != models:
        sought = UnitSearch(models, {})
    if sought.named or not units:
        return replace(state, sought=sought)
    outputs = dict(sought.outputs)
    with tempfile.TemporaryDirectory(prefix="zerodrift-units-") as scratch:
        chips = list(_open_chips([unit.model for unit in units], Path(scratch))) if parts else []
        for part in parts:
            log = open_log(deployed, part.log, part.skip_invalid)
            time_s = log.time_s + part.shift_s
            new = np.floor(time_s / state.block_s).astype(np.int64) > change.place
            if part.after_s is not None:
                new &= time_s > part.after_s
            if new.any():
                _add(outputs, _foretell(deployed, (own, *chips), log, new, time_s, state), models)
    named, possible = _decide(outputs, deployed, state, change, units)
    return replace(state, sought=UnitSearch(models, outputs, possible, named))


def _open_chips(models: Sequence[IntegerModel], folder: Path) -> Iterator[Chip]:
    """Yield the models, compiled many at a time."""
    for start in range(0, len(models), BATCH):
        batch = models[start : start + BATCH]
        try:
            codes = [generate(model) for model in batch]
            hosts = build_host_batch(batch, codes, folder / str(start))
        except (CheckError, OSError):
            yield from (Chip(model) for model in batch)
            continue
        yield from (Chip(model, host) for model, host in zip(batch, hosts, strict=True))


def _foretell(
    deployed: Deployed,
    chips: Sequence[Chip],
    log: MonitoredLog,
    new: Mask,
    time_s: Array,
    state: MonitorState,
) -> dict[str, list[BlockMeans]]:
    """Return, by output, the means that each unit's model leaves; that which should be there first.

    All are taken over the same steps: those that carry no flag of the unit that should be there.
    The other units follow once more, with the share of these steps that each one's model flags.
    """
    told: dict[str, list[BlockMeans]] = {}
    flagged: dict[str, list[BlockMeans]] = {}
    usable = new
    for number, chip in enumerate(chips):
        left = apply_to(chip, deployed.config, log)
        if number == 0:
            usable = new & (left.flags == 0)
        for name, residual in left.residuals.items():
            here = usable & np.isfinite(residual)
            means = make_blocks(time_s[here], residual[here], log.temperature[here], state.block_s)
            told.setdefault(name, []).append(means)
            if number:
                marked = _share_flagged(left.flags[here] != 0, time_s[here], state.block_s)
                flagged.setdefault(name, []).append(replace(means, residual=marked))
    return {name: told[name] + flagged.get(name, []) for name in told}


def _share_flagged(flagged: Mask, time_s: Array, block_s: float) -> Array:
    """Return the share of each block's steps that are flagged."""
    _, index, count = np.unique(np.floor(time_s / block_s), return_inverse=True, return_counts=True)
    return np.asarray(np.bincount(index, weights=flagged, minlength=count.size) / count)


def _add(
    outputs: dict[str, SearchedOutput],
    told: dict[str, list[BlockMeans]],
    serials: Sequence[str] | dict[str, str],
) -> None:
    """Add means to what was kept."""
    for name, newer in told.items():
        before = outputs.get(name)
        means = newer
        if before is not None:
            none = (0.0,) * len(before.place)
            kept = [before.own, *(before.others[serial] for serial in serials)]
            kept += [before.flagged.get(serial, none) for serial in serials]
            place = np.array(before.place, dtype=np.int64)
            count, temperature = np.array(before.count), np.array(before.temperature)
            older = [BlockMeans(place, count, np.array(one), temperature) for one in kept]
            means = [join_blocks(one, more) for one, more in zip(older, newer, strict=True)]
        first, *others = (one.first(min(MOST, one.place.size)) for one in means)
        if first.place.size:
            beside, flagged = (
                {s: shorten(m.residual) for s, m in zip(serials, part, strict=True)}
                for part in (others[: len(serials)], others[len(serials) :])
            )
            outputs[name] = SearchedOutput(
                tuple(int(p) for p in first.place),
                shorten(first.count),
                shorten(first.temperature),
                shorten(first.residual),
                beside,
                flagged,
                before.looks if before is not None else (),
            )


def _decide(
    outputs: dict[str, SearchedOutput],
    deployed: Deployed,
    state: MonitorState,
    change: _Swap,
    units: Sequence[KnownUnit],
) -> tuple[str, tuple[str, ...] | None]:
    """Return the unit that is named, and those that are not ruled out; note the looks taken."""
    weighed = {}
    samples = state.block_s / deployed.config.sample_period_s
    serials = tuple(unit.serial for unit in units)
    for name, output in outputs.items():
        watched = state.outputs[name]
        if not change.is_first and watched.learned is None:
            continue
        means, others, flagged = _whole(output, samples, serials)
        standard = find_systematic(deployed.uncertainty).get(name, float(np.std(watched.residual)))
        rules = Rules(state.per_month, state.block_s, standard, state.learn_s)
        learned = None if change.is_first else watched.learned
        before = watched.blocks.first(learned.blocks if learned is not None else 0)
        calibrated = np.array([unit.calibrated.get(name, standard) for unit in units])
        foretold = Foretold(means, others, calibrated, flagged, output.looks)
        weighed[name] = (foretold, Before(before, learned, rules))
        outputs[name] = replace(
            output, looks=add_look(output.looks, means.place.size, state.block_s)
        )
    found = find_unit(weighed, len(serials))
    if found is None:
        return "", None
    named = "" if found.named is None else serials[found.named]
    return named, tuple(serials[k] for k in found.possible)


def _whole(
    output: SearchedOutput, samples: float, serials: tuple[str, ...]
) -> tuple[BlockMeans, Array, Array]:
    """Return the means and what is flagged, without the last block if that may gain samples."""
    n = len(output.place)
    if output.count[-1] < round(samples) and n < MOST:
        n -= 1
    means = BlockMeans(
        np.array(output.place, dtype=np.int64),
        *(np.array(values) for values in (output.count, output.own, output.temperature)),
    )
    others = np.array([output.others[serial] for serial in serials])
    none = (0.0,) * len(output.place)
    flagged = np.array([output.flagged.get(serial, none) for serial in serials])
    return means.first(n), others[:, :n], flagged[:, :n]


def tell_sought(state: MonitorState) -> UnitSought | None:
    """Return what is known of the unit in place; None where no other unit is known."""
    sought = state.sought
    if sought is None or not sought.models:
        return None
    known, possible = len(sought.models), sought.possible
    of = f"the {known} other units that are known" if known > 1 else "the other unit that is known"
    if sought.named:
        kind, text = NAMED, f"this looks like {sought.named}"
    elif possible is None:
        kind, text = TOO_LITTLE, f"a day of logs since the change is needed to try {of}"
    elif not possible:
        kind, text = NONE, f"none of {of} fits" if known > 1 else f"{of} does not fit"
    else:
        shown = ", ".join(possible[:SHOWN]) + (", ..." if len(possible) > SHOWN else "")
        kind, text = POSSIBLE, f"of {of}, {len(possible)} may be in its place: {shown}"
    return UnitSought(kind, sought.named, possible or (), known, FALSE_NAME, text)


SHOWN_UNITS = 3
"""Units that a note names."""


# The other units of a design that the fleet or the registry knows, with their models.


def find_known(
    directory: Path, deployed: Deployed, *, in_fleet: bool
) -> tuple[tuple[KnownUnit, ...], tuple[str, ...]]:
    """Return the other units, sorted by serial number, and notes on those that cannot be tried.

    The fleet's models come first, then the newest block of each further unit in the registry.

    Args:
        directory: of zerodrift.toml.
        deployed: the unit that should be there; is not among them.
        in_fleet: whether it is a unit of a fleet.

    Raises:
        InputError: the registry cannot be read.
    """
    config = load_config(directory)
    own = {deployed.sensor, deployed.serial}
    known: dict[str, IntegerModel] = {}
    wrong: dict[str, str] = {}
    for serial, model in (
        *(_list_fleet(config, wrong) if in_fleet else ()),
        *_list_registry(directory, config, wrong),
    ):
        if serial in own or serial in known:
            continue
        names = tuple(output.name for output in model.outputs)
        if names != tuple(output.name for output in deployed.model.outputs):
            wrong[serial] = f"its model has other outputs: {', '.join(names)}"
            continue
        known[serial] = model
    left = [f"{serial} is not tried: {why}" for serial, why in wrong.items() if serial not in known]
    notes = left[:SHOWN_UNITS]
    if len(left) > SHOWN_UNITS:
        notes.append(f"{len(left) - SHOWN_UNITS} more units are not tried")
    place = config.build_directory / FOLDER
    measured = {s: load_uncertainty(place / s, model.hash) for s, model in known.items()}
    units = [KnownUnit(s, known[s], find_systematic(measured[s])) for s in sorted(known)]
    return tuple(units), tuple(notes)


def _list_fleet(config: Config, wrong: dict[str, str]) -> Iterator[tuple[str, IntegerModel]]:
    """Yield the fleet's units with their models; enter those without one."""
    for sensor in find_sensors(config):
        path = config.build_directory / FOLDER / sensor / "model.json"
        try:
            yield sensor, load_model(path)
        except InputError as error:
            wrong[sensor] = str(error)


def _list_registry(
    directory: Path, config: Config, wrong: dict[str, str]
) -> Iterator[tuple[str, IntegerModel]]:
    """Yield the registry's units with the models that their blocks hold; enter those without."""
    path = directory / REGISTRY
    if not path.is_file():
        return
    with open_registry(path) as registry:
        blocks = registry.list_blocks(config.sensor_name)
    place = find_design(config.firmware_out)
    if place is None or not blocks:
        return
    design = load_design(place)
    for serial, content in blocks.items():
        try:
            yield serial, apply(design, decode(design, content, f"{path.name}, {serial}"))
        except InputError as error:
            wrong[serial] = str(error)
