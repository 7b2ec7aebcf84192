"""A formula for what no effect of the catalogue explains, or that there is none."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from zerodrift.base.arrays import Array
from zerodrift.base.config import Config, EffectConfig
from zerodrift.dataset.runs import Dataset
from zerodrift.diagnosis.case import Advance, Case, open_case
from zerodrift.diagnosis.changes import ADD, Change
from zerodrift.diagnosis.examination import Examination, Judged, examine, fit_base, predict
from zerodrift.diagnosis.examination import share_explained as explain_share
from zerodrift.diagnosis.formula.expression import (
    Expression,
    make_effect,
    rename,
    write_formula,
)
from zerodrift.diagnosis.formula.grammar import centre, list_forms
from zerodrift.diagnosis.formula.screen import Screen, Search, list_sources
from zerodrift.diagnosis.formula.words import Meaning, explain
from zerodrift.diagnosis.plain_errors import measure_left_out, pool_ratio
from zerodrift.diagnosis.remainder import RemainderPattern, describe_remainder
from zerodrift.diagnosis.revision import Revision, revise
from zerodrift.diagnosis.rules import (
    EXPLAINED,
    LEFT_WITHOUT_DWELL,
    SIGNIFICANT,
    helps,
    is_at_floor,
)
from zerodrift.physics.catalogue import Catalogue
from zerodrift.physics.effect import Effect
from zerodrift.physics.terms import Term

SEARCHES = 3
"""Where one term explains too little a second is looked for, and then the first one anew."""
SHORTLIST = 12
"""Forms that are fitted in full."""
SIMPLE = 3
"""As many of them are the best of the simplest kind."""
FROM_CATALOGUE = 3
"""Effects of the catalogue that are fitted beside them."""
AS_GOOD = 1.005
"""A simpler form is as good if its error on runs left out is below this share of the best's, ..."""
AS_GOOD_UNITS = 10.0
"""... or its gain is behind by less than this in noise units."""
EQUAL = 0.1
"""Forms whose predictions differ by less than this share of the noise say the same."""


@dataclass(frozen=True)
class Rival:
    """A formula that these runs cannot distinguish from the proposed one."""

    name: str
    """The formula."""
    apart: float
    """RMS difference of their predictions, in units of the noise."""

    @property
    def is_equal(self) -> bool:
        """Whether both predict the same."""
        return self.apart < EQUAL


@dataclass(frozen=True)
class Formula:
    """A formula as it was fitted."""

    effect: Effect
    expressions: tuple[Expression, ...]
    """The terms of the sum, the strongest first."""
    values: Mapping[str, float]
    meaning: Meaning
    revision: Revision
    """What `add` would say of it, on runs left out."""
    rivals: tuple[Rival, ...]

    def write(self) -> str:
        """Return the formula with its numbers."""
        return write_formula(self.expressions, self.values)


@dataclass(frozen=True)
class _Step:
    """One search beside what has been found."""

    search: Search
    examination: Examination
    expressions: Mapping[str, Expression]
    """The forms that were fitted, by their names for the time being."""
    catalogue: Catalogue
    """With these forms in it."""


@dataclass(frozen=True)
class _Choice:
    """The simplest formula that is as good as the best, or why there is none."""

    best: Judged | None
    alike: tuple[Judged, ...]
    reason: str = ""
    suffices: str = ""


@dataclass(frozen=True)
class FormulaSearch:
    """The result of a search, and its extent."""

    formula: Formula | None
    reason: str
    """Why there is none; with a formula, what speaks for it."""
    suffices: str
    """The effect of the catalogue that does as well; empty where none does."""
    forms: int
    """Formulas tried; 0 where nothing was left to explain."""
    tried: int
    """Formulas times values of their numbers."""
    p_value: float | None
    """How often the best of all that was tried does as well when runs' signs are flipped."""
    floor_ratio_before: float
    floor_ratio_after: float
    nearest: str
    """Without a formula: the one that came nearest."""
    remainder: tuple[RemainderPattern, ...]
    rmse_left_out: Mapping[str, float]
    noise_floor: Mapping[str, float]


