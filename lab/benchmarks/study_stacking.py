"""Single real records: does a weighted mean of models predict better than one that is chosen?

The records of `single_records`. Six models by least squares (constant, line, cubic, and lines
behind one and two lags) and the same beside noise that wanders (a local level, whose last value
stands for the offset) learn the first 60 % and predict the last 40 %. Rules look at how each model
predicted later stretches of the first 60 % from earlier ones:

- choose: the model with the least error there;
- stack: weights that sum to one and are none below zero, with the least error there; drawn towards
  equal weights by a ridge of 0, 0.1 or 1 times the mean error;
- mean, median: of all predictions, whatever the past says.

A rule that is picked here by half of the records is judged by the other half, which is printed
beside it.

    python -m benchmarks.study_stacking
"""

import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from scipy.signal import lfilter

from benchmarks.single_records import DATA, FEWEST, TAUGHT, Record, fit_simple, list_records
from zerodrift.base.arrays import Array

LAGS = 14
GAINS = (0.0003, 0.001, 0.003, 0.01, 0.03, 0.1, 0.3, 1.0)
"""Of the local level: the share of each innovation that stays."""
STARTS = (4, 5, 6)
"""Eighths of the taught part after which all of the rest of it is predicted."""
STEPS = 3000
WORSE = 1.05


@dataclass(frozen=True)
class Course:
    """One record: its last part, and what each model said of it and of later taught stretches."""

    truth: Array
    last: dict[str, Array]
    past_truth: tuple[Array, ...]
    past: dict[str, tuple[Array, ...]]
    simple: tuple[float, ...]

    def measure(self, weights: dict[str, float]) -> float:
        """Return the RMS error on the last part of a weighted sum of models."""
        total = sum((w * self.last[name] for name, w in weights.items()), np.zeros(()))
        return float(np.sqrt(np.mean((self.truth - total) ** 2)))


def list_designs(record: Record) -> dict[str, list[Array]]:
    """Return each model's columns [n, P], one table for each lag or pair of lags to try."""
    t = record.temperature_degC - record.temperature_degC[:10].mean()
    t /= float(np.ptp(t)) or 1.0
    one = np.ones((t.size, 1))
    longest = TAUGHT * t.size * record.period_s / 6.0

    def lag(tau_s: float) -> Array:
        a = float(np.exp(-record.period_s / tau_s))
        return np.asarray(t[0] + lfilter([1.0 - a], [1.0, -a], t - t[0]))

    lags = [lag(float(tau)) for tau in np.geomspace(2.0 * record.period_s, longest, LAGS)]
    pairs = [(lags[i], lags[j]) for i in range(0, LAGS, 3) for j in range(i + 3, LAGS, 3)]
    return {
        "constant": [one],
        "line": [np.c_[one, t]],
        "cubic": [np.c_[one, t, t**2, t**3]],
        "lag": [np.c_[one, one_lag] for one_lag in lags],
        "line + lag": [np.c_[one, t, one_lag] for one_lag in lags],
        "two lags": [np.c_[one, first, second] for first, second in pairs],
    }


def predict_plain(tables: Sequence[Array], y: Array, taught: int, end: int) -> Array:
    """Return the prediction of rows taught .. end by least squares on those before."""
    best, found = np.inf, np.zeros(0)
    for table in tables:
        answer = np.linalg.lstsq(table[:taught], y[:taught], rcond=None)[0]
        cost = float(np.sum((y[:taught] - table[:taught] @ answer) ** 2))
        if cost < best:
            best, found = cost, table[taught:end] @ answer
    return found


