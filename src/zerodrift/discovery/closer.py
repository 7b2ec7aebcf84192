"""A closer look at one programme: finer grids, all that may be mistaken, the nearest values.

The search compares programmes on coarse grids. For the one that is taken, whatever comes near a
truth is refined: around its best node for each truth, half a step to both sides, and again.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from zerodrift.base.arrays import Array
from zerodrift.diagnosis.candidates import AT_AN_END, AT_AN_END_UNITS, OF_WHAT_IS_LEFT
from zerodrift.diagnosis.examination import LIKE_BEST, LIKE_BEST_UNITS
from zerodrift.discovery.contenders import (
    Contender,
    RivalForm,
    Scene,
    find_placeable,
    list_forms,
    list_own,
    place_nodes,
    spread_nodes,
)
from zerodrift.discovery.criterion import Judge, Told
from zerodrift.discovery.patterns import Space
from zerodrift.physics.catalogue import Catalogue
from zerodrift.physics.projection import get_coordinates

CLOSE = {1: 25, 2: 7, 3: 4}
"""Values of each shared parameter of a rival, by how many it has."""
ROUNDS = 4
"""Refinements, each of half the step before."""
IN_REACH = 3.0
"""A form is refined for a truth where it leaves less than this many times what the nearest does."""


def look_closer(scene: Scene, catalogue: Catalogue) -> Scene:
    """Return the scene with finer grids of all forms, and all else of the catalogue that may be
    mistaken."""
    open_kinds = {contender.kind for contender in scene.contenders}

    def spread(kind: str) -> tuple[RivalForm, ...]:
        forms = list_forms(catalogue, scene.base, kind, len(catalogue[kind].variants))
        return tuple(spread_nodes(form, CLOSE) for form in forms)

    others = [
        kind
        for kind, effect in catalogue.items()
        if kind not in open_kinds
        and not find_placeable(effect, scene.plan)
        and list_forms(catalogue, scene.base, kind)
    ]
    return replace(
        scene,
        contenders=tuple(replace(c, forms=spread(c.kind)) for c in scene.contenders),
        outsiders=tuple(Contender(kind, (), spread(kind)) for kind in others),
    )


def judge_closely(
    make_judge: Callable[[Scene], Judge], scene: Scene, space: Space, point: Array
) -> Told:
    """Return what a programme is expected to tell, each rival at its nearest values.

    Args:
        make_judge: the judge of a scene.
        scene: see `look_closer`.
        space: what the point stands for.
        point: the programme.
    """
    logs, repeats = space.list_patterns(point), space.repeats
    for number in range(1, ROUNDS + 1):
        told, left = make_judge(scene).judge_nodes(logs, repeats)
        scene = _refine(scene, told, left, 0.5**number)
    scene = _add_ends(scene, *make_judge(scene).judge_nodes(logs, repeats))
    return _tell(scene, *make_judge(scene).judge_nodes(logs, repeats))


def _refine(scene: Scene, told: Told, left: Sequence[Array], share: float) -> Scene:
    """Return the scene with the best nodes alone, and nodes beside those that are in reach.

    Args:
        scene: as it was judged.
        told: that.
        left: rival's form -> [N, M D] what each node leaves of each truth.
        share: of the first step between nodes, to either side.
    """
    nearest = np.minimum(told.apart.min(axis=2), told.beside).ravel()
    draws = told.gain.shape[1]

    def refine(form: RivalForm, own: int, squares: Array) -> RivalForm:
        coordinates, ends = list_own(form)
        if not coordinates:
            return form
        nodes = CLOSE.get(len(coordinates), 2)
        step = share * (ends[:, 1] - ends[:, 0]) / (nodes - 1)
        points: dict[tuple[float, ...], None] = {}
        for m, best in enumerate(squares.argmin(axis=0).tolist()):
            if m // draws == own:
                continue
            u = get_coordinates(form.models[best], coordinates)
            points[tuple(u.tolist())] = None
            if squares[best, m] > IN_REACH * nearest[m]:
                continue
            for p in range(len(coordinates)):
                for sign in (-1.0, 1.0):
                    moved = u.copy()
                    moved[p] = np.clip(u[p] + sign * step[p], *ends[p])
                    points[tuple(moved.tolist())] = None
        return place_nodes(form, coordinates, list(points)) if points else form

    return _change(scene, refine, left)


def _add_ends(scene: Scene, told: Told, left: Sequence[Array]) -> Scene:
    """Return the scene with the best node for each truth, [M D], and below these the same with each
    value at one end of all that it may be, at the other end, and so for the next value."""

    def extend(form: RivalForm, own: int, squares: Array) -> RivalForm:
        coordinates, _ = list_own(form)
        best = squares.argmin(axis=0).tolist()
        points = [get_coordinates(form.models[node], coordinates) for node in best]
        for p, coordinate in enumerate(coordinates):
            for end in coordinate.bounds:
                points += [np.where(np.arange(len(u)) == p, end, u) for u in points[: len(best)]]
        return place_nodes(form, coordinates, [u.tolist() for u in points])

    return _change(scene, extend, left)


def _change(
    scene: Scene, change: Callable[[RivalForm, int, Array], RivalForm], left: Sequence[Array]
) -> Scene:
    """Return the scene with changed forms; `change` is given a form, the number of its contender,
    or -1 of an outsider, and what its nodes leave."""
    rest = iter(left)

    def change_all(contender: Contender, own: int) -> Contender:
        forms = tuple(change(form, own, next(rest)) for form in contender.forms)
        return replace(contender, forms=forms)

    return replace(
        scene,
        contenders=tuple(change_all(c, m) for m, c in enumerate(scene.contenders)),
        outsiders=tuple(change_all(c, -1) for c in scene.outsiders),
    )


def _tell(scene: Scene, told: Told, left: Sequence[Array]) -> Told:
    """Return what is told, each rival in the form that `diagnose` would choose of it.

    An effect at a value that an end of its range does as well as is a simpler one, or another one,
    in disguise: `diagnose` takes it neither for the missing effect nor for a look-alike, if it sees
    that.

    Args:
        scene: with nodes as `_add_ends` lays them.
        told: by all nodes.
        left: rival's form -> [N, M D].
    """
    count, draws = told.gain.shape
    gain = told.gain.ravel()
    each = np.arange(gain.size)
    apart = np.full((gain.size, count), np.inf)
    disguised = np.zeros((gain.size, count))
    beside = np.full(gain.size, np.inf)
    rest = iter(left)
    for r, contender in enumerate((*scene.contenders, *scene.outsiders)):
        nearest, hidden = [], []
        for form in contender.forms:
            squares = next(rest).reshape(-1, gain.size, gain.size)[:, each, each]
            if told.runs >= form.fewest_runs:
                nearest.append(squares[0])
                hidden.append(expect_disguise(gain, squares, told.samples))
        if not nearest:
            continue
        chosen = choose_forms(gain, np.stack(nearest))
        near, hides = np.stack(nearest)[chosen, each], np.stack(hidden)[chosen, each]
        if r >= count:
            beside = np.minimum(beside, np.where(hides > 0.5, np.inf, near))
            continue
        others = each // draws != r
        apart[others, r] = near[others]
        disguised[others, r] = hides[others]
    return replace(
        told,
        apart=apart.reshape(count, draws, count),
        beside=beside.reshape(count, draws),
        disguised=disguised.reshape(count, draws, count),
    )


def choose_forms(gain: Array, nearest: Array) -> NDArray[np.int64]:
    """Return [T] the simplest form of a rival that gains about as much as its best one.

    Args:
        gain: [T] of each truth.
        nearest: [F, T] what each form leaves of it, simplest first.
    """
    gains = gain - nearest
    best = gains.max(axis=0)
    least = best - np.maximum(LIKE_BEST * np.abs(best), LIKE_BEST_UNITS)
    return np.asarray((gains >= least).argmax(axis=0), dtype=np.int64)


def expect_disguise(gain: Array, squares: Array, samples: float) -> Array:
    """Return [T] the probability that an end of a range is seen to do as well as the best values.

    What an end loses over these is a difference of two squared errors: with noise it spreads by
    twice the root of what is expected of it.

    Args:
        gain: [T] of each truth.
        squares: [1 + E, T] what the best values leave of it, and below these each end.
        samples: of all outputs, each of which leaves a unit of noise.
    """
    near, lost = squares[0], np.maximum(squares[1:] - squares[0], 1e-9)
    share = np.minimum(AT_AN_END * (gain - near), OF_WHAT_IS_LEFT * (samples + near))
    enough = np.maximum(AT_AN_END_UNITS, share)
    return np.asarray(ndtr((enough - lost) / (2.0 * np.sqrt(lost))).max(axis=0, initial=0.0))