def propose_formula(
    config: Config, dataset: Dataset, catalogue: Catalogue, advance: Advance = lambda kind: None
) -> FormulaSearch:
    """Return a formula for what the model and the catalogue leave, from the training runs.

    Errors are those of the plain fits, as `compare` and `add` tell them.

    Args:
        config: the project.
        dataset: its runs; test logs are not looked at.
        catalogue: the known effects.
        advance: called with the name of what has been tried.

    Raises:
        InputError: as `fit_config`.
    """
    dataset = replace(dataset, test=())
    found = _search_formula(config, dataset, catalogue, advance)
    floor = np.array([found.noise_floor[name] for name in dataset.outputs])
    if found.formula is None:
        rmse, steady = measure_left_out(config.effects, dataset, catalogue)
        left = steady
    else:
        before, after = found.formula.revision.before, found.formula.revision.after
        rmse, steady, left = before.rmse, before.steady_rmse, after.steady_rmse
    return replace(
        found,
        rmse_left_out=dict(zip(dataset.outputs, rmse.tolist(), strict=True)),
        floor_ratio_before=pool_ratio(steady, floor),
        floor_ratio_after=pool_ratio(left, floor),
    )


def _search_formula(
    config: Config, dataset: Dataset, catalogue: Catalogue, advance: Advance
) -> FormulaSearch:
    """Return the same without the errors of the plain fits."""
    places = {f"formula_{n}": _hold_place(f"formula_{n}") for n in range(SEARCHES * SHORTLIST)}
    case = open_case(dataset, Catalogue({**catalogue, **places}), config.effects, advance)
    known = replace(case, catalogue=catalogue)
    dwell = case.dataset.dwell
    first = examine(
        known.campaign, dwell, catalogue, known.terms, case.floor, advance=known.advance
    )
    if is_at_floor(first, first.fitted_ratio):
        reason = "what the model leaves is at the noise floor: there is nothing to explain"
        return _end(known, first, reason)
    rivals = [j.kind for j in first.judged if j.sound and helps(j, first)][:FROM_CATALOGUE]
    step = _search_beside(case, case.catalogue, case.terms, 0, rivals)
    choice = _choose(step)
    ended = _tell(_end(case, step.examination, choice.reason, choice.suffices), step)
    if choice.best is None:
        return ended
    whole, best = step.examination, choice.best
    terms: tuple[Expression, ...] = (step.expressions[best.kind],)
    first_kind = best.kind
    if not _explains(case, whole, best):
        advance("one formula; looking for a second beside it")
        second = _search_beside(case, step.catalogue, best.found.terms, SHORTLIST, ())
        beside = _choose(second)
        if beside.best is None or not _explains(case, whole, beside.best):
            share = explain_share(whole.fitted_ratio**2, best.fitted_ratio**2)
            reason = (
                f"the best formula explains {100.0 * share:.0f} % of what is left above the floor,"
                " and no second one beside it the rest; a formula of the right form explains "
                "nearly all of it"
            )
            return replace(ended, reason=reason)
        kept = second.expressions[beside.best.kind]
        terms = (rename(terms[0], "_1"), rename(kept, "_2"))
        step, choice, best = second, beside, beside.best
        # The first was chosen while the second was still missing: it may have stood in for both.
        others = [t for t in best.found.terms if t.effect.kind != first_kind]
        third = _search_beside(case, step.catalogue, others, 2 * SHORTLIST, ())
        again = _choose(third)
        if again.best is not None and again.best.fitted_ratio < best.fitted_ratio:
            terms = (rename(kept, "_1"), rename(third.expressions[again.best.kind], "_2"))
            step, choice, best = third, again, again.best
    return _finish(case, config, catalogue, terms, (whole, step, choice, best), ended)