def predict_wandering(tables: Sequence[Array], y: Array, taught: int, end: int) -> Array:
    """Return the same beside a local level, whose last value goes on."""
    best, found = np.inf, np.zeros(0)
    for table in tables:
        columns = table[:, 1:]
        for gain in GAINS:
            pole = [1.0, gain - 1.0]
            target = lfilter([1.0, -1.0], pole, y[:taught] - y[0])[1:]
            answer, rest = np.zeros(0), target
            if columns.shape[1]:
                moved = columns[:taught] - columns[0]
                moved = lfilter([1.0, -1.0], pole, moved, axis=0)[1:]
                answer = np.linalg.lstsq(moved, target, rcond=None)[0]
                rest = target - moved @ answer
            cost = float(np.sum(rest**2))
            if cost < best:
                left = y[:taught] - columns[:taught] @ answer
                begin = [(1.0 - gain) * float(left[: max(1, taught // 10)].mean())]
                level = float(lfilter([gain], pole, left, zi=begin)[0][-1])
                best, found = cost, columns[taught:end] @ answer + level
    return found


def look(record: Record) -> Course:
    """Return what the models say of a record."""
    y, count = record.drift, record.drift.size
    taught = round(TAUGHT * count)
    edges = np.linspace(0, taught, 9).round().astype(int).tolist()
    last, past = {}, {}
    for name, tables in list_designs(record).items():
        for how, predict in (("", predict_plain), (", wandering", predict_wandering)):
            last[name + how] = predict(tables, y, taught, count)
            past[name + how] = tuple(predict(tables, y, edges[k], taught) for k in STARTS)
    truth = tuple(y[edges[k] : taught] for k in STARTS)
    return Course(y[taught:], last, truth, past, fit_simple(record, taught))


def choose(course: Course, names: Sequence[str]) -> dict[str, float]:
    """Return the whole weight on the model that predicted best."""

    def cost(name: str) -> float:
        pairs = zip(course.past_truth, course.past[name], strict=True)
        return float(sum(np.mean((truth - told) ** 2) for truth, told in pairs))

    return {min(names, key=cost): 1.0}


def weigh_alike(course: Course, names: Sequence[str]) -> dict[str, float]:
    """Return the same weight on every model."""
    return dict.fromkeys(names, 1.0 / len(names))


def stack(course: Course, names: Sequence[str], ridge: float) -> dict[str, float]:
    """Return weights on the simplex with the least error, by exponentiated gradient."""
    errors = [
        np.concatenate(
            [
                (told - truth) / np.sqrt(truth.size)
                for truth, told in zip(course.past_truth, course.past[name], strict=True)
            ]
        )
        for name in names
    ]
    normal = np.array([[float(a @ b) for b in errors] for a in errors])
    normal = normal / np.mean(np.diag(normal)) + ridge * np.eye(len(names))
    weights = np.full(len(names), 1.0 / len(names))
    for _ in range(STEPS):
        slope = normal @ weights
        weights = weights * np.exp(-0.5 * (slope - slope.min()) / np.abs(slope).max())
        weights /= weights.sum()
    return dict(zip(names, weights.tolist(), strict=True))


def print_rule(label: str, courses: Sequence[Course], errors: Array) -> None:
    """Print a rule's line: over all records, and over the two halves."""
    best = np.array([min(course.simple) for course in courses])
    plain = np.array([min(course.simple[:2]) for course in courses])
    ratio, worse = errors / best, errors > WORSE * plain
    print(
        f"{label:34s} median {np.median(ratio):.2f} (halves {np.median(ratio[::2]):.2f}, "
        f"{np.median(ratio[1::2]):.2f}), worst {ratio.max():.2f}; worse than constant or line by "
        f"over 5 %: {int(worse.sum())} (halves {int(worse[::2].sum())}, {int(worse[1::2].sum())})"
    )


def main() -> int:
    """Print a line for each rule."""
    if not DATA.is_dir():
        print("skipped: shared/data is not beside the repository")
        return 0
    records = [record for record in list_records() if record.drift.size >= FEWEST]
    courses = [look(record) for record in records]
    print(f"{len(courses)} real records: error on the last 40 % over that of the best simple fit")
    names = list(courses[0].last)
    groups = {
        "plain": [name for name in names if "wandering" not in name],
        "wandering": [name for name in names if "wandering" in name],
        "all": names,
    }
    for name in names:
        print_rule(f"always {name}", courses, np.array([c.measure({name: 1.0}) for c in courses]))
    for group, mine in groups.items():
        rules: dict[str, Callable[[Course], dict[str, float]]] = {
            "choose": partial(choose, names=mine),
            **{f"stack, ridge {r:g}": partial(stack, names=mine, ridge=r) for r in (0.0, 0.1, 1.0)},
            "mean": partial(weigh_alike, names=mine),
        }
        for rule, weigh in rules.items():
            errors = np.array([course.measure(weigh(course)) for course in courses])
            print_rule(f"{rule}: {group}", courses, errors)
        hindsight = [min(c.measure({name: 1.0}) for name in mine) for c in courses]
        print_rule(f"hindsight: {group}", courses, np.array(hindsight))
    return 0


if __name__ == "__main__":
    sys.exit(main())
