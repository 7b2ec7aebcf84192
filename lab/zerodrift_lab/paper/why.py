"""Three small experiments on why a ranking comes out or not: span, training, one-sided heat."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from zerodrift.diagnosis.memory import MemoryTable, find_time_constants
from zerodrift_lab.methods import METHODS
from zerodrift_lab.methods.networks import WINDOW
from zerodrift_lab.paper.plan import (
    DEFAULT,
    HEATED,
    LOGS,
    SPAN_METHOD,
    SPANS_S,
    TRAINED,
    Plan,
)
from zerodrift_lab.paper.store import Cell
from zerodrift_lab.paper.study import COURSE_TESTS
from zerodrift_lab.paper.summary import Outcomes, Spread, pool_floors, pool_percent, summarise
from zerodrift_lab.paper.world import record_training

HEAT_TESTS = ("chamber", "heating", "cooling", "walking_still")


@dataclass(frozen=True)
class Spans:
    """Errors by the length of the window."""

    lengths_s: tuple[float, ...]
    """0: one sample."""
    errors: dict[str, tuple[Spread, ...]]
    """Test -> per length, in multiples of the noise floor."""
    time_constants_s: tuple[float, ...]
    """Of all specimens of the experiment, as the advice finds them in the training logs."""

    def explain(self) -> list[str]:
        """Return what the experiment shows."""
        lags = ", ".join(f"{tau:.2g}" for tau in self.time_constants_s) or "none"
        sentences = [
            f"Window span against thermal time constants. Lags found in the chamber logs: {lags} s."
        ]
        for test, spreads in self.errors.items():
            told = ", ".join(
                f"{spread.median:.3g} at {length:g} s"
                for length, spread in zip(self.lengths_s, spreads, strict=True)
            )
            best = min(range(len(spreads)), key=lambda i: spreads[i].median)
            sentences.append(
                f"{test.capitalize()}: error in multiples of the noise floor by the window's "
                f"length: {told}; least at {self.lengths_s[best]:g} s."
            )
        return sentences


@dataclass(frozen=True)
class Training:
    """Errors along the paper's recipe, and by the quick schedule."""

    epochs: int
    courses: dict[str, list[tuple[int, float, float]]]
    """Method -> (epoch, CPU seconds, held-out chamber error in % of the drift)."""
    quick: dict[str, tuple[float, float]]
    """Method -> (CPU seconds, error)."""

    def explain(self) -> list[str]:
        """Return what the experiment shows."""
        ends = {m: course[-1][2] for m, course in self.courses.items() if course}
        quick = {m: error for m, (_, error) in self.quick.items()}

        def write(errors: dict[str, float]) -> str:
            return ", ".join(f"{METHODS[m].title} {error:.3g} %" for m, error in errors.items())

        apart, after = (max(e.values()) / min(e.values()) for e in (ends, quick))
        return [
            f"Training. Held-out chamber error after {self.epochs} epochs of the recipe: "
            f"{write(ends)}: a factor of {apart:.3g} between networks that see the same samples. "
            f"The same networks by one learning-rate cycle: {write(quick)}: a factor of "
            f"{after:.3g}."
        ]


@dataclass(frozen=True)
class Heat:
    """Errors by what a method was trained on."""

    errors: dict[tuple[str, str], dict[str, Spread]]
    """(method, logs) -> test -> multiples of the noise floor."""

    def explain(self) -> list[str]:
        """Return what the experiment shows."""
        sentences = []
        for (method, logs), errors in self.errors.items():
            told = ", ".join(f"{test} {spread.median:.3g}" for test, spread in errors.items())
            sentences.append(f"{METHODS[method].title}, trained on {logs}: {told}.")
        return [
            "One-sided heat. Errors in multiples of the noise floor, by what the method was "
            "trained on: " + " ".join(sentences)
        ]


@dataclass(frozen=True)
class Why:
    """The three experiments."""

    spans: Spans
    training: Training
    heat: Heat

    def explain(self) -> list[str]:
        """Return what they show."""
        return [*self.spans.explain(), *self.training.explain(), *self.heat.explain()]

    def to_dict(self) -> dict[str, Any]:
        """Return them as JSON values."""
        return {
            "spans": {
                "lengths_s": list(self.spans.lengths_s),
                "time_constants_s": list(self.spans.time_constants_s),
                "rmse_over_floor": {
                    test: [s.median for s in spreads] for test, spreads in self.spans.errors.items()
                },
            },
            "training": {
                "recipe_epochs": self.training.epochs,
                "courses": {m: [list(x) for x in c] for m, c in self.training.courses.items()},
                "quick": {m: list(x) for m, x in self.training.quick.items()},
            },
            "heat": [
                {"method": m, "logs": logs, "rmse_over_floor": {t: s.median for t, s in e.items()}}
                for (m, logs), e in self.heat.errors.items()
            ],
        }


def investigate(plan: Plan, outcomes: Outcomes) -> Why:
    """Return the three experiments from the outcomes of a plan."""
    return Why(_vary_span(plan, outcomes), _follow(plan, outcomes), _heat(plan, outcomes))


def _vary_span(plan: Plan, outcomes: Outcomes) -> Spans:
    seed = plan.seeds[0]
    by_length = [outcomes.get(Cell("mlp", s, seed) for s in plan.few)] + [
        outcomes.get(Cell(SPAN_METHOD, s, seed, spacing_s=x) for s in plan.few) for x in SPANS_S
    ]
    taus = []
    for sensor in plan.few:
        found = find_time_constants(MemoryTable(record_training(sensor, "chamber", False)))
        taus += [lag.tau_s for lag in found]
    return Spans(
        (0.0, *((WINDOW - 1) * x for x in SPANS_S)),
        {
            test: tuple(summarise(pool_floors(o, test) for o in group) for group in by_length)
            for test in ("chamber", "heating")
        },
        tuple(sorted(taus)),
    )


def _follow(plan: Plan, outcomes: Outcomes) -> Training:
    courses: dict[str, list[tuple[int, float, float]]] = {}
    quick = {}
    test = COURSE_TESTS[0]
    for outcome in outcomes.get(plan.training_cells()):
        method = outcome.cell.method
        if outcome.cell.course:
            courses[method] = [
                (
                    point["epoch"],
                    point["cpu_s"],
                    100.0
                    * float(
                        np.sqrt(
                            np.mean((np.array(point["tests"][test]["rmse"]) / outcome.scale()) ** 2)
                        )
                    ),
                )
                for point in outcome.result["course"]
            ]
        else:
            quick[method] = (outcome.result["fit_cpu_s"], pool_percent(outcome, test))
    return Training(plan.recipe_epochs, {m: courses[m] for m in TRAINED}, quick)


def _heat(plan: Plan, outcomes: Outcomes) -> Heat:
    seed = plan.seeds[0]
    errors: dict[tuple[str, str], dict[str, Spread]] = {}
    named = {
        "chamber": "the chamber alone",
        "unwalked": "the chamber and bench logs without the walk's plates",
        "varied": "the chamber and bench logs",
    }
    for method in HEATED:
        for logs in LOGS:
            found = outcomes.get(Cell(method, s, seed, logs=logs) for s in plan.few)
            errors[method, named[logs]] = {
                test: summarise(pool_floors(o, test) for o in found) for test in HEAT_TESTS
            }
    found = outcomes.get(Cell(DEFAULT, s, seed, logs="varied", body=True) for s in plan.few)
    errors[DEFAULT, "those, with a second thermometer"] = {
        test: summarise(pool_floors(o, test) for o in found) for test in HEAT_TESTS
    }
    return Heat(errors)