def _search_beside(
    case: Case, catalogue: Catalogue, terms: Sequence[Term], place: int, rivals: Sequence[str]
) -> _Step:
    """Return what a search beside a model's terms finds.

    Args:
        case: the runs.
        catalogue: the known effects and those found before.
        terms: the model.
        place: the first of the names kept for the forms of this search.
        rivals: effects of the catalogue to be fitted too.
    """
    campaign, dwell = case.campaign, case.dataset.dwell
    base, noise, _ = fit_base(campaign, dwell, terms)
    screen = Screen(campaign, base, noise)
    search = screen.search(list_forms(list_sources(campaign), screen.spans))
    case.advance(f"{search.tried} values of {len(search.forms)} formulas")
    expressions = {f"formula_{place + n}": one for n, one in enumerate(_shortlist(search))}
    effects = {kind: make_effect(kind, one.write(), (one,)) for kind, one in expressions.items()}
    grown = Catalogue({**catalogue, **effects})
    kinds = frozenset((*effects, *rivals))
    seen = examine(campaign, dwell, grown, terms, case.floor, kinds=kinds, advance=case.advance)
    return _Step(search, seen, expressions, grown)


def _hold_place(kind: str) -> Effect:
    """Return an effect that keeps a place in the order of effects, and no log can feed."""
    return Effect(kind, kind, needs=("a formula's signal",))


def _shortlist(found: Search) -> list[Expression]:
    """Return the best forms, some of the simplest among them, their ranges around their values."""
    hopeful = [one for one in found.forms if one.gain > 0.0]
    chosen = hopeful[: SHORTLIST - SIMPLE]
    simplest = sorted(
        hopeful[: 10 * SHORTLIST],
        key=lambda one: (one.form.expression.complexity > 3, -one.gain),
    )
    chosen += [one for one in simplest if one not in chosen][: SHORTLIST - len(chosen)]
    return [centre(one.form, one.values) for one in chosen]


def _choose(step: _Step) -> _Choice:
    """Return the simplest formula that is as good as the best, if it passes every rule."""
    seen, expressions, search = step.examination, step.expressions, step.search
    judged = [j for j in seen.judged if j.sound and helps(j, seen)]
    if not judged:
        return _Choice(
            None, (), "no formula predicts runs left out better by more than chance does"
        )
    alike = tuple(j for j in judged if _is_as_good(j, judged[0]))
    from_catalogue = [j.kind for j in alike if j.kind not in expressions]
    if from_catalogue:
        kind = from_catalogue[0]
        return _Choice(None, alike, f"the catalogue's {kind} does as well as any formula", kind)
    if search.p_value > max(SIGNIFICANT, 1.0 / len(search.chance)):
        return _Choice(
            None,
            alike,
            f"the best of {search.tried} formulas and values does no better than the best of as "
            f"many by chance (p = {search.p_value:.2g})",
        )
    return _Choice(min(alike, key=lambda j: (expressions[j.kind].complexity, -j.gain)), alike)


def _explains(case: Case, whole: Examination, best: Judged) -> bool:
    """Return whether a formula explains nearly all that the model and its floor leave."""
    share = explain_share(whole.fitted_ratio**2, best.fitted_ratio**2)
    enough = is_at_floor(whole, best.fitted_ratio) or share >= EXPLAINED
    if case.dataset.dwell:
        return enough
    return enough or best.rmse_ratio**2 <= LEFT_WITHOUT_DWELL


