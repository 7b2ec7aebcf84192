"""What is gained by setting aside the samples at a converter's rail."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from zerodrift.base.config import EffectConfig
from zerodrift.diagnosis.case import Case
from zerodrift.diagnosis.evidence import hold_in, hold_out
from zerodrift.diagnosis.examination import Examination, Judged, share_explained
from zerodrift.diagnosis.rules import Finding
from zerodrift.physics.campaign import Campaign
from zerodrift.physics.projection import get_coordinates, list_coordinates
from zerodrift.physics.search import sum_with_slopes
from zerodrift.physics.terms import start_term


def look_at_rails(case: Case, first: Examination) -> Judged | None:
    """Return what setting samples at a converter's rail aside gains, if there are any."""
    known = any(term.effect.sets_aside for term in case.terms)
    kinds = [kind for kind, effect in case.catalogue.items() if effect.sets_aside]
    if known or not kinds or not case.plan.saturated:
        return None
    raw = Campaign(
        case.dataset.train,
        case.plan,
        list(case.catalogue),
        tared=case.campaign.tared,
        set_aside=False,
    )
    coordinates = list_coordinates(first.base.terms)
    position = get_coordinates(first.base.terms, coordinates)
    scores, errors, left = [], [], []
    for campaign in (raw, case.campaign):
        sums = sum_with_slopes(campaign, first.base.terms, coordinates)
        out = hold_out(sums, first.weights, coordinates, position, campaign.unit_of_piece)
        units = campaign.unit_of_piece
        scores.append(np.asarray(np.bincount(units, weights=out.score(first.weights)), float))
        errors.append(out.mean_squares(campaign.means) / first.floor**2)
        inside = hold_in(sums, first.weights).mean_squares(campaign.means)
        left.append(float(np.mean(inside / first.floor**2)))
    effect = case.catalogue[kinds[0]]
    term = start_term(case.catalogue, EffectConfig(effect.kind))
    return Judged(
        kind=effect.kind,
        parameters={},
        found=replace(first.base, terms=(*first.base.terms, term)),
        excitation=1.0,
        sound=True,
        plausible=True,
        gains=scores[0] - scores[1],
        # Seen, not inferred: noise does not repeat an extreme to the last digit.
        p_value=0.0,
        rmse_ratio=float(np.sqrt(np.mean(errors[1]) / np.mean(errors[0]))),
        best_output_ratio=float(np.sqrt(np.min(errors[1] / errors[0]))),
        floor_ratio=float(np.sqrt(np.mean(errors[1]))),
        fitted_ratio=float(np.sqrt(left[1])),
        share=share_explained(left[0], left[1]),
        errors=errors[1] * first.floor**2,
        nats=0.5 * float((scores[0] - scores[1]).sum()),
        follows_signal=True,
    )


def count_rails(first: Examination, rails: Judged) -> Examination:
    """Return the first examination with the samples at a rail counted among its errors."""
    held_out = (rails.floor_ratio / rails.rmse_ratio / first.floor_ratio) ** 2
    before = rails.fitted_ratio**2
    if rails.share < 1.0:
        before = (before - rails.share) / (1.0 - rails.share)
    judged = sorted((*first.judged, rails), key=lambda j: -j.gain)
    return replace(
        first,
        base_errors=first.base_errors * held_out,
        base_left=first.base_left * before / first.fitted_ratio**2,
        judged=tuple(judged),
    )


def place_rails(first: Examination, rails: Judged, findings: Sequence[Finding]) -> list[Finding]:
    """Return the findings with the rails among them, before weaker effects."""
    mine = Finding(first, rails)
    if findings and findings[0].judged.gain > rails.gain:
        return [findings[0], mine, *findings[1:]]
    return [mine, *findings]
