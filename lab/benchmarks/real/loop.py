"""The product's own loop on some rows of a record, and what it then predicts of others."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from benchmarks.real.records import Array, Record
from benchmarks.real.simple import Rows
from zerodrift.base.config import EffectConfig
from zerodrift.dataset.runs import Dataset, Run
from zerodrift.diagnosis.course import diagnose_until_done
from zerodrift.diagnosis.revision import list_needless
from zerodrift.physics.catalogue import load_catalogue
from zerodrift.physics.fit import fit

ROOM = 10.0
"""Full scale over the span of the drift that was taught."""


@dataclass(frozen=True)
class Prediction:
    """What the loop came to."""

    drift: Array
    """[n] as predicted; nan outside the rows that were asked for."""
    effects: tuple[str, ...]
    verdicts: tuple[str, ...]
    """The effect that each diagnosis named, or its verdict."""


def run_loop(
    record: Record, train: Rows, fold: Rows, advance: Callable[[str], None] = lambda kind: None
) -> Prediction:
    """Return what the loop's model, taught by some rows, predicts of others.

    `diagnose`, `add` what it names until it names nothing, and `remove` what it says to drop. The
    rows that are not taught are a gap in the log, so they are not read. The prediction reads the
    fold's channels and not its drift.

    Args:
        record: the log.
        train: [n] rows that teach.
        fold: [n] rows that are predicted.
        advance: is told of each effect that was tried.

    Raises:
        ZerodriftError: the rows cannot be fitted.
    """
    taught = _cut(record, train, record.drift)
    dataset = Dataset(
        taught,
        (),
        (),
        ("U",),
        (record.unit,),
        (ROOM * float(np.ptp(record.drift[train])) or 1.0,),
    )
    catalogue = load_catalogue()
    course = diagnose_until_done([EffectConfig("zero_tempco")], dataset, catalogue, advance)
    effects = course.effects
    while needless := list_needless(effects, dataset, catalogue):
        effects = tuple(effect for effect in effects if effect.kind != needless[0])
    model = fit(
        effects,
        dataset.train,
        outputs=dataset.outputs,
        units=dataset.units,
        full_scale=dataset.full_scale,
        catalogue=catalogue,
    )
    whole = _cut(record, train | fold, np.where(train, record.drift, 0.0), fold)
    predicted = np.full(record.drift.size, np.nan)
    for run in whole:
        first = int(np.searchsorted(record.place, round(run.time_s[0] / record.period_s)))
        if fold[first]:
            predicted[first : first + len(run)] = model.predict(run)[:, 0]
    return Prediction(
        predicted,
        tuple(effect.kind for effect in effects),
        tuple(step.effect or step.verdict for step in course.steps),
    )


def _cut(record: Record, rows: Rows, drift: Array, apart: Rows | None = None) -> tuple[Run, ...]:
    """Return some rows of a record as one run with gaps, each stretch linked to the one before.

    Args:
        record: the log.
        rows: [n] which rows.
        drift: [n]
        apart: [n] rows that are stretches of their own; None: none are.
    """
    chosen = np.flatnonzero(rows)
    breaks = np.diff(record.place[chosen]) > 1
    if apart is not None:
        breaks |= np.diff(apart[chosen].astype(int)) != 0
    runs: list[Run] = []
    for part, at in enumerate(np.split(chosen, np.flatnonzero(breaks) + 1)):
        run = Run(
            name="record" if part == 0 else f"record#{part + 1}",
            group="record",
            part=part,
            source=Path("record.csv"),
            sample_period_s=record.period_s,
            time_s=record.period_s * (record.place[at] - record.place[0]),
            temperature_degC=record.temperature_degC[at],
            measured=np.asfortranarray(drift[at, None]),
            reference=np.zeros((at.size, 1), order="F"),
            inputs={name: values[at] for name, values in record.inputs.items()},
            start_s=0.0,
        )
        runs.append(replace(run, before=runs[-1]) if runs else run)
    return tuple(runs)
