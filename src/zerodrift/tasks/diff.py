"""What changed from one model to another, and by how much the drift differs."""

import hashlib
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from zerodrift.base.arrays import Array
from zerodrift.base.config import Config, load_config
from zerodrift.base.errors import InputError
from zerodrift.base.progress import SILENT, Progress
from zerodrift.base.records import from_json
from zerodrift.dataset.chip_codes import MEASURED
from zerodrift.dataset.log_steps import LogSteps, name_columns, read_log_steps
from zerodrift.export.encoding import encode_values
from zerodrift.export.integer_model import Channel, IntegerModel
from zerodrift.export.model_files import load_model
from zerodrift.physics.catalogue import load_catalogue
from zerodrift.physics.summary import ModelSummary, summarise_model
from zerodrift.report.results import DiffResult, ModelChange, OutputDifference
from zerodrift.tasks.apply import Chip, answer
from zerodrift.tasks.trust import require_trust
from zerodrift.train.compensator import DESCRIPTION, Compensator
from zerodrift.verify.firmware import EFFECTS, MODEL
from zerodrift.verify.manifest import FILE_NAME as MANIFEST
from zerodrift.verify.manifest import load_manifest

MOST_STEPS = 200_000
"""Of the sweep, per model."""
SPEED = 0.5
"""Of the sweep, as a share of the slower model's calibrated rate."""
HOLDS = (0.0, 1.0, 0.0, -1.0, 0.0)
"""Places in the calibrated range at which the sweep rests: middle, top, middle, bottom, middle."""


@dataclass(frozen=True)
class DiffRequest:
    """Which two models are compared, and over what."""

    old: Path
    """A project, a firmware folder or a model.json; so is `new`."""
    new: Path
    logs: tuple[Path, ...] = ()
    """None: the calibrated range that both have."""
    directory: Path | None = None
    """The project whose zerodrift.toml says how logs are read; None: NEW's, else OLD's."""
    limit_pct_fs: float | None = None
    """Share of full scale, in percent, that no drift may differ by."""
    skip_invalid: bool = False


def diff(request: DiffRequest, progress: Progress = SILENT) -> DiffResult:
    """Return what changed from one model to another, and by how much their drifts differ.

    Raises:
        InputError: a model or a log cannot be read, or their outputs or inputs are not the same.
    """
    place = request.directory or find_project(request.new) or find_project(request.old)
    config = load_config(place) if place is not None else None
    plugins = config.plugin_files if config is not None else ()
    if place is not None:
        require_trust(plugins, place, progress)
    before, after = (open_model(path, plugins) for path in (request.old, request.new))
    progress("comparing")
    return diff_models(
        before,
        after,
        config=config,
        logs=request.logs,
        limit_pct_fs=request.limit_pct_fs,
        skip_invalid=request.skip_invalid,
        say=progress,
    )


@dataclass(frozen=True)
class OpenedModel:
    """A model, and what its folder says of it."""

    label: str
    model: IntegerModel
    effects: ModelSummary | None
    """Its effects; None where no file states them."""
    learnt: str | None
    """What was learnt besides them; None where no file states it."""
    notes: tuple[str, ...] = ()


def open_model(path: Path, plugins: Sequence[Path] = ()) -> OpenedModel:
    """Return the model of a project, of a firmware folder, or of a model.json.

    Args:
        path: any of the three.
        plugins: files of users' effects.

    Raises:
        InputError: there is no such model, or the folder's firmware is of another one.
    """
    file, build = _find_model(path)
    model = load_model(file)
    folder = path if path.is_dir() and (path / MANIFEST).is_file() else None
    if folder is not None and (stated := load_manifest(folder / MANIFEST).model_hash) != model.hash:
        raise InputError(
            f"{folder}: its firmware is of the model {stated[:12]}, {file} is {model.hash[:12]}; "
            "expected the same. Name the model.json that the firmware was built from."
        )
    notes = _check_files(folder) if folder is not None else ()
    effects, learnt = _read_effects(build, plugins)
    if effects is None:
        notes = (*notes, f"{path}: no effects are recorded there; they are not compared")
    return OpenedModel(str(path), model, effects, learnt, notes)


def _check_files(folder: Path) -> tuple[str, ...]:
    """Return notes where a folder's files differ from its manifest."""
    changed = []
    for name, digest in load_manifest(folder / MANIFEST).firmware.items():
        file = folder / name
        if not file.is_file() or hashlib.sha256(file.read_bytes()).hexdigest() != digest:
            changed.append(name)
    if not changed:
        return ()
    return (
        f"{folder}: {', '.join(changed)} are not as manifest.json has them; the model is compared, "
        "not these files. `zerodrift verify` checks them.",
    )


