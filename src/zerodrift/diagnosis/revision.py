"""One change of a model, fitted before and after, and what its judgement says.

Test logs decide nothing here: a model that was chosen by them would make their error too small.
Their errors are told beside, where there are any.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

from zerodrift.base.arrays import Array
from zerodrift.base.config import Config, EffectConfig
from zerodrift.dataset.runs import Dataset
from zerodrift.diagnosis.candidates import are_sound
from zerodrift.diagnosis.changes import REMOVE, Change, name_effect
from zerodrift.diagnosis.floor import NoiseFloor, measure_floor
from zerodrift.diagnosis.held_out import hold_out
from zerodrift.diagnosis.judgement import Fitted, judge, judge_removal, measure_overall
from zerodrift.diagnosis.run_errors import collect_errors, pool_rmse
from zerodrift.diagnosis.span import measure_span
from zerodrift.diagnosis.summary import HeldOutErrors, RevisionSummary
from zerodrift.physics.catalogue import Catalogue
from zerodrift.physics.fit import fit, fit_config
from zerodrift.physics.model import FittedTerm, PhysicalModel
from zerodrift.physics.summary import describe_coefficients, describe_parameters

LOWER = 0.995
"""An effect is needless if the error without it is below this share of what it is with it."""


@dataclass(frozen=True)
class Revision:
    """A change of the model's effects, and what it did to the held-out errors."""

    change: Change
    before: Fitted
    after: Fitted
    floor: NoiseFloor
    helps: bool
    """Whether the held-out error is better by more than runs differ; for a removal, as good."""
    reason: str
    """Why, in a sentence."""
    tared: bool
    """Whether each run's own offset is taken off the errors that are judged, before and after."""
    test_rmse: tuple[Array, Array] | None = None
    """[K] on the test logs before and after, as `compare` tells it; None where there are none."""

    @property
    def reads_offsets_anew(self) -> bool:
        """Whether the models before and after read the runs' offsets differently."""
        return self.before.model.tared != self.after.model.tared

    @property
    def term(self) -> FittedTerm | None:
        """The new effect as fitted; None after a removal."""
        name = name_effect(self.change.effect)
        return next((f for f in self.after.model.terms if f.term.name == name), None)


def revise(config: Config, dataset: Dataset, catalogue: Catalogue, change: Change) -> Revision:
    """Fit the model before and after a change of its effects, and judge the change.

    Args:
        config: the project as it is.
        dataset: its runs.
        catalogue: the known effects.
        change: what is added, changed or removed.
    """
    return revise_best(config, dataset, catalogue, (change,))


def revise_best(
    config: Config, dataset: Dataset, catalogue: Catalogue, changes: Sequence[Change]
) -> Revision:
    """Fit the model before and after each of some changes, and judge the best of them.

    Forms marked as richer are asked only where no plain one helps: on few runs their freedom alone
    may look like a gain.

    Args:
        config: the project as it is.
        dataset: its runs.
        catalogue: the known effects.
        changes: forms of one change, simplest first; see `choose_form`.
    """
    plain = [change for change in changes if not change.is_richer]
    revision = _revise_best(config, dataset, catalogue, plain)
    if revision.helps or len(plain) == len(changes):
        return revision
    richer = _revise_best(config, dataset, catalogue, changes)
    return richer if richer.helps else revision


def _revise_best(
    config: Config, dataset: Dataset, catalogue: Catalogue, changes: Sequence[Change]
) -> Revision:
    old, *models = (
        fit_config(replace(config, effects=wanted), dataset, catalogue)
        for wanted in (config.effects, *(change.effects for change in changes))
    )
    sound = _list_sound(config.effects, [c.effects for c in changes], models, dataset)
    tared = find_tared([old, *(models[i] for i in _list_tried(sound))])  # comparable errors
    before, best, after = _choose_sound(old, models, sound, tared, dataset)
    change = changes[best]
    floor = measure_floor(dataset)
    judged = judge_removal if change.action == REMOVE else judge
    helps, reason = judged(before, after, dataset.units)
    test = (_test(before.model, dataset), _test(after.model, dataset)) if dataset.test else None
    return Revision(change, before, after, floor, helps, reason, tared, test)


