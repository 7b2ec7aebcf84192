"""From where each run came to its first temperature: what a hysteresis remembers from before.

A play begins anywhere within its slack, according to temperatures before the log. A run that
begins after cooling is not described by a play that begins centred, until the temperature has moved
by twice the half-width. Three beginnings are tried for every run: from above, from below, at rest.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from zerodrift.base.arrays import Array
from zerodrift.dataset.runs import MOST_TOLD
from zerodrift.physics.effect import Arrivals
from zerodrift.physics.projection import measure_cost, solve, weigh
from zerodrift.physics.terms import Term

if TYPE_CHECKING:
    from zerodrift.physics.campaign import Campaign


SIDES = (0, 1, -1)
"""At rest, from above, from below."""
LEAST_GAIN = 0.1
"""Share of a run's squared error that another beginning must save, beside lowering the whole."""
MOST_PASSES = 4


def find_memory(terms: Sequence[Term]) -> int | None:
    """Return the place of the term that remembers temperatures, if there is one."""
    places = [i for i, term in enumerate(terms) if term.effect.remembers_temperature]
    return places[0] if places else None


def find_arrivals(campaign: "Campaign", terms: Sequence[Term], weights: Array) -> tuple[Term, ...]:
    """Return the terms with the beginnings of the runs that fit best, values as they are.

    Args:
        campaign: the runs.
        terms: at their values; one of them may remember temperatures.
        weights: [L, K] inverse variance per octave.
    """
    place = find_memory(terms)
    if place is None:
        return tuple(terms)

    def let_come(arrivals: Arrivals) -> tuple[Term, ...]:
        changed = replace(terms[place], arrivals=arrivals)
        return (*terms[:place], changed, *terms[place + 1 :])

    groups = campaign.groups
    weighed = []
    for side in SIDES:
        from_here = let_come(tuple((group, side) for group in groups) if side else ())
        sums = campaign.sum(campaign.build(from_here), from_here)
        weighed.append(weigh(sums, weights))
    owners = campaign.run_of_piece
    # [S, R, K, C, C]: what each run adds, by its beginning.
    parts = np.stack(
        [[each[owners == r].sum(axis=0) for r in range(len(groups))] for each in weighed]
    )
    present = dict(terms[place].arrivals)
    chosen = np.array([SIDES.index(present.get(group, 0)) for group in groups])
    runs = np.arange(len(groups))
    solution = solve(sums, parts[chosen, runs].sum(axis=0))
    for _ in range(MOST_PASSES):
        before = chosen.copy()
        for run in runs:
            for side in range(len(SIDES)):
                trial = chosen.copy()
                trial[run] = side
                attempt = solve(sums, parts[trial, runs].sum(axis=0))
                if measure_cost(attempt.errors) >= measure_cost(solution.errors):
                    continue
                kept = _measure(parts[chosen[run], run], solution.residual)
                saved = 1.0 - _measure(parts[side, run], attempt.residual) / kept
                # Back to rest needs no reason but a lower cost.
                if side == 0 or float(saved.max()) > LEAST_GAIN:
                    chosen, solution = trial, attempt
        if np.array_equal(chosen, before):
            break
    found = zip(groups, chosen.tolist(), strict=True)
    return let_come(tuple((group, SIDES[side]) for group, side in found if side))


def _measure(part: Array, residual: Array) -> Array:
    """Return the squared error [K] that a solution leaves of a run."""
    squares = np.einsum("kc,kcd,kd->k", residual, part, residual)
    return np.asarray(np.maximum(squares, 1e-300))


def note_arrivals(terms: Sequence[Term], groups: Sequence[str]) -> tuple[str, ...]:
    """Return a sentence on the runs that began with a memory of other temperatures."""
    notes = []
    for term in terms:
        sides = [
            f"{text} {_list_some([group for group, side in term.arrivals if side == sign])}"
            for sign, text in ((1, "from warmer:"), (-1, "from colder:"))
            if any(side == sign for _, side in term.arrivals)
        ]
        if sides:
            notes.append(
                f"{term.name}: {len(term.arrivals)} of {len(groups)} training runs began with a "
                f"memory of temperatures before the log ({'; '.join(sides)}). A chip that begins "
                "at rest is off until the temperature has moved by the width of the hysteresis: "
                "save its state over power-off, or begin with a full cycle"
            )
    return tuple(notes)


def _list_some(names: Sequence[str]) -> str:
    more = f" and {len(names) - MOST_TOLD} more" if len(names) > MOST_TOLD else ""
    return ", ".join(names[:MOST_TOLD]) + more