def _read_effects(place: Path, plugins: Sequence[Path]) -> tuple[ModelSummary | None, str | None]:
    """Return a model's effects and what was learnt besides them, as far as its folder states
    them."""
    if (place / EFFECTS).is_file():
        try:
            told = json.loads((place / EFFECTS).read_text(encoding="utf-8"))
            return from_json(ModelSummary, told), None
        except ValueError:
            return None, None
    if not (place / DESCRIPTION).is_file():
        return None, None
    try:
        compensator = Compensator.load(place, load_catalogue(tuple(plugins)))
    except InputError:
        return None, None
    learnt = "lag bank" if compensator.bank is not None else "none"
    if compensator.network is not None:
        learnt = "network"
    return summarise_model(compensator.physics), learnt


def find_project(path: Path) -> Path | None:
    """Return the directory of the project that a path's model lies in, if there is one.

    Raises:
        InputError: the path holds no model.
    """
    project = _find_model(path)[1].parent
    return project if (project / "zerodrift.toml").is_file() else None


def _find_model(path: Path) -> tuple[Path, Path]:
    """Return the model.json that a path stands for, and the build directory it lies in."""
    if path.is_file():
        return path, path.parent
    for file in (
        path / "build" / MODEL,
        path / MODEL,
        path.parent / "build" / MODEL,
    ):
        if file.is_file():
            return file, file.parent
    raise InputError(
        f"{path}: no model.json here or in build/; expected a project whose firmware was built, "
        "its firmware folder, or a model.json. Run `zerodrift firmware`; a folder that an older "
        "version wrote, and that was taken from its project, holds none."
    )


def list_changes(old: OpenedModel, new: OpenedModel) -> tuple[ModelChange, ...]:
    """Return the statements in which the two differ, the more important first."""
    effects = old.effects is not None and new.effects is not None
    learnt = old.learnt is not None and new.learnt is not None
    before, after = (_state(one, effects=effects, learnt=learnt) for one in (old, new))
    names = list(dict.fromkeys([*before, *after]))
    return tuple(
        ModelChange(name, before.get(name, ""), after.get(name, ""))
        for name in names
        if before.get(name, "") != after.get(name, "")
    )


def _state(opened: OpenedModel, *, effects: bool, learnt: bool) -> dict[str, str]:
    """Return the statements of a model: name -> text.

    Args:
        opened: the model.
        effects: whether to list the effects; only where those of both models are known.
        learnt: the same for what was learnt besides them.
    """
    model = opened.model
    told = {"sample period": f"{model.sample_period_s:g} s"}
    if effects and opened.effects is not None:
        told |= _state_effects(opened.effects)
    if learnt and opened.learnt is not None:
        told["learnt beside"] = opened.learnt
    guards = model.guards
    thermometer = model.channels[guards.temperature_channel]
    limits = ((guards.temperature_channel, guards.temperature_low, guards.temperature_high),)
    for index, low, high in (*limits, *guards.ranges):
        channel = model.channels[index]
        told[f"calibrated range of {channel.name}"] = _show_range(channel, low, high)
    rate = guards.rate_max * thermometer.lsb / model.sample_period_s
    told["calibrated rate"] = f"{rate:.4g} {thermometer.unit}/s"
    told["warm-up"] = f"{guards.warm_up_steps * model.sample_period_s:g} s"
    for channel in model.channels:
        none = "none" if channel.no_reading is None else str(channel.no_reading)
        told[f"channel {channel.name}"] = (
            f"int{channel.bits}, {channel.lsb:g} {channel.unit} per code, no reading: {none}"
        )
        if channel.conversion is not None:
            by = channel.conversion
            told[f"conversion of {channel.name}"] = (
                f"from {by.raw}, readings {by.begin} .. {by.end}, converted {by.low} .. {by.high},"
                f" within {by.error:.3g} {channel.unit}"
            )
    for k, output in enumerate(model.outputs):
        told[f"output {output.name}"] = (
            f"{output.lsb_per_unit} codes per {output.unit}, full scale {output.full_scale:g}"
        )
        ends = [int(x[k]) / output.lsb_per_unit for x in (model.drift.low, model.drift.high)]
        told[f"limits of the correction of {output.name}"] = (
            f"{ends[0]:.4g} to {ends[1]:.4g} {output.unit}"
        )
    kinds = [node.kind for node in model.nodes]
    told["operations"] = ", ".join(f"{kinds.count(kind)} {kind}" for kind in dict.fromkeys(kinds))
    return told


