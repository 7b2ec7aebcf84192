"""How much of an effect these logs excite: the share that the model as it is cannot imitate."""

from collections.abc import Sequence

import numpy as np

from zerodrift.base.arrays import Array
from zerodrift.physics.campaign import Campaign
from zerodrift.physics.projection import invert_scaled, list_coordinates, set_coordinates
from zerodrift.physics.reduction import combine
from zerodrift.physics.search import Found, grid, list_slopes
from zerodrift.physics.terms import Term, name_feature

LEAST_EXCITATION = 0.05
"""Share of an effect that the model cannot imitate, below which it cannot be tested."""


def measure_excitation(
    campaign: Campaign, base: Found, terms: Sequence[Term], place: int, weights: Array
) -> float:
    """Return the share of what the term at a place changes that the present model cannot imitate.

    What it changes is its new columns, or for effects that rewrite the temperature the change of
    the prediction; what the model imitates is the span of its columns and of their slopes. Where
    the typical value shows nothing, the others of the typical range are tried.
    """
    with campaign.rates.search_roughly():
        return _excite_most(campaign, base, terms, place, weights)


def _excite_most(
    campaign: Campaign, base: Found, terms: Sequence[Term], place: int, weights: Array
) -> float:
    """Return the excitation at the typical value, or the best over the typical range."""
    share = _excite(campaign, base, terms, weights)
    own = [c for c in list_coordinates(terms) if c.term == place]
    for u in grid(own) if own else []:
        if share >= LEAST_EXCITATION:
            break
        elsewhere = set_coordinates(terms, own, np.array(u))
        share = max(share, _excite(campaign, base, elsewhere, weights))
    return share


def _excite(campaign: Campaign, base: Found, terms: Sequence[Term], weights: Array) -> float:
    """Return the share left of what these terms change, at their present values."""
    coordinates = list_coordinates(base.terms)
    features, slopes = list_slopes(campaign, base.terms, coordinates)
    changed = campaign.build(terms)
    known = {f.name: j for j, f in enumerate(features)}
    new = [f for f in changed if f.name not in known]
    outputs: list[str | None] = []
    if new:
        extra = [campaign.column(f.signal, name_feature(f, terms)) for f in new]
        outputs = [f.output for f in new]
    else:
        steps = [
            (known[f.name], campaign.column(f.signal) - campaign.column(now.signal))
            for f in changed
            if f.signal is not (now := features[known[f.name]]).signal
        ]
        extra = [
            combine([step for _, step in steps], [row[j] for j, _ in steps])
            for row in base.solution.coefficients
            if steps
        ]
        outputs += campaign.plan.outputs[: len(extra)]
    width = len(coordinates)
    marked = [*slopes, *((width + i, -1, column) for i, column in enumerate(extra))]
    sums = campaign.sum(features, base.terms, marked)
    gram = np.einsum("l,glab->ab", weights.mean(axis=1) / weights.mean(), sums.products)
    first = len(features) + len(slopes)
    offsets = range(first + len(extra), gram.shape[0] - sums.outputs)
    seen_by = [f.output for f in features] + [features[j].output for _, j, _ in slopes]
    shares = [0.0]
    for output in campaign.plan.outputs:
        # A column that another output alone sees imitates nothing in this one.
        model = [*(i for i, owner in enumerate(seen_by) if owner in (None, output)), *offsets]
        inverse = invert_scaled(gram[np.ix_(model, model)])
        for e, owner in enumerate(outputs, start=first):
            if owner in (None, output) and gram[e, e] > 0.0:
                left = gram[e, e] - gram[e, model] @ inverse @ gram[model, e]
                shares.append(float(np.sqrt(max(left, 0.0) / gram[e, e])))
    return max(shares)