def choose_form(before: Fitted, forms: Sequence[Fitted], units: Sequence[str]) -> int:
    """Return which of some forms of one change to take, simplest first.

    A later one is taken if it passes against the best one before it what a change must pass against
    the model as it is; and passes that as well, unless no simpler one does: what the simplest form
    earns, a richer one does not forfeit.
    """
    best, kept = 0, judge(before, forms[0], units)[0]
    for i in range(1, len(forms)):
        if judge(forms[best], forms[i], units)[0]:
            passes = judge(before, forms[i], units)[0]
            if passes or not kept:
                best, kept = i, passes
    return best


def try_extension(
    effects: Sequence[EffectConfig],
    forms: Sequence[Sequence[EffectConfig]],
    dataset: Dataset,
    catalogue: Catalogue,
) -> tuple[bool, str]:
    """Return whether `add` would keep an extension of the model, and why.

    Args:
        effects: the `[[effect]]` tables as they are.
        forms: the tables with one effect more, or in a richer form; simplest first.
        dataset: the runs.
        catalogue: the known effects.
    """
    old, *models = _fit_all((effects, *forms), dataset, catalogue)
    sound = _list_sound(effects, forms, models, dataset)
    tared = find_tared([old, *(models[i] for i in _list_tried(sound))])
    before, _, after = _choose_sound(old, models, sound, tared, dataset)
    return judge(before, after, dataset.units)


def _list_sound(
    effects: Sequence[EffectConfig],
    forms: Sequence[Sequence[EffectConfig]],
    models: Sequence[PhysicalModel],
    dataset: Dataset,
) -> list[int]:
    """Return which forms of a change are sound; the only one there is needs no test.

    Equal time constants, one at its bound, or a share of nothing, are another form in disguise.
    """
    if len(forms) == 1:
        return [0]
    span = measure_span(dataset.train, dataset.full_scale)
    sound = []
    for i, form in enumerate(forms):
        placed = zip(form, models[i].terms, strict=True)
        if all(are_sound(f.term, span) for effect, f in placed if effect not in effects):
            sound.append(i)
    return sound


def _list_tried(sound: Sequence[int]) -> list[int]:
    return sorted({0, *sound})


def _choose_sound(
    old: PhysicalModel,
    models: Sequence[PhysicalModel],
    sound: Sequence[int],
    tared: bool,
    dataset: Dataset,
) -> tuple[Fitted, int, Fitted]:
    """Return the model before, which form to take, and the model in that form.

    One that is sound; the simplest, sound or not, where no other helps.

    Args:
        old: the model before.
        models: the model in each form, simplest first.
        sound: which forms are sound.
        tared: take each run's own offset off the errors.
        dataset: the runs.
    """
    before = _hold_out(old, dataset, tared)
    after = {i: _hold_out(models[i], dataset, tared) for i in _list_tried(sound)}
    best = 0
    if sound:
        best = sound[choose_form(before, [after[i] for i in sound], dataset.units)]
        if 0 not in sound and not judge(before, after[best], dataset.units)[0]:
            best = 0
    return before, best, after[best]


def list_needless(
    effects: Sequence[EffectConfig], dataset: Dataset, catalogue: Catalogue
) -> tuple[str, ...]:
    """Return the effects of a model without which the error on runs left out is lower.

    Args:
        effects: the model's `[[effect]]` tables.
        dataset: the runs.
        catalogue: the known effects.
    """
    needless = []
    for place, effect in enumerate(effects):
        if catalogue[effect.kind].sets_aside:
            continue
        others = (*effects[:place], *effects[place + 1 :])
        without, full = _fit_alike((others, effects), dataset, catalogue)
        if measure_overall(full, without) < LOWER and not judge(without, full, dataset.units)[0]:
            needless.append(effect.kind)
    return tuple(needless)


