"""Figures of a diagnosis turned into probabilities, by logistic maps fitted on simulated cases.

The maps are data: `probability.txt` beside this file, written by `python -m
benchmarks.study_probability fit`, which says on how many cases of which kind. So the base rates are
those of these cases, and a probability holds for logs like theirs.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np

from zerodrift.diagnosis.diagnosis import CandidateReport, Diagnosis

MAPS = Path(__file__).with_name("probability.txt")
CANDIDATE, NOTHING, ELSE = "candidate", "nothing_missing", "something_else"
LEAST, MOST = 0.001, 0.999
"""No map that was fitted on some hundred cases can tell a smaller or a larger probability."""
MOST_DECADES = 3.6


@dataclass(frozen=True)
class ProbabilityMap:
    """A logistic map: weights [P] of the figures, the constant first."""

    name: str
    weights: tuple[float, ...]

    def apply(self, figures: Sequence[float]) -> float:
        """Return the probability that belongs to a diagnosis's figures [P]."""
        exponent = float(np.clip(np.dot(self.weights, figures), -20.0, 20.0))
        return float(np.clip(1.0 / (1.0 + np.exp(-exponent)), LEAST, MOST))


@lru_cache(maxsize=1)
def load_maps() -> dict[str, ProbabilityMap]:
    """Return the fitted maps by name."""
    maps = {}
    for line in MAPS.read_text(encoding="utf-8").splitlines():
        if line and not line.startswith("#"):
            name, *weights = line.split()
            maps[name] = ProbabilityMap(name, tuple(float(w) for w in weights))
    return maps


def list_candidate_figures(diagnosis: Diagnosis, candidate: CandidateReport) -> list[float]:
    """Return what tells whether a candidate is missing: its standing, its gain, its share."""
    named = candidate.effect == diagnosis.effect
    beside = candidate.effect in diagnosis.also
    alike = candidate.effect in diagnosis.lookalikes
    nearest = candidate.effect == diagnosis.nearest
    return [
        1.0,
        float(named),
        float(beside),
        float(alike),
        float(nearest),
        float(diagnosis.effect is not None),
        float(np.log1p(max(candidate.nats, 0.0))) * float(candidate.sound),
        candidate.explained * float(candidate.sound),
        min(-float(np.log10(max(candidate.p_value, 1e-9))), MOST_DECADES),
    ]


def list_case_figures(diagnosis: Diagnosis) -> list[float]:
    """Return what tells whether anything is missing, and whether the named effect is all of it."""
    best = max((c.nats for c in diagnosis.candidates if c.sound), default=0.0)
    return [
        1.0,
        float(diagnosis.verdict == "missing"),
        float(diagnosis.verdict == "unknown"),
        float(bool(diagnosis.also)),
        float(np.log(max(diagnosis.floor_ratio_before, 1e-3))),
        float(np.log(max(diagnosis.floor_ratio_after, 1e-3))),
        float(diagnosis.noise_floor_source == "dwell"),
        float(np.log1p(max(best, 0.0))),
    ]


def tell_probabilities(diagnosis: Diagnosis) -> Diagnosis:
    """Return the diagnosis with its probabilities."""
    maps = load_maps()
    figures = list_case_figures(diagnosis)
    nothing = maps[NOTHING].apply(figures)
    beside = maps[ELSE].apply(figures) if diagnosis.effect is not None else 1.0 - nothing
    candidates = tuple(
        replace(c, probability=maps[CANDIDATE].apply(list_candidate_figures(diagnosis, c)))
        for c in diagnosis.candidates
    )
    return replace(diagnosis, candidates=candidates, nothing_missing=nothing, something_else=beside)
