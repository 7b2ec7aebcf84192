"""The finished model for programs that take a polynomial, and the accuracy that is lost."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from zerodrift.base.arrays import Array
from zerodrift.base.config import USES, Config
from zerodrift.base.errors import InputError, nearest
from zerodrift.base.files import write_whole
from zerodrift.base.progress import SILENT, Progress
from zerodrift.dataset.chip_codes import MEASURED
from zerodrift.dataset.log_steps import find_column, name_columns, read_log_steps
from zerodrift.dataset.selectors import expand_selectors
from zerodrift.export.encoding import encode_values
from zerodrift.export.integer_model import IntegerModel
from zerodrift.field.neighbours import (
    KINDS,
    FullAnswers,
    Lost,
    find_factors,
    fit_polynomial,
    measure_lost,
    render,
)
from zerodrift.field.summary import NeighbourResult
from zerodrift.tasks.apply import Chip, answer, load_nothing, open_applied
from zerodrift.tasks.diff import MOST_STEPS, key_of, plan_sweep
from zerodrift.tasks.project import ProjectFolder


@dataclass(frozen=True)
class NeighbourRequest:
    """Which program the model is wanted for, and how."""

    project: ProjectFolder
    kind: str
    """One of `KINDS`."""
    logs: tuple[Path, ...] = ()
    """Over which the loss is stated; none: those of [logs]."""
    outputs: tuple[str, ...] = ()
    """In the order of the neighbour's axes; none: all."""
    device: int | None = None
    """Number of the sensor in that program; None: its first."""
    order: int | None = None
    """Of `polynomial`."""
    out: Path | None = None
    """The file to be written; None: a name for each kind, in the current directory."""


@dataclass(frozen=True)
class NeighbourOutcome:
    """The file that was written, and the accuracy that is lost."""

    result: NeighbourResult
    notes: tuple[str, ...]
    """Those of the result, and what was noticed of the model."""


def write_neighbour(request: NeighbourRequest, progress: Progress = SILENT) -> NeighbourOutcome:
    """Write the model of the last `firmware` as another program takes it.

    Raises:
        InputError: no firmware was built, the neighbour does not take an output or its unit, a log
            cannot be read, or another's file would be overwritten.
    """
    config, kind = request.project.config, request.kind
    applied = open_applied(config, load_logs=load_nothing, progress=progress)
    place = request.out if request.out is not None else Path(KINDS[kind].file)
    if place.exists() and "written by zerodrift" not in place.read_text("utf-8", "replace")[:200]:
        raise InputError(
            f"{place}: is there and was not written by `zerodrift neighbour`; expected a new file."
            " Move it, or name another by --out."
        )
    progress("reading")
    told = render_neighbour(
        config,
        applied.model,
        kind,
        outputs=request.outputs,
        device=request.device,
        order=request.order,
        logs=request.logs,
        say=progress,
    )
    write_whole(place, told.text.encode())
    result = NeighbourResult(kind, applied.model.hash, str(place), told.lost, told.notes)
    return NeighbourOutcome(result, (*applied.notes, *told.notes))


@dataclass(frozen=True)
class Rendered:
    """The file for a neighbour program, and the accuracy that is lost."""

    text: str
    lost: dict[str, Lost]
    notes: tuple[str, ...]