def _state_effects(effects: ModelSummary) -> dict[str, str]:
    """Return effects with their parameters."""
    told = {}
    for term in effects.terms:
        parameters = term.parameters.items()
        values = ", ".join(f"{name} = {p.value:.4g} {p.unit}".strip() for name, p in parameters)
        told[f"effect {term.name}"] = values or "present"
    return told


def _show_range(channel: Channel, low: int, high: int) -> str:
    ends = (code * channel.lsb + channel.offset for code in (low, high))
    return " to ".join(f"{end:.4g}" for end in ends) + f" {channel.unit}"


def measure_over_logs(
    old: IntegerModel,
    new: IntegerModel,
    config: Config,
    logs: Sequence[Path],
    *,
    skip_invalid: bool,
) -> tuple[dict[str, OutputDifference], tuple[str, ...]]:
    """Return the differences of two models' drifts on the rows of logs, output by output.

    Raises:
        InputError: a log cannot be read or lacks a channel.
    """
    apart: list[Array] = []
    notes: list[str] = []
    chips = (Chip(old), Chip(new))
    for log in logs:
        drifts = []
        read: dict[tuple[float, tuple[str, ...]], LogSteps] = {}
        for chip in chips:
            model = chip.model
            sources = [c.source or c.name for c in model.channels]
            sources += [f"{MEASURED}{output.name}" for output in model.outputs]
            key = (model.sample_period_s, tuple(sources))
            if key not in read:
                named = name_columns(config, sources)
                read[key] = _read(config, model, log, named, skip_invalid)
            steps = read[key]
            told = answer(chip, config, steps, with_range=False)
            notes += [*steps.notes, *told.notes]
            at = steps.step_of_row
            drifts.append((told.drift[np.maximum(at, 0)] / _scale(model), at >= 0))
        (before, known), (after, known_too) = drifts
        rows = min(len(before), len(after))
        both = known[:rows] & known_too[:rows]
        pairs = _pair_outputs(old, new)
        columns = [after[:rows, j] - before[:rows, i] for i, j in pairs]
        apart.append(np.stack(columns, axis=1)[both])
    return _summarise(old, new, np.concatenate(apart)), tuple(dict.fromkeys(notes))


def _read(
    config: Config, model: IntegerModel, log: Path, columns: Mapping[str, str], skip_invalid: bool
) -> LogSteps:
    own = replace(config, sample_period_s=model.sample_period_s)
    return read_log_steps(own, log, columns, skip_invalid)


def measure_over_range(old: IntegerModel, new: IntegerModel) -> dict[str, OutputDifference]:
    """Return the differences of two models' drifts on a sweep of the calibrated range, unloaded.

    The temperature goes from the middle to the top, back, to the bottom and back, at half of the
    calibrated rate, and rests at each corner; then each further input does so in turn.
    """
    times, profiles = plan_sweep(old, new)
    answers = []
    for model in (old, new):
        step = model.sample_period_s
        count = min(int(times[-1] / step) + 1, MOST_STEPS)
        grid = step * np.arange(count)
        values = np.stack(
            [np.interp(grid, times, profiles[key_of(channel)]) for channel in model.channels],
            axis=1,
        )
        _, codes = encode_values(model, values)
        drift, _ = Chip(model).run(codes, 0)
        answers.append((grid, drift / _scale(model)))
    (grid, before), (own, after) = answers
    at = np.minimum(np.searchsorted(own, grid + 1e-9, side="right") - 1, len(own) - 1)
    columns = [after[at, j] - before[:, i] for i, j in _pair_outputs(old, new)]
    return _summarise(old, new, np.stack(columns, axis=1))


