"""Single real records: would predicting later stretches from earlier ones choose a better model?

The records of `single_records`. Each of some models is fitted to the beginning of the first 60 %,
and the next eighth of these is predicted, five times over; a rule takes the model with the least
error there, and is judged by the last 40 %, over the error of the best simple fit there.
Beside the rules stand each model taken always, and the choice that only hindsight could make.

    python -m benchmarks.study_forward [--only TEXT]
"""

import argparse
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from benchmarks.single_records import FEWEST, TAUGHT, Record, fit_simple, list_records
from zerodrift.base.config import EffectConfig
from zerodrift.base.errors import InputError
from zerodrift.dataset.runs import Run
from zerodrift.physics.catalogue import load_catalogue
from zerodrift.physics.fit import fit

EIGHTHS = (3, 4, 5, 6, 7)
"""Of the taught part, predicted in turn from all before."""


def _effect(kind: str, **held: float) -> EffectConfig:
    return EffectConfig(kind, held)


MODELS: dict[str, tuple[EffectConfig, ...]] = {
    "constant": (),
    "line": (_effect("zero_tempco"),),
    "square": (_effect("zero_tempco", order=2),),
    "cubic": (_effect("zero_tempco", order=3),),
    "line + lag": (_effect("zero_tempco"), _effect("thermal_lag")),
    "line + two lags": (_effect("zero_tempco"), _effect("thermal_lag", time_constants=2)),
}


@dataclass(frozen=True)
class Course:
    """One record: what each model's errors were, as mean squares."""

    name: str
    forward: dict[str, tuple[float, ...]]
    last: dict[str, float]
    simple: tuple[float, ...]

    def take(self, model: str) -> float:
        """Return a model's error on the last part over that of the best simple fit."""
        return float(np.sqrt(self.last[model])) / min(self.simple)


def _predict(effects: Sequence[EffectConfig], run: Run, first: int, last: int) -> float:
    """Return the mean square error on the rows first .. last of a fit to those before."""
    train = run.take(slice(0, first))
    after = replace(run.take(slice(first, last)), part=1, name="record#2", before=train)
    model = fit(
        effects,
        (train,),
        outputs=("U",),
        units=("x",),
        full_scale=(10.0 * float(np.ptp(run.measured)),),
        catalogue=load_catalogue(),
    )
    return float(np.mean((after.drift - model.predict(after)) ** 2))


def look(record: Record) -> Course:
    """Return what the models do on a record."""
    count = record.drift.size
    taught = round(TAUGHT * count)
    run = Run(
        name="record",
        group="record",
        part=0,
        source=Path("record.csv"),
        sample_period_s=record.period_s,
        time_s=record.period_s * np.arange(count),
        temperature_degC=record.temperature_degC,
        measured=record.drift[:, None],
        reference=np.zeros((count, 1)),
    )
    edges = np.linspace(0, taught, 9).round().astype(int).tolist()
    forward, last = {}, {}
    for name, effects in MODELS.items():
        try:
            forward[name] = tuple(_predict(effects, run, edges[k], edges[k + 1]) for k in EIGHTHS)
        except InputError:
            forward[name] = (float("inf"),)  # its beginning does not move
        last[name] = _predict(effects, run, taught, count)
    return Course(record.name, forward, last, fit_simple(record, taught))


def _take_always(name: str, course: Course) -> str:
    return name


def main(arguments: Sequence[str] | None = None) -> int:
    """Print a line for each rule."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", default="", help="records whose name has this")
    options = parser.parse_args(arguments)
    records = [r for r in list_records() if options.only in r.name and r.drift.size >= FEWEST]
    courses = []
    for number, record in enumerate(records, 1):
        courses.append(look(record))
        print(f"\r{number} of {len(records)} records", end="", file=sys.stderr, flush=True)
    print(file=sys.stderr)
    rules: dict[str, Callable[[Course], str]] = {
        "least squares forward": lambda c: min(MODELS, key=lambda m: sum(c.forward[m])),
        "least logarithms forward": lambda c: min(
            MODELS, key=lambda m: float(np.sum(np.log(c.forward[m])))
        ),
        "hindsight": lambda c: min(MODELS, key=lambda m: c.last[m]),
    }
    for name in MODELS:
        rules[f"always {name}"] = partial(_take_always, name)
    for rule, choose in rules.items():
        ratios = np.array([c.take(choose(c)) for c in courses])
        worse = sum(np.sqrt(c.last[choose(c)]) > 1.05 * min(c.simple[:2]) for c in courses)
        print(
            f"{rule:26s} {len(courses)} records: median ratio {np.median(ratios):.2f}; worse than "
            f"constant or line by over 5 %: {worse}"
        )
    return 0


if __name__ == "__main__":
    sys.exit(main())
