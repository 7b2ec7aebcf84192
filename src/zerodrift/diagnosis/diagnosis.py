"""The result of a diagnosis: the verdict, the candidates, and what to do next."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import ClassVar

from zerodrift.dataset.runs import OutlierCount
from zerodrift.diagnosis.candidates import Untested
from zerodrift.diagnosis.changes import AddCommand
from zerodrift.diagnosis.data_notes import DataNote
from zerodrift.diagnosis.drivers import OtherThermometer
from zerodrift.diagnosis.remainder import RemainderPattern

SURE = 0.99
"""A higher probability is told as higher than this, one below 1 - SURE likewise."""
MOST_NAMED = 3
"""Runs that a sentence names."""
LIKELY = 0.5
"""From this probability on, something else that is missing is told."""


def write_probability(probability: float) -> str:
    """Return a probability as a percentage, without digits that the maps cannot support."""
    if probability > SURE:
        return f"> {100.0 * SURE:.0f} %"
    if probability < 1.0 - SURE:
        return f"< {100.0 * (1.0 - SURE):.0f} %"
    return f"{100.0 * probability:.0f} %"


@dataclass(frozen=True)
class CandidateReport:
    """One effect as the report lists it."""

    ALIASES: ClassVar = ("heldout_rmse_ratio",)

    effect: str
    rmse_left_out_ratio: float
    """RMSE on runs left out with it, over that of the model as it is."""
    p_value: float
    """How often chance alone does as well."""
    excitation: float
    """Share of its features that the model as it is cannot imitate."""
    parameters: Mapping[str, float]
    testable: bool = True
    nats: float = 0.0
    """Gain in log-likelihood on runs left out, the noise fitted anew beside either model."""
    explained: float = 0.0
    """Share of the squared error above the floor that it takes away."""
    sound: bool = True
    """Whether its values are off their bounds and such as the logs can show."""
    probability: float = 0.0
    """That this effect is missing, among logs like those of `benchmarks.study_probability`."""

    @property
    def heldout_rmse_ratio(self) -> float:
        """Older name of `rmse_left_out_ratio`."""
        return self.rmse_left_out_ratio


@dataclass(frozen=True)
class OutputErrors:
    """RMSE of one output on runs left out, in its unit."""

    ALIASES: ClassVar = ("rmse_heldout", "rmse_heldout_after")

    unit: str
    rmse_left_out: float
    rmse_left_out_after: float | None
    """With the missing effect; null unless the verdict is `missing`."""
    noise_floor: float

    @property
    def rmse_heldout(self) -> float:
        """Older name of `rmse_left_out`."""
        return self.rmse_left_out

    @property
    def rmse_heldout_after(self) -> float | None:
        """Older name of `rmse_left_out_after`."""
        return self.rmse_left_out_after


@dataclass(frozen=True)
class Diagnosis:
    """What a model lacks, and how sure that is."""

    ALIASES: ClassVar = ("floor",)

    verdict: str
    """missing | complete | unknown."""
    effect: str | None
    """The effect that is missing; null unless the verdict is `missing`."""
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
    """RMSE on runs left out over the noise floor, pooled over outputs."""
    floor_ratio_after: float
    """The same with the effect added; with `complete` and `unknown`, as it is."""
    noise_floor_source: str
    """dwell | estimated."""
    outputs: Mapping[str, OutputErrors]
    """Output -> its errors."""
    remainder: tuple[RemainderPattern, ...]
    """For `unknown`, and where something else is likely missing too: what the remainder follows."""
    next_experiment: str
    evidence: str
    """How many runs count as evidence, and whether they are few."""
    remarks: tuple[str, ...] = ()
    drop: tuple[str, ...] = ()
    """Effects of the model that no longer earn their place."""
    nothing_missing: float = 0.0
    """Probability that the model lacks nothing that these logs show."""
    something_else: float = 0.0
    """Probability that something is missing beside the effect that is named; where none is named,
    that anything is."""
    notes: tuple[DataNote, ...] = ()
    """What looks wrong with the logs; the same in words is among the remarks."""
    outliers: OutlierCount = field(default_factory=lambda: OutlierCount(0, {}))
    """In the training and dwell logs; they hardly count in what is said here."""

    @property
    def probability(self) -> float:
        """Probability that the effect that is named is missing; 0 where none is named."""
        return self.probability_of(self.effect)

    @property
    def wrong_runs(self) -> tuple[str, ...]:
        """The runs whose data look wrong: what is said of a model holds once they are mended."""
        runs = (note.run for note in self.notes if note.run and note.stops)
        return tuple(dict.fromkeys(runs))

    def tell_wrong_runs(self) -> str:
        """Return the names of these runs, the first few of many; empty where there are none."""
        *first, last = [*self.wrong_runs[:MOST_NAMED], "others"][: len(self.wrong_runs)] or [""]
        return f"{', '.join(first)} and {last}" if first else last

    def probability_of(self, effect: str | None) -> float:
        """Return the probability that an effect is missing; 0 for one that was not tried."""
        return next((c.probability for c in self.candidates if c.effect == effect), 0.0)

    def tell_odds(self) -> str:
        """Return how likely the effect that is named is missing, and something else beside it."""
        known = any(c.effect == self.effect for c in self.candidates)
        words = f", {100.0 * self.probability:.0f} %" if known else ""
        if self.something_else >= LIKELY:
            follows = f", which follows {self.remainder[0].follows}" if self.remainder else ""
            words += f"; and something else{follows}"
        return words

    @property
    def floor(self) -> str:
        """Older name of `noise_floor_source`."""
        return self.noise_floor_source


# A diagnosis with its sentences and the commands that follow from it.

HEADLINE, DETAIL, STEP = "headline", "detail", "step"


@dataclass(frozen=True)
class Sentence:
    """One sentence of a verdict."""

    text: str
    role: str = DETAIL
    """headline: a page's headline says it already; detail; step: it tells what to type."""


