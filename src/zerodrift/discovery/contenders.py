"""The effects that are still possible: as truths with drawn values, and as rivals to refit.

A truth is a whole model with one effect more, at values drawn from what is known of them: the
fit's values and errors where there are logs, the catalogue's typical ranges where there are none.
A rival is the same model at a grid of its shared values, its coefficients left to be refitted.
"""

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from zerodrift.base.arrays import Array
from zerodrift.base.config import EffectConfig
from zerodrift.base.errors import InputError, nearest
from zerodrift.diagnosis.candidates import NEAR
from zerodrift.diagnosis.case import Case
from zerodrift.diagnosis.examination import fit_base, measure_rest
from zerodrift.diagnosis.noise import Noise
from zerodrift.physics.catalogue import Catalogue
from zerodrift.physics.effect import FEWEST_RUNS, Effect, Values
from zerodrift.physics.fit import estimate_errors
from zerodrift.physics.search import (
    Coordinate,
    Found,
    assess,
    get_coordinates,
    list_coordinates,
    search,
    set_coordinates,
    solve,
    sum_with_slopes,
    weigh,
)
from zerodrift.physics.signals import SignalPlan, explain_missing
from zerodrift.physics.terms import Term, start_term

NODES = {1: 7, 2: 4, 3: 3}
"""Values of each shared parameter of a rival, by how many it has."""
MOST_FORMS = 2
"""An effect's plain forms that the search looks at; for the programme that is taken, all."""
DRAWS = 6
SLOWER_THAN_PLANS = ("ageing",)
"""Effects of days, which no programme of hours shows."""
MOST_SPREAD = 0.7
"""Largest standard deviation of a drawn value, in its own coordinate."""


@dataclass(frozen=True)
class Truth:
    """A model that may be the true one."""

    terms: tuple[Term, ...]
    coefficients: Array
    """[K, J] of its features, the constant left out; unscaled where nothing is known of them."""
    known: bool
    """Whether the coefficients are fitted; else they are scaled to a size."""


@dataclass(frozen=True)
class RivalForm:
    """One form of a rival, refitted to every truth."""

    models: tuple[tuple[Term, ...], ...]
    """On a grid of its values; all have the same features."""
    place: int
    """Of the effect's term."""
    fewest_runs: int
    """Training runs from which on `diagnose` tries it."""


@dataclass(frozen=True)
class Contender:
    """One effect that the model may lack."""

    kind: str
    truths: tuple[Truth, ...]
    forms: tuple[RivalForm, ...]

    @property
    def effect(self) -> Effect:
        """The effect itself."""
        form = self.forms[0]
        return form.models[0][form.place].effect


@dataclass(frozen=True)
class Scene:
    """The knowledge before the experiment."""

    plan: SignalPlan
    order: tuple[str, ...]
    base: tuple[Term, ...]
    noise: Noise
    contenders: tuple[Contender, ...]
    runs: int
    """Training runs that there are."""
    outsiders: tuple[Contender, ...] = ()
    """Effects that are not open but that `diagnose` will try too, without truths."""


def describe_noise(full_scale: Sequence[float], share: float, period_s: float) -> Noise:
    """Return noise of which nothing is known: half of it white, half about 1/f.

    Args:
        full_scale: [K].
        share: RMS over full scale.
        period_s: seconds per sample.
    """
    taus = np.array([0.0, *(t / period_s for t in (10.0, 100.0, 1000.0))])
    shares = np.array([0.5, *(np.full(3, 0.5 / 3.0))])
    variance = (share * np.array(full_scale)) ** 2
    return Noise(shares[:, None] * variance[None, :], taus, "assumed")


def find_placeable(effect: Effect, plan: SignalPlan) -> str:
    """Return why an experiment cannot show an effect, or an empty string."""
    if effect.sets_aside:
        return "samples at a converter's rail are seen directly, no programme is needed"
    return explain_missing(effect, plan)


