"""Rates how strong a verdict's evidence is, in one word."""

from dataclasses import dataclass

from zerodrift.diagnosis.diagnosis import Diagnosis

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
