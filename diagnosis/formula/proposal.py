"""A formula for what no effect of the catalogue explains, or that there is none."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from zerodrift.base.config import Config, EffectConfig
from zerodrift.dataset.runs import Dataset
from zerodrift.diagnosis.case import Advance, Case, open_case
from zerodrift.diagnosis.changes import ADD, Change
from zerodrift.diagnosis.examination import Examination, Judged, examine, fit_base, predict
from zerodrift.diagnosis.examination import share_explained as explain_share
from zerodrift.diagnosis.formula.expression import Expression, make_effect
from zerodrift.diagnosis.formula.grammar import centre, list_forms
from zerodrift.diagnosis.formula.screen import Screen, Search, list_sources
from zerodrift.diagnosis.formula.words import Meaning, explain
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

Array = NDArray[np.float64]

SHORTLIST = 12
"""Forms that are fitted in full."""
SIMPLE = 3
"""As many of them are the best of the simplest kind."""
FROM_CATALOGUE = 3
"""Effects of the catalogue that are fitted beside them."""
AS_GOOD = 1.01
"""A simpler form is as good if its error on runs left out is below this share of the best's, ..."""
AS_GOOD_UNITS = 10.0
"""... or its gain is behind by less than this in noise units."""
EQUAL = 0.1
"""Forms whose predictions differ by less than this share of the noise say the same."""


@dataclass(frozen=True)
class Rival:
    """A formula or an effect of the catalogue that these runs cannot tell from the one proposed."""

    name: str
    """The formula, or the effect's name."""
    is_effect: bool
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
    expression: Expression
    values: Mapping[str, float]
    meaning: Meaning
    revision: Revision
    """What `add` would say of it, on runs left out."""
    rivals: tuple[Rival, ...]