def _finish(
    case: Case,
    config: Config,
    catalogue: Catalogue,
    terms: tuple[Expression, ...],
    found: tuple[Examination, _Step, _Choice, Judged],
    ended: FormulaSearch,
) -> FormulaSearch:
    """Return the formula as `add` would fit it, if `add` would keep it."""
    whole, step, choice, best = found
    effect, meaning = _name(catalogue, terms)
    wanted = EffectConfig(effect.kind)
    change = Change(ADD, wanted, (*config.effects, wanted), len(config.effects))
    extended = Catalogue({**catalogue, effect.kind: effect})
    revision = revise(config, case.dataset, extended, change)
    if not revision.helps:
        return replace(ended, reason=f"`add` would not keep the best formula: {revision.reason}")
    assert revision.term is not None
    rivals = tuple(
        Rival(
            write_formula((*terms[:-1], step.expressions[other.kind]), None)
            if len(terms) > 1
            else write_formula((step.expressions[other.kind],), other.parameters),
            _measure_apart(case, whole, best, other),
        )
        for other in choice.alike
        if other.kind != best.kind
    )
    values = revision.term.term.values
    return replace(
        ended,
        formula=Formula(effect, terms, values, meaning, revision, rivals),
        reason=revision.reason,
        nearest="",
    )


def _tell(ended: FormulaSearch, step: _Step) -> FormulaSearch:
    """Return the end with what the search was."""
    kinds = (j.kind for j in step.examination.judged if j.kind in step.expressions)
    nearest = next(kinds, None)
    return replace(
        ended,
        forms=len(step.search.forms),
        tried=step.search.tried,
        p_value=step.search.p_value,
        nearest=step.expressions[nearest].write() if nearest is not None else "",
    )


def _is_as_good(judged: Judged, best: Judged) -> bool:
    """Return whether an effect leaves no more in runs left out than the best one, nearly."""
    behind = best.gain - judged.gain
    return behind <= AS_GOOD_UNITS or judged.floor_ratio <= AS_GOOD * best.floor_ratio


def _name(catalogue: Catalogue, terms: tuple[Expression, ...]) -> tuple[Effect, Meaning]:
    """Return the effect under a name of its own, and what its strongest term means."""
    meaning = explain(terms[0])
    stem = "_".join(dict.fromkeys(d.text.replace(" ", "_") for d in terms[0].sources))
    name = f"{stem}_{meaning.name}{'_and_more' if len(terms) > 1 else ''}".lower()
    kind = name = "".join(c if c.isalnum() or c == "_" else "_" for c in name)
    number = 2
    while kind in catalogue:
        kind, number = f"{name}_{number}", number + 1
    title = meaning.title
    if len(terms) > 1:
        others = [explain(one) for one in terms[1:]]
        title = " and ".join((title, *(one.title for one in others)))
        meaning = replace(
            meaning,
            title=title,
            physics=" Beside it: ".join((meaning.physics, *(one.physics for one in others))),
            experiment="; ".join((meaning.experiment, *(one.experiment for one in others))),
        )
    return make_effect(kind, title, terms), meaning


def _measure_apart(case: Case, second: Examination, one: Judged, other: Judged) -> float:
    """Return the RMS difference of two models' predictions in the runs, in units of the noise."""
    squares: list[Array] = []
    for run in case.dataset.train:
        order = case.campaign.order
        apart = predict(one.found, run, case.plan, order) - predict(
            other.found, run, case.plan, order
        )
        squares.append((apart - apart.mean(axis=0)) ** 2 / second.floor**2)
    return float(np.sqrt(np.concatenate(squares).mean()))


def _end(case: Case, seen: Examination, reason: str, suffices: str = "") -> FormulaSearch:
    """Return that there is no formula, and what is left."""
    rests: Sequence[Array] = [
        run.steady_drift - predict(seen.base, run, case.plan, case.campaign.order)
        for run in case.dataset.train
    ]
    outputs = case.dataset.outputs
    return FormulaSearch(
        formula=None,
        reason=reason,
        suffices=suffices,
        forms=0,
        tried=0,
        p_value=None,
        floor_ratio_before=0.0,
        floor_ratio_after=0.0,
        nearest="",
        remainder=tuple(describe_remainder(case.dataset.train, rests, case.plan, seen.floor)),
        rmse_left_out={},
        noise_floor=dict(zip(outputs, seen.floor.tolist(), strict=True)),
    )