def plan_sweep(old: IntegerModel, new: IntegerModel) -> tuple[Array, dict[str, Array]]:
    """Return the sweep's corner times in seconds, and each channel's values [corners]."""
    ranges: dict[str, list[tuple[float, float]]] = {}
    for model in (old, new):
        guards = model.guards
        limits = {guards.temperature_channel: (guards.temperature_low, guards.temperature_high)}
        limits |= {index: (low, high) for index, low, high in guards.ranges}
        for index, channel in enumerate(model.channels):
            codes = limits.get(index, (0, 0))
            first, last = (code * channel.lsb + channel.offset for code in codes)
            ranges.setdefault(key_of(channel), []).append((first, last))
    common = {
        key: (max(low for low, _ in ends), min(high for _, high in ends))
        for key, ends in ranges.items()
    }
    rate = min(
        m.guards.rate_max * m.channels[m.guards.temperature_channel].lsb / m.sample_period_s
        for m in (old, new)
    )
    thermometer = key_of(new.channels[new.guards.temperature_channel])
    low, high = common[thermometer]
    if high <= low:
        raise InputError(
            f"the calibrated ranges do not meet ({ranges[thermometer]}); expected a common one. "
            "Name logs to compare over."
        )
    ramp_s = (high - low) / 2.0 / max(SPEED * rate, 1e-12)
    longest_s = MOST_STEPS * max(old.sample_period_s, new.sample_period_s)
    moved = [thermometer, *(k for k in common if k != thermometer and not k.startswith(MEASURED))]
    ramp_s = min(ramp_s, longest_s / (2 * len(HOLDS) * len(moved)))
    count = len(HOLDS) * len(moved)
    times = np.cumsum(
        np.tile([0.0, ramp_s], count) + np.repeat(np.arange(count) > 0, 2) * ramp_s / 2
    )
    profiles = {}
    for key, (first, last) in common.items():
        middle, half = (first + last) / 2.0, max(last - first, 0.0) / 2.0
        places = np.zeros(count)
        if key in moved:
            at = moved.index(key) * len(HOLDS)
            places[at : at + len(HOLDS)] = HOLDS
        profiles[key] = np.repeat(middle + half * places, 2)
    return times, profiles


def key_of(channel: Channel) -> str:
    """Return the source in a log of a channel's values."""
    return channel.source or channel.name


def _pair_outputs(old: IntegerModel, new: IntegerModel) -> list[tuple[int, int]]:
    """Return the indices in the old and in the new model of the outputs that both have."""
    places = {output.name: i for i, output in enumerate(old.outputs)}
    pairs = [(places[o.name], j) for j, o in enumerate(new.outputs) if o.name in places]
    if not pairs:
        names = ", ".join(places), ", ".join(o.name for o in new.outputs)
        raise InputError(
            f"the models have no output in common ({names[0]}; {names[1]}); expected two models of "
            "one design."
        )
    return pairs


def _scale(model: IntegerModel) -> Array:
    return np.array([output.lsb_per_unit for output in model.outputs], dtype=np.float64)


def _summarise(old: IntegerModel, new: IntegerModel, apart: Array) -> dict[str, OutputDifference]:
    differences = {}
    for column, (_, j) in enumerate(_pair_outputs(old, new)):
        output = new.outputs[j]
        largest = float(np.abs(apart[:, column]).max(initial=0.0))
        rms = float(np.sqrt(np.mean(apart[:, column] ** 2))) if len(apart) else 0.0
        share = 100.0 * largest / output.full_scale
        differences[output.name] = OutputDifference(output.unit, largest, rms, share)
    return differences


def diff_models(
    old: OpenedModel,
    new: OpenedModel,
    *,
    config: Config | None,
    logs: Sequence[Path] = (),
    limit_pct_fs: float | None = None,
    skip_invalid: bool = False,
    say: Callable[[str], None] = lambda _: None,
) -> DiffResult:
    """Return what changed from the old to the new model, and by how much the drift differs.

    Args:
        old: the old model.
        new: the new model.
        config: says how the logs are read; needed where there are some.
        logs: to compare over; none: the calibrated range.
        limit_pct_fs: the largest difference allowed, in % of full scale.
        skip_invalid: drop rows whose time is no number or does not rise.
        say: called with a description of each stage of the work.

    Raises:
        InputError: a log cannot be read, or the models have nothing in common.
    """
    notes = (*old.notes, *new.notes)
    if logs:
        if config is None:
            raise InputError(
                "logs are read as zerodrift.toml says, and neither model lies in a project; "
                "expected one. Name it by -C."
            )
        say("comparing over logs")
        outputs, noted = measure_over_logs(
            old.model, new.model, config, logs, skip_invalid=skip_invalid
        )
        notes = (*notes, *noted)
        over = ", ".join(str(log) for log in logs)
    else:
        say("comparing over the calibrated range")
        outputs, over = measure_over_range(old.model, new.model), "the calibrated range, unloaded"
    exceeds = limit_pct_fs is not None and any(
        o.largest_pct_fs > limit_pct_fs for o in outputs.values()
    )
    return DiffResult(
        old=old.label,
        new=new.label,
        same=old.model.hash == new.model.hash,
        changes=list_changes(old, new),
        over=over,
        outputs=outputs,
        limit_pct_fs=limit_pct_fs,
        exceeds=exceeds,
        notes=notes,
    )