@dataclass(frozen=True)
class ExplainedDiagnosis:
    """What a model lacks, in figures, in sentences, and as what to do about it."""

    diagnosis: Diagnosis
    command: AddCommand | None
    """What adds the missing effect; None where none is named."""
    thermometers: tuple[OtherThermometer, ...]
    """Further thermometers that the drift follows, the best first."""
    sentences: tuple[Sentence, ...]

    @property
    def named(self) -> tuple[str, ...]:
        """The effects that the verdict names, the likeliest first, look-alikes after it."""
        effect = self.diagnosis.effect
        return () if effect is None else (effect, *self.diagnosis.lookalikes)


# Rates how strong a verdict's evidence is, in one word.

STRONG, WEAK, NONE = "strong", "weak", "none"
CHANCE = 0.05
"""p-value above which chance is not ruled out."""
SMALL_GAIN = 0.9
"""RMSE on runs left out with the effect over that without it: above, the gain is small."""


@dataclass(frozen=True)
class EvidenceStrength:
    """What an effect's name rests on."""

    level: str
    """strong | weak | none: nothing is named."""
    why: str
    """What makes it weak, in words; empty where it is not."""


def rate_strength(diagnosis: Diagnosis) -> EvidenceStrength:
    """Return how strong the evidence for the named effect is."""
    named = next((c for c in diagnosis.candidates if c.effect == diagnosis.effect), None)
    if diagnosis.effect is None or named is None:
        return EvidenceStrength(NONE, "")
    reasons = []
    if named.p_value > CHANCE:
        reasons.append(f"too few runs to rule out chance (p = {named.p_value:.2g})")
    if named.rmse_left_out_ratio > SMALL_GAIN:
        gain = 100.0 * (1.0 - named.rmse_left_out_ratio)
        reasons.append(f"the gain on runs left out is only {gain:.1f} %")
    return EvidenceStrength(WEAK if reasons else STRONG, " and ".join(reasons))