def list_forms(
    catalogue: Catalogue, base: Sequence[Term], kind: str, most: int = MOST_FORMS
) -> list[RivalForm]:
    """Return the whole models that have an effect in its plain forms, simplest first.

    Args:
        catalogue: the known effects.
        base: the model.
        kind: the effect; the model may have it in a simpler form.
        most: forms, besides those that ask for more runs.
    """
    effect = catalogue[kind]
    place = next((i for i, term in enumerate(base) if term.effect.kind == kind), len(base))

    def build(choices: Values, fewest_runs: int) -> list[RivalForm]:
        if place < len(base):
            own = base[place]
            richer = any(own.values.get(name) != value for name, value in choices.items())
            if not richer or any(own.values[n] > v for n, v in choices.items()):
                return []
        term = start_term(catalogue, EffectConfig(kind), choices)
        return [RivalForm(((*base[:place], term, *base[place + 1 :]),), place, fewest_runs)]

    plain = [form for choices in effect.variants for form in build(choices, 0)]
    more = [form for choices in effect.run_variants for form in build(choices, FEWEST_RUNS)]
    return [*plain[:most], *more]


def refuse_unknown(
    kinds: Sequence[str], catalogue: Catalogue, base: Sequence[Term], plan: SignalPlan
) -> None:
    """Refuse effects that no experiment of these signals can tell.

    Raises:
        InputError: an unknown effect, one named twice, one that the model has, one whose signal is
            lacking, or one that no programme of hours shows.
    """
    for kind in kinds:
        if kinds.count(kind) > 1:
            raise InputError(
                f"--between {kind} {kind}: the same effect twice; expected two different ones to "
                "tell apart. `zerodrift effects` lists them."
            )
        if kind not in catalogue:
            raise InputError(
                f"--between {kind}: no effect '{kind}'{nearest(kind, catalogue) or '.'} "
                "`zerodrift effects` lists them."
            )
        if not list_forms(catalogue, base, kind):
            raise InputError(
                f"--between {kind}: the model has {kind} already; expected an effect that it may "
                "lack. Leave it out, or remove it from zerodrift.toml."
            )
        why = find_placeable(catalogue[kind], plan)
        if why:
            raise InputError(
                f"--between {kind}: no experiment can show it: {why}. Add the column to [inputs] "
                "or the reference to [outputs], and what it can be set to under [experiment]."
            )
        if kind in SLOWER_THAN_PLANS:
            raise InputError(
                f"--between {kind}: {kind} shows over days, and a programme lasts hours; expected "
                "an effect that hours can show. Leave it out, and put logs of several days under "
                "[logs] train: `zerodrift diagnose` looks for it there."
            )


def list_own(form: RivalForm) -> tuple[list[Coordinate], Array]:
    """Return a form's own shared values, and their ends [P, 2] as `diagnose` holds plausible."""
    coordinates = [
        c
        for c in list_coordinates(form.models[0])
        if c.term == form.place and not c.parameter.is_setting
    ]
    ends = []
    for c in coordinates:
        low, high = (c.encode(value) for value in c.parameter.typical)
        wide = np.log(NEAR) if c.parameter.scale == "log" else (NEAR - 1.0) * (high - low)
        ends.append((max(low - wide, c.bounds[0]), min(high + wide, c.bounds[1])))
    return coordinates, np.array(ends).reshape(-1, 2)


def spread_nodes(form: RivalForm, nodes: Mapping[int, int] = NODES) -> RivalForm:
    """Return a form on a grid over all values that are plausible."""
    coordinates, ends = list_own(form)
    if not coordinates:
        return form
    count = nodes.get(len(coordinates), 2)
    axes = [np.linspace(low, high, count).tolist() for low, high in ends.tolist()]
    return place_nodes(form, coordinates, list(itertools.product(*axes)))


def place_nodes(
    form: RivalForm, coordinates: Sequence[Coordinate], points: Sequence[Sequence[float]]
) -> RivalForm:
    """Return a form at these values [P] of its coordinates."""
    models = (set_coordinates(form.models[0], coordinates, np.array(u)) for u in points)
    return replace(form, models=tuple(tuple(terms) for terms in models))


def imagine(
    plan: SignalPlan,
    catalogue: Catalogue,
    base: Sequence[Term],
    kinds: Sequence[str],
    noise: Noise,
    seed: int,
) -> Scene:
    """Return the scene before any log: typical values, and effects of a size that is asked for."""
    contenders = []
    for kind in kinds:
        forms = list_forms(catalogue, base, kind)
        rng = np.random.default_rng([seed, *kind.encode()])
        truths = [draw_typical(forms[0], plan, rng) for _ in range(DRAWS)]
        nodes = tuple(spread_nodes(form) for form in forms)
        contenders.append(Contender(kind, tuple(truths), nodes))
    return Scene(plan, tuple(catalogue), tuple(base), noise, tuple(contenders), 0)