@dataclass(frozen=True)
class FormulaSearch:
    """What was found, and what the search was."""

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

    Args:
        config: the project.
        dataset: its runs; test logs are not looked at.
        catalogue: the known effects.
        advance: is told what has been tried.

    Raises:
        InputError: as `fit_config`.
    """
    dataset = replace(dataset, test=())
    places = {f"formula_{n}": _hold_place(f"formula_{n}") for n in range(1, SHORTLIST + 1)}
    case = open_case(dataset, Catalogue({**catalogue, **places}), config.effects, advance)
    known = replace(case, catalogue=catalogue)
    first = examine(known.campaign, dataset.dwell, catalogue, known.terms, advance=known.advance)
    if is_at_floor(first, first.fitted_ratio):
        reason = "what the model leaves is at the noise floor: there is nothing to explain"
        return _end(known, first, reason)
    base, noise, _ = fit_base(case.campaign, dataset.dwell, case.terms)
    screen = Screen(case.campaign, base, noise)
    forms = list_forms(list_sources(case.campaign), screen.spans)
    advance(f"{len(forms)} formulas")
    found = screen.search(forms)
    expressions = _shortlist(found)
    effects = {
        kind: make_effect(kind, expression.write(), expression)
        for kind, expression in zip(places, expressions, strict=False)
    }
    by_kind = dict(zip(effects, expressions, strict=True))
    rivals = [j.kind for j in first.judged if j.sound and helps(j, first)][:FROM_CATALOGUE]
    grown = Catalogue({**catalogue, **places, **effects})
    second = examine(
        case.campaign,
        dataset.dwell,
        grown,
        case.terms,
        kinds=frozenset((*effects, *rivals)),
        advance=advance,
    )
    return _conclude(replace(case, catalogue=grown), config, second, by_kind, found)


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


def _conclude(
    case: Case,
    config: Config,
    second: Examination,
    expressions: Mapping[str, Expression],
    found: Search,
) -> FormulaSearch:
    """Return the simplest formula that is as good as the best, if it passes every rule."""
    judged = [j for j in second.judged if j.sound and helps(j, second)]
    nearest = next((expressions[j.kind] for j in second.judged if j.kind in expressions), None)
    name = nearest.write() if nearest is not None else ""

    def refuse(reason: str, suffices: str = "") -> FormulaSearch:
        ended = _end(case, second, reason, suffices)
        return replace(
            ended,
            forms=len(found.forms),
            tried=found.tried,
            p_value=found.p_value,
            nearest=name,
        )

    if not judged:
        return refuse("no formula predicts runs left out better by more than chance does")
    alike = [j for j in judged if _is_as_good(j, judged[0])]
    from_catalogue = [j for j in alike if j.kind not in expressions]
    if from_catalogue:
        kind = from_catalogue[0].kind
        return refuse(f"the catalogue's {kind} does as well as any formula", kind)
    best = min(alike, key=lambda j: (expressions[j.kind].complexity, -j.gain))
    reachable = 1.0 / len(found.chance)
    if found.p_value > max(SIGNIFICANT, reachable):
        return refuse(
            f"the best of {found.tried} formulas tried does no better than the best of as many "
            f"by chance (p = {found.p_value:.2g})"
        )
    share = explain_share(second.fitted_ratio**2, best.fitted_ratio**2)
    enough = is_at_floor(second, best.fitted_ratio) or share >= EXPLAINED
    if not case.dataset.dwell:
        enough = enough or best.rmse_ratio**2 <= LEFT_WITHOUT_DWELL
    if not enough:
        return refuse(
            f"the best formula explains {100.0 * share:.0f} % of what is left above the floor; "
            "a formula of the right form explains nearly all of it"
        )
    effect, expression, meaning = _name(case, expressions[best.kind])
    catalogue = Catalogue(
        {**{k: e for k, e in case.catalogue.items() if k not in expressions}, effect.kind: effect}
    )
    wanted = EffectConfig(effect.kind)
    effects = (*config.effects, wanted)
    change = Change(ADD, wanted, effects, len(config.effects))
    revision = revise(config, case.dataset, catalogue, change)
    if not revision.helps:
        return refuse(f"`add` would not keep the best formula: {revision.reason}")
    assert revision.term is not None
    rivals = [
        Rival(
            _write(j, expressions), j.kind not in expressions, _measure_apart(case, second, best, j)
        )
        for j in alike
        if j.kind != best.kind
    ]
    formula = Formula(
        effect, expression, revision.term.term.values, meaning, revision, tuple(rivals)
    )
    ended = refuse(revision.reason)
    return replace(ended, formula=formula, floor_ratio_after=best.floor_ratio, nearest="")


def _is_as_good(judged: Judged, best: Judged) -> bool:
    """Return whether an effect leaves no more in runs left out than the best one, nearly."""
    behind = best.gain - judged.gain
    return behind <= AS_GOOD_UNITS or judged.floor_ratio <= AS_GOOD * best.floor_ratio


def _name(case: Case, expression: Expression) -> tuple[Effect, Expression, Meaning]:
    """Return the effect under a name of its own."""
    meaning = explain(expression)
    stem = "_".join(dict.fromkeys(s.text.replace(" ", "_") for s in expression.sources))
    kind = wanted = f"{stem}_{meaning.name}".lower()
    kind = wanted = "".join(c if c.isalnum() or c == "_" else "_" for c in wanted)
    number = 2
    while kind in case.catalogue:
        kind, number = f"{wanted}_{number}", number + 1
    return make_effect(kind, meaning.title, expression), expression, meaning


def _write(judged: Judged, expressions: Mapping[str, Expression]) -> str:
    if judged.kind not in expressions:
        return judged.kind
    return f"k * {expressions[judged.kind].write(judged.parameters)}"


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
        floor_ratio_before=seen.floor_ratio,
        floor_ratio_after=seen.floor_ratio,
        nearest="",
        remainder=tuple(describe_remainder(case.dataset.train, rests, case.plan, seen.floor)),
        rmse_left_out=dict(zip(outputs, np.sqrt(seen.base_errors).tolist(), strict=True)),
        noise_floor=dict(zip(outputs, seen.floor.tolist(), strict=True)),
    )
