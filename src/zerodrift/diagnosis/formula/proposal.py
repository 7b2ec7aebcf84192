"""A formula for what no effect of the catalogue explains, or that there is none."""

import json
import textwrap
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
    is_by_load,
    make_effect,
    name_term,
    rename,
    write_formula,
)
from zerodrift.diagnosis.formula.grammar import centre, list_forms
from zerodrift.diagnosis.formula.screen import Screen, Search, list_sources
from zerodrift.diagnosis.judgement import Fitted
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
from zerodrift.physics.effect import Effect, Parameter
from zerodrift.physics.terms import Term

# What kind of physics has a formula's form, in words, and the experiment that would show it.


@dataclass(frozen=True)
class Meaning:
    """A form's name, what has it, and how to see it."""

    name: str
    """The last part of the effect's name: transient, hysteresis, ..."""
    title: str
    physics: str
    experiment: str


def explain(expression: Expression) -> Meaning:
    """Return what a form means; the outermost operation that says something decides."""
    names = " and ".join(source.text for source in expression.sources)
    driver = expression.sources[0].text
    shape = [one.op for one in expression.walk()]
    outer = expression
    while outer.op in ("shift",):
        outer = outer.inputs[0]
    hold = f"step {driver}, hold everything else, and wait"
    if outer.op == "product":
        return Meaning(
            "interaction",
            f"interaction of {names}",
            f"One of {names} sets how much the other does: a gain, a sensitivity or a coupling "
            "that is itself moved.",
            f"sweep {expression.sources[-1].text} at two levels of {driver}, far apart: the slopes "
            "must differ, and by the factor that the formula says",
        )
    if outer.op == "difference" and "lowpass" in shape and len(expression.sources) == 1:
        return Meaning(
            "transient",
            f"what {driver} does until it has soaked through",
            f"Two parts answer {driver} at different speeds and cancel once both have: a surface "
            "and a core, a seal and what it seals.",
            f"{hold} five of its time constants: the drift must come at once and go by itself",
        )
    if outer.op == "difference" and len(expression.sources) == 2:
        return Meaning(
            "difference",
            f"difference of {names}",
            f"A gradient between two places, or two supplies that ought to cancel: {names}.",
            f"move {driver} alone, then both together: together there must be no drift",
        )
    if "play" in shape:
        return Meaning(
            "hysteresis",
            f"slack in {driver}",
            f"Friction, slip in a joint, or domains that turn late: {driver} has to come back by "
            "twice a width before anything follows.",
            f"take {driver} up and down over half of its range twice: a loop must open whose width "
            "does not depend on the speed",
        )
    if "delay" in shape:
        return Meaning(
            "delay",
            f"{driver} as it was a while ago",
            "Transport (a flow, a buffer, an averaging converter) brings it late and unchanged.",
            f"step {driver}: the drift must step too, once, after the delay",
        )
    if any(one in shape for one in ("above", "below")):
        return Meaning(
            "threshold",
            f"{driver} beyond a threshold",
            "A contact that closes, a part that goes slack or touches, condensation, a regulator "
            "out of its range: nothing on one side of a threshold, a slope on the other.",
            f"raise {driver} slowly through the threshold and back: the slope must change there",
        )
    if any(one in shape for one in ("larger", "smaller")):
        return Meaning(
            "rival",
            f"the larger or smaller of {names}",
            "Whichever of two bodies, supplies or paths leads at the time decides.",
            f"hold one of {names} and move the other across it",
        )
    if "exp2" in shape:
        return Meaning(
            "exponential",
            f"exponential in {driver}",
            f"A rate or a current that doubles with every so much {driver}: leakage, diffusion, "
            "vapour.",
            f"take {driver} to the top of its range in equal steps: each must add more than the "
            "last, by the same factor",
        )
    if "power" in shape or "size" in shape:
        late = ", late" if "lowpass" in shape else ""
        return Meaning(
            "power",
            f"bent in {driver}{late}",
            f"Power that {driver} turns into heat, a stress that does not care for its sign, or "
            f"the bend of a characteristic{', after a thermal or viscous lag' if late else ''}.",
            f"take {driver} to both ends of its range: the drift must be bent as the formula says",
        )
    if "lowpass" in shape:
        return Meaning(
            "lag",
            f"{driver}, late",
            f"Heat, moisture or stress takes its time from {driver} to the element.",
            f"{hold} five time constants: the drift must approach its end as an exponential",
        )
    return Meaning(
        "influence",
        f"in proportion to {names}",
        f"A leak, a coupling or a gain that follows {names} at once.",
        f"step {driver} up and down: the drift must follow at once",
    )


# A formula for what no effect of the catalogue explains, or that there is none.

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


# What the model leaves against what the formula says of it, on runs left out.

MOST_POINTS = 400
"""Of an output, over all runs."""
DIGITS = 5


@dataclass(frozen=True)
class FormulaCurve:
    """Points of one output, each the mean of a stretch of a run, in the output's unit.

    Both from models that the run is left out of; where logs are tared, without the run's own mean.
    """

    formula: tuple[float, ...]
    """What the formula adds to the model."""
    remainder: tuple[float, ...]
    """What the model without it leaves: equal, where the formula is all that is missing."""


