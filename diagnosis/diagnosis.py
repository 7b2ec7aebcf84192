"""What a diagnosis says: the verdict, the candidates, and what to do next."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from zerodrift.diagnosis.candidates import Untested
from zerodrift.diagnosis.remainder import Pattern


@dataclass(frozen=True)
class CandidateReport:
    """One effect as the report lists it."""

    effect: str
    heldout_rmse_ratio: float
    p_value: float
    excitation: float
    parameters: Mapping[str, float]


@dataclass(frozen=True)
class OutputErrors:
    """Held-out RMSE of one output, in its unit."""

    unit: str
    before: float
    after: float | None
    """With the missing effect; None unless the verdict is `missing`."""
    noise_floor: float


@dataclass(frozen=True)
class Diagnosis:
    """What a model lacks, and how sure that is."""

    verdict: str
    """missing | complete | unknown."""
    effect: str | None
    """The effect that is missing; None unless the verdict is `missing`."""
    parameters: Mapping[str, float]
    """Its values as the fit found them, choices included."""
    lookalikes: tuple[str, ...]
    """Effects that these data cannot tell from it."""
    also: tuple[str, ...]
    """Further effects that are missing beside it."""
    nearest: str | None
    """For `unknown`: the effect that comes nearest."""
    candidates: tuple[CandidateReport, ...]
    not_testable: tuple[Untested, ...]
    floor_ratio_before: float
    """Held-out RMSE over the noise floor, pooled over outputs."""
    floor_ratio_after: float
    """The same with the effect added; with `complete` and `unknown`, as it is."""
    floor_source: str
    """dwell | estimated."""
    outputs: Mapping[str, OutputErrors]
    """Output -> its errors."""
    remainder: tuple[Pattern, ...]
    """For `unknown`: what the remainder follows."""
    next_experiment: str
    evidence: str
    """How many runs spoke, and whether that is thin."""
    notes: tuple[str, ...] = ()
    drop: tuple[str, ...] = ()
    """Effects of the model that no longer earn their place."""

    def to_dict(self) -> dict[str, Any]:
        """Return the JSON object of the user's contract, with a few keys more."""
        return {
            "verdict": self.verdict,
            "effect": self.effect,
            "parameters": dict(self.parameters),
            "lookalikes": list(self.lookalikes),
            "also": list(self.also),
            "nearest": self.nearest,
            "candidates": [
                {
                    "effect": c.effect,
                    "heldout_rmse_ratio": c.heldout_rmse_ratio,
                    "p_value": c.p_value,
                    "excitation": c.excitation,
                    "parameters": dict(c.parameters),
                    "testable": True,
                }
                for c in self.candidates
            ],
            "not_testable": [{"effect": u.effect, "why": u.why} for u in self.not_testable],
            "floor_ratio_before": self.floor_ratio_before,
            "floor_ratio_after": self.floor_ratio_after,
            "floor": self.floor_source,
            "outputs": {
                name: {
                    "unit": output.unit,
                    "rmse_heldout": output.before,
                    "rmse_heldout_after": output.after,
                    "noise_floor": output.noise_floor,
                }
                for name, output in self.outputs.items()
            },
            "remainder": [{"follows": p.follows, "share": p.share} for p in self.remainder],
            "next_experiment": self.next_experiment,
            "evidence": self.evidence,
            "notes": list(self.notes),
            "drop": list(self.drop),
        }
