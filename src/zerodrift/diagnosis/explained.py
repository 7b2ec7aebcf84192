"""A diagnosis with its sentences and the commands that follow from it."""

from dataclasses import dataclass

from zerodrift.diagnosis.changes import AddCommand
from zerodrift.diagnosis.diagnosis import Diagnosis
from zerodrift.diagnosis.thermometers import OtherThermometer

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
