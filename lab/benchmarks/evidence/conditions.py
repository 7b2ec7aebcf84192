"""What is asked of a simulator: twelve named conditions, or all factors drawn."""

import zlib
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from benchmarks.foreign import effects as foreign
from benchmarks.hidden import cases as own
from benchmarks.third_simulator import EFFECTS, OUTSIDE, list_effects
from benchmarks.third_simulator.families import FAMILIES

PURPOSES = ("one", "complete", "outside", "beside")
NOISES = ("white", "flicker", "walk", "mixed", "coarse")


@dataclass(frozen=True)
class Condition:
    """What logs are like."""

    fewest_runs: int
    most_runs: int
    dwell: bool = True
    noise: str = "white"
    outliers: float = 0.0
    """Share of the rows."""


CONDITIONS = {
    "clean": Condition(6, 12),
    "runs_2": Condition(2, 2),
    "runs_3": Condition(3, 3),
    "runs_4": Condition(4, 4),
    "runs_5": Condition(5, 5),
    "no_dwell": Condition(6, 12, dwell=False),
    "no_dwell_runs_4": Condition(4, 4, dwell=False),
    "outliers_0.2": Condition(6, 12, outliers=0.002),
    "outliers_2": Condition(6, 12, outliers=0.02),
    "flicker": Condition(6, 12, noise="flicker"),
    "coarse": Condition(6, 12, noise="coarse"),
    "hard": Condition(4, 6, dwell=False, noise="mixed", outliers=0.01),
}


@dataclass(frozen=True)
class Ask:
    """One case that a simulator is asked for.

    Attributes:
        simulator: 1 (the twin), 2 (the foreign one) or 3.
        condition: name of one of `CONDITIONS`, or "drawn".
        purpose: one | pair | complete | outside | beside: one, and another outside the catalogue.
        hidden: effects by the simulator's names.
        size: of each, in RMS of the noise.
        runs: training runs; two more are for judging.
        logs: what logs are like.
        seed: of the case.
    """

    simulator: int
    condition: str
    purpose: str
    hidden: tuple[str, ...]
    size: float
    runs: int
    logs: Condition
    seed: int

    @property
    def listed(self) -> tuple[str, ...]:
        """What is hidden and has a name in the catalogue."""
        outside = list_hidden(self.simulator, "outside")
        return tuple(name for name in self.hidden if name not in outside)


def list_hidden(simulator: int, purpose: str) -> tuple[str, ...]:
    """Return the names from which a simulator's hidden effects are drawn."""
    if purpose == "outside":
        return {1: own.OUTSIDE, 2: foreign.DISTURBANCES, 3: tuple(OUTSIDE)}[simulator]
    return {1: own.LISTED, 2: foreign.CATALOGUE, 3: tuple(EFFECTS)}[simulator]


def list_asks(simulator: int, name: str, purpose: str, seed: int, only: str = "") -> Iterator[Ask]:
    """Give cases of a condition without end, every effect once before any comes twice.

    With `only`, that effect is hidden in each of them.
    """
    condition = CONDITIONS[name]
    rng = np.random.default_rng([seed, simulator, zlib.crc32(name.encode()), len(purpose)])
    few = condition.most_runs <= 5
    while True:
        source = "one" if purpose == "beside" else purpose
        hidden_here = [only] if only else list_hidden(simulator, source)
        names = [""] if purpose == "complete" else rng.permutation(hidden_here)
        for hidden in names:
            other = rng.choice(list_hidden(simulator, "outside")) if purpose == "beside" else ""
            yield Ask(
                simulator=simulator,
                condition=name,
                purpose=purpose,
                hidden=tuple(str(one) for one in (hidden, other) if one),
                size=0.0 if not hidden else 3.0 if few else float(rng.choice([1.0, 3.0, 10.0])),
                runs=int(rng.integers(condition.fewest_runs, condition.most_runs + 1)),
                logs=condition,
                seed=int(rng.integers(2**31)),
            )


def draw_asks(simulator: int, seed: int) -> Iterator[Ask]:
    """Give cases without end, drawn over all factors."""
    rng = np.random.default_rng([seed, simulator, 99])
    while True:
        purpose = str(rng.choice(["one", "pair", "complete", "outside"], p=[0.45, 0.1, 0.25, 0.2]))
        yield draw_ask(rng, simulator, purpose, "drawn")


def draw_ask(rng: np.random.Generator, simulator: int, purpose: str, name: str) -> Ask:
    """Return one case of a purpose, all else drawn."""
    count = {"one": 1, "pair": 2, "complete": 0, "outside": 1}[purpose]
    names = list_hidden(simulator, purpose)
    if simulator == 3 and purpose == "pair":
        names = list_effects(str(rng.choice(list(FAMILIES))))
    logs = Condition(
        *(2, 12),
        dwell=bool(rng.random() < 0.6),
        noise=str(rng.choice(NOISES)),
        outliers=float(rng.choice([0.0, 0.0, 0.002, 0.02])),
    )
    return Ask(
        simulator=simulator,
        condition=name,
        purpose=purpose,
        hidden=tuple(str(one) for one in rng.choice(names, count, replace=False)),
        size=float(np.exp(rng.uniform(np.log(0.7), np.log(10.0)))) if count else 0.0,
        runs=int(rng.integers(2, 13)),
        logs=logs,
        seed=int(rng.integers(2**31)),
    )


def list_walks(simulator: int, seed: int) -> Iterator[Ask]:
    """Give cases for the loop without end: one and two hidden effects in turn, clean logs."""
    rng = np.random.default_rng([seed, simulator, 98])
    while True:
        for purpose in ("one", "pair"):
            ask = draw_ask(rng, simulator, purpose, "loop")
            yield Ask(
                simulator=simulator,
                condition="loop",
                purpose=purpose,
                hidden=ask.hidden,
                size=float(rng.choice([3.0, 10.0])),
                runs=int(rng.integers(6, 11)),
                logs=CONDITIONS["clean"],
                seed=ask.seed,
            )