def render_neighbour(
    config: Config,
    model: IntegerModel,
    kind: str,
    *,
    outputs: Sequence[str] = (),
    device: int | None = None,
    order: int | None = None,
    logs: Sequence[Path] = (),
    say: Callable[[str], None] = lambda _: None,
) -> Rendered:
    """Return a model in the form that a neighbour program takes.

    Args:
        config: the project.
        model: the integer model of its firmware.
        kind: one of `KINDS`.
        outputs: which, in the order of the neighbour's axes; none: all.
        device: number of the sensor in that program; None: its first.
        order: of `polynomial`; the others have their own.
        logs: over which it is fitted and judged; none: those of [logs].
        say: called with a description of each stage of the work.

    Raises:
        InputError: the neighbour does not take an output or its unit, or a log cannot be read.
    """
    known = [output.name for output in model.outputs]
    chosen = list(outputs) or known
    for name in chosen:
        if name not in known:
            raise InputError(
                f"--output {name}: there is no such output{nearest(name, known)} Expected some of"
                f" {', '.join(known)}."
            )
    places = [known.index(name) for name in chosen]
    units = [model.outputs[place].unit for place in places]
    factors = find_factors(kind, units)
    chip = Chip(model)
    say("sweeping the calibrated range")
    sweep = _sweep(chip, places)
    paths = list(logs) or _list_logs(config)
    over_logs, notes = _read_logs(chip, config, paths, places, say)
    own_order = order if order is not None and kind == "polynomial" else KINDS[kind].order
    fitted = fit_polynomial(kind, over_logs, sweep, factors, own_order)
    lost = measure_lost(kind, fitted, units, over_logs, sweep)
    head = [f"{kind} of {config.sensor_name}, model {model.hash[:12]}, written by zerodrift"]
    head += [
        f"{name}: against the full model {one.rms_range:.3g} {one.unit} RMS,"
        f" {one.worst_range:.3g} at worst over the calibrated range"
        for name, one in zip(chosen, lost, strict=True)
    ]
    first = 1 if kind.startswith("ardupilot") else 0
    number = device if device is not None else first
    text = render(kind, fitted, chosen, number, "\n".join(head))
    return Rendered(text, dict(zip(chosen, lost, strict=True)), notes)


def _sweep(chip: Chip, places: Sequence[int]) -> FullAnswers:
    """Return the full model's answers over its calibrated range, on the sweep of `zerodrift
    diff`."""
    model = chip.model
    times, profiles = plan_sweep(model, model)
    count = min(int(times[-1] / model.sample_period_s) + 1, MOST_STEPS)
    grid = model.sample_period_s * np.arange(count)
    columns = [np.interp(grid, times, profiles[key_of(channel)]) for channel in model.channels]
    _, codes = encode_values(model, np.stack(columns, axis=1))
    drift, _ = chip.run(codes, 0)
    return FullAnswers(columns[model.guards.temperature_channel], _scale(model, drift)[:, places])


def _read_logs(
    chip: Chip,
    config: Config,
    paths: Sequence[Path],
    places: Sequence[int],
    say: Callable[[str], None],
) -> tuple[FullAnswers | None, tuple[str, ...]]:
    """Return the full model's answers over the logs, at steps without a flag, and notes."""
    model = chip.model
    wanted = [c.source or c.name for c in model.channels]
    wanted += [f"{MEASURED}{output.name}" for output in model.outputs]
    columns = name_columns(config, wanted)
    degrees, drifts, notes = [], [], []
    for path in paths:
        say(f"computing {path.name}")
        steps = read_log_steps(config, path, columns)
        told = answer(chip, config, steps, with_range=False)
        notes += [*steps.notes, *told.notes]
        warm = np.concatenate(
            [steps.resample(find_column(config, "temperature_degC"), s) for s in steps.stretches]
        )
        sound = (told.flags == 0) & np.isfinite(warm)
        degrees.append(warm[sound])
        drifts.append(_scale(model, told.drift[sound].astype(np.int32))[:, places])
    if not degrees or not sum(part.size for part in degrees):
        return None, tuple(dict.fromkeys(notes))
    return FullAnswers(np.concatenate(degrees), np.concatenate(drifts)), tuple(dict.fromkeys(notes))


def _scale(model: IntegerModel, drift: NDArray[np.int32]) -> Array:
    scales = np.array([float(output.lsb_per_unit) for output in model.outputs])
    return np.asarray(drift / scales, dtype=np.float64)


def _list_logs(config: Config) -> list[Path]:
    """Return the logs of the project, each once."""
    return list(dict.fromkeys(s.path for use in USES for s in expand_selectors(config, use)))