def trace_formula(formula: Formula, dataset: Dataset) -> Mapping[str, FormulaCurve]:
    """Return output -> points of the remainder against the formula.

    Args:
        formula: as fitted.
        dataset: the runs it was fitted to.
    """
    revision = formula.revision
    left, said = _join(revision.before), _join(revision.after)
    total = sum(len(error) for error in left.values())
    block = max(1, -(-total // MOST_POINTS))
    points: list[list[Array]] = [[], []]
    for group, error in left.items():
        added = error - said[group]
        for found, rows in zip(points, (added, error), strict=True):
            whole = len(rows) // block
            if not whole:
                continue
            means = rows[: whole * block].reshape(whole, block, -1).mean(axis=1)
            found.append(means - rows.mean(axis=0) if revision.tared else means)
    x, y = (np.concatenate(found) for found in points)
    return {
        name: FormulaCurve(_round(x[:, k]), _round(y[:, k]))
        for k, name in enumerate(dataset.outputs)
    }


def _join(fitted: Fitted) -> dict[str, Array]:
    """Return what a model leaves of each run [n, K], outliers by their weights."""
    return {group: error.steady for group, error in fitted.errors.items()}


def _round(values: Array) -> tuple[float, ...]:
    return tuple(float(f"{x:.{DIGITS}g}") for x in values)


# A formula as a user's file of effects, which `add` takes.

WIDTH = 92


MARK = ": a formula that the logs propose."
"""End of the first line of each file that is written here."""


def is_proposed(text: str) -> bool:
    """Return whether a file's text came from `render_file`, as far as its first line tells."""
    return text.partition("\n")[0].endswith(MARK)


def render_file(formula: Formula) -> str:
    """Return the text of the file: the effect, named and commented."""
    effect, meaning = formula.effect, formula.meaning
    body, by_load = ["features = []"], ["for own, load in signals.load.items():"]
    for number, one in enumerate(formula.expressions, 1):
        name = name_term(number, len(formula.expressions))
        result = "x" if len(formula.expressions) == 1 else "xyz"[number - 1]
        code, unit = one.list_code(result), _quote(one.unit)
        if is_by_load(one):
            by_load += [f"    {line}" for line in code]
            by_load.append(
                f'    features.append(Feature(f"{name} {{own}}", {result}, {unit}, own))'
            )
        else:
            body += [*code, f"features.append(Feature({_quote(name)}, {result}, {unit}))"]
    body += [*(by_load if len(by_load) > 1 else []), "return features"]
    told = (
        f"Found by `zerodrift propose` in these logs, not taken from a book: {meaning.physics} "
        f"What would show it: {meaning.experiment}."
    )
    lines = [
        f'"""{effect.title[:1].upper()}{effect.title[1:]}{MARK}',
        "",
        *textwrap.wrap(told, WIDTH),
        "",
        f"    drift = {formula.write()}",
        "",
        "Each output has coefficients of its own; `zerodrift add` fits the numbers again.",
        '"""',
        "",
        "from zerodrift.physics.catalogue import register",
        "from zerodrift.physics.effect import Effect, Feature, Parameter",
        "",
        "",
        "def build(ops, signals, p):",
        f'    """Return the terms of {write_formula(formula.expressions)}."""',
        *(f"    {line}" for line in body),
        "",
        "",
        "register(",
        "    Effect(",
        f"        kind={_quote(effect.kind)},",
        f"        title={_quote(effect.title)},",
        "        build=build,",
        "        parameters=(",
        *(line for p in effect.parameters for line in _write_parameter(p, formula)),
        "        ),",
        f"        needs={_write_names(effect.needs)},",
        f"        equation={_quote(effect.equation)},",
        f"        physics={_quote(meaning.physics)},",
        f"        provoke={_quote(meaning.experiment[:1].upper() + meaning.experiment[1:] + '.')},",
        "    )",
        ")",
        "",
    ]
    return "\n".join(lines)


def _write_parameter(parameter: Parameter, formula: Formula) -> list[str]:
    """Return the declaration of a parameter, to be searched for around its value."""
    value = formula.values[parameter.name]
    fitted = formula.revision.term
    interval = fitted.intervals.get(parameter.name) if fitted is not None else None
    low, high = parameter.typical
    if not low <= value <= high:
        low, high = min(low, value), max(high, value)
    told = f"{value:.5g} {parameter.unit}"
    if interval is not None:
        told += f", between {interval[0]:.5g} and {interval[1]:.5g} with 95 %"
    return [
        f"            # found: {told}",
        f"            Parameter({_quote(parameter.name)}, {_quote(parameter.unit)}, "
        f"{_shorten(parameter.lower)}, {_shorten(parameter.upper)}, "
        f'({_shorten(low)}, {_shorten(high)}), scale="{parameter.scale}"),',
    ]


def _shorten(value: float) -> str:
    return repr(float(f"{value:.6g}"))


def _write_names(names: tuple[str, ...]) -> str:
    return f"({', '.join(_quote(name) for name in names)},)"


def _quote(text: str) -> str:
    return json.dumps(text, ensure_ascii=False)