def _fit_alike(
    models_of: Sequence[Sequence[EffectConfig]], dataset: Dataset, catalogue: Catalogue
) -> list[Fitted]:
    """Return models with their held-out errors, which are comparable."""
    return _hold_out_alike(_fit_all(models_of, dataset, catalogue), dataset)


def _fit_all(
    models_of: Sequence[Sequence[EffectConfig]], dataset: Dataset, catalogue: Catalogue
) -> list[PhysicalModel]:
    return [
        fit(
            effects,
            dataset.train,
            outputs=dataset.outputs,
            units=dataset.units,
            full_scale=dataset.full_scale,
            catalogue=catalogue,
        )
        for effects in models_of
    ]


def _hold_out_alike(models: Sequence[PhysicalModel], dataset: Dataset) -> list[Fitted]:
    tared = find_tared(models)
    return [_hold_out(model, dataset, tared) for model in models]


def find_tared(models: Sequence[PhysicalModel]) -> bool:
    """Return whether logs are zeroed one by one, as the richest of some models sees it.

    The richest decides: an effect may reveal offsets, or explain what looked like them.
    """
    most = max(len(model.terms) for model in models)
    return [model for model in models if len(model.terms) == most][-1].tared


def _hold_out(model: PhysicalModel, dataset: Dataset, tared: bool) -> Fitted:
    runs = dataset.train
    held_out = hold_out(model, replace(dataset, test=()))
    own = collect_errors(runs, held_out.predictions, model.tared, model.find_usable)
    errors = own
    if tared != model.tared:
        errors = collect_errors(runs, held_out.predictions, tared, model.find_usable)
    return Fitted(model, held_out, errors, own)


def _test(model: PhysicalModel, dataset: Dataset) -> Array:
    """Return the RMSE [K] on the test logs."""
    predictions = {run.name: model.predict(run) for run in dataset.test}
    errors = collect_errors(dataset.test, predictions, model.tared, model.find_usable)
    return pool_rmse(list(errors.values()))


def summarise_revision(revision: Revision) -> RevisionSummary:
    """Return what the command prints, without the predictions behind it."""
    model, term = revision.after.model, revision.term
    outputs = model.outputs

    def by_output(values: Array) -> dict[str, float]:
        return {name: float(value) for name, value in zip(outputs, values, strict=True)}

    def tell(fitted: Fitted, test: Array | None) -> HeldOutErrors:
        without = by_output(fitted.steady_rmse) if fitted.has_outliers else None
        tested = by_output(test) if test is not None else None
        return HeldOutErrors(by_output(fitted.rmse), tested, without)

    def tell_judged(fitted: Fitted) -> HeldOutErrors | None:
        if not revision.reads_offsets_anew:
            return None
        without = by_output(fitted.judged_steady_rmse) if fitted.has_outliers else None
        return HeldOutErrors(by_output(fitted.judged_rmse), None, without)

    test = revision.test_rmse or (None, None)
    return RevisionSummary(
        effect=revision.change.effect.kind,
        parameters=describe_parameters(term) if term is not None else {},
        before=tell(revision.before, test[0]),
        after=tell(revision.after, test[1]),
        judged_before=tell_judged(revision.before),
        judged_after=tell_judged(revision.after),
        noise_floor=by_output(revision.floor.rms),
        noise_floor_source=revision.floor.source,
        units=dict(zip(outputs, model.units, strict=True)),
        held_out=revision.after.held_out.method,
        tared=revision.tared,
        helps=revision.helps,
        reason=revision.reason,
        effects=tuple(model.effects),
        coefficients=describe_coefficients(model, term) if term is not None else (),
        notes=tuple(model.notes),
    )