def draw_typical(form: RivalForm, plan: SignalPlan, rng: np.random.Generator) -> Truth:
    """Return a truth with values drawn from their typical ranges, coefficients of any sign."""
    terms = form.models[0]
    coordinates, _ = list_own(form)
    if coordinates:
        bounds = [[c.encode(v) for v in c.parameter.typical] for c in coordinates]
        u = np.array([rng.uniform(low, high) for low, high in bounds])
        terms = tuple(set_coordinates(terms, coordinates, u))
    signs = rng.choice([-1.0, 1.0], size=(len(plan.outputs), 64)) * rng.uniform(
        0.5, 1.5, (len(plan.outputs), 64)
    )
    return Truth(terms, signs, False)


def spread_typical(terms: Sequence[Term], count: int, seed: int) -> list[tuple[Term, ...]]:
    """Return a model as it stands, and with its values drawn from their typical ranges.

    Args:
        terms: the model.
        count: models in all.
        seed: of the draws.
    """
    coordinates = [c for c in list_coordinates(terms) if not c.parameter.is_setting]
    found = [tuple(terms)]
    if not coordinates:
        return found
    rng = np.random.default_rng(seed)
    ends = np.array([[c.encode(v) for v in c.parameter.typical] for c in coordinates])
    for _ in range(count - 1):
        u = rng.uniform(ends[:, 0], ends[:, 1])
        found.append(tuple(set_coordinates(terms, coordinates, u)))
    return found


def look_back(
    case: Case, kinds: Sequence[str], untold: Mapping[str, str], seed: int
) -> tuple[Scene, Array]:
    """Return the scene after logs, and the noise floor [K].

    Args:
        case: the model and its runs.
        kinds: the effects that are open.
        untold: those of them that these logs say nothing of, drawn from typical values.
        seed: of the draws.
    """
    base, noise, weights = fit_base(case.campaign, case.dataset.dwell, case.terms)
    contenders = []
    best: Found | None = None
    for kind in kinds:
        forms = list_forms(case.catalogue, base.terms, kind)
        rng = np.random.default_rng([seed, *kind.encode()])
        nodes = tuple(spread_nodes(form) for form in forms)
        if kind in untold:
            truths = [draw_typical(forms[0], case.plan, rng) for _ in range(DRAWS)]
        else:
            runs = len(case.campaign.groups)
            found = [
                search(case.campaign, form.models[0], weights, vary=(form.place,))
                for form in forms
                if runs >= form.fewest_runs
            ]
            # The simplest form that explains as much: a richer one is for the logs to show.
            least = min(one.cost for one in found)
            chosen = next(one for one in found if one.cost <= least + 0.02 * abs(least) + 1e-3)
            if best is None or chosen.cost < best.cost:
                best = chosen
            truths = draw_fitted(case, chosen, weights, rng)
        contenders.append(Contender(kind, tuple(truths), nodes))
    noise = measure_rest(case.campaign, case.dataset.dwell, best or base)
    order = tuple(case.campaign.order)
    scene = Scene(
        case.plan,
        order,
        tuple(base.terms),
        noise,
        tuple(contenders),
        len(case.campaign.groups),
    )
    return scene, case.floor


def draw_fitted(case: Case, found: Found, weights: Array, rng: np.random.Generator) -> list[Truth]:
    """Return truths drawn around a fit; the coefficients are solved anew at each."""
    coordinates = list_coordinates(found.terms)
    truths = [Truth(found.terms, found.solution.coefficients, True)]
    if not coordinates:
        return truths
    u = get_coordinates(found.terms, coordinates)
    sums = sum_with_slopes(case.campaign, found.terms, coordinates)
    solution = solve(sums, weigh(sums, weights).sum(axis=0))
    errors, _ = estimate_errors(case.campaign, sums, weights, solution, len(coordinates))
    spread = np.minimum(errors, MOST_SPREAD)
    bounds = np.array([c.bounds for c in coordinates])
    for _ in range(DRAWS - 1):
        moved = np.clip(u + spread * rng.standard_normal(u.size), bounds[:, 0], bounds[:, 1])
        there = assess(case.campaign, set_coordinates(found.terms, coordinates, moved), weights)
        truths.append(Truth(there.terms, there.solution.coefficients, True))
    return truths
