"""One change of a model, judged by its held-out errors before and after."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from zerodrift.base.config import Config, EffectConfig
from zerodrift.dataset.runs import Dataset
from zerodrift.diagnosis.changes import REMOVE, Change, name_effect
from zerodrift.diagnosis.evidence import SURE_NATS, Errors, compare_likelihoods
from zerodrift.diagnosis.floor import NoiseFloor, measure_floor
from zerodrift.diagnosis.held_out import BLOCKS, BLOCKS_OF_ONE_RUN, HeldOut, hold_out
from zerodrift.diagnosis.run_errors import RunError, collect_errors, pool_rmse, pool_steady_rmse
from zerodrift.diagnosis.summary import HeldOutErrors, RevisionSummary, sort_errors
from zerodrift.physics.catalogue import Catalogue
from zerodrift.physics.fit import fit, fit_config
from zerodrift.physics.model import FittedTerm, PhysicalModel
from zerodrift.physics.octaves import MEANS, cut_octaves
from zerodrift.physics.summary import describe_coefficients, describe_parameters

Array = NDArray[np.float64]
IntArray = NDArray[np.int64]

WORTHWHILE = 0.985
"""A change must bring the held-out RMSE, over all outputs, below this share of what it was, ..."""
WORTHWHILE_ON_ONE = 0.97
"""... or that of one output below this, ..."""
WORTHWHILE_ON_FEW = 0.9
"""... or below this where fewer than MANY_RUNS runs show how runs differ."""
MANY_RUNS = 3
LOWER = 0.995
"""An effect is needless if the error without it is below this share of what it is with it."""
AS_GOOD = 1.005
"""A model without an effect is as good if its RMSE is below this share of what it was."""
GAIN_OVER_LOSS = 3.0
"""What the runs that get better gain, over what the others lose."""


@dataclass(frozen=True)
class Fitted:
    """A model of one list of effects, and its held-out errors."""

    model: PhysicalModel
    held_out: HeldOut
    errors: Mapping[str, RunError]
    """Run -> what the held-out prediction leaves."""

    @property
    def rmse(self) -> Array:
        """[K] over all held-out samples."""
        return pool_rmse(list(self.errors.values()))

    @property
    def steady_rmse(self) -> Array:
        """[K] over all held-out samples, outliers by their weights."""
        return pool_steady_rmse(list(self.errors.values()))

    @property
    def has_outliers(self) -> bool:
        """Whether some of the held-out samples are outliers."""
        return any(e.outlier_rows for e in self.errors.values())

    @property
    def is_one_run(self) -> bool:
        """Whether stretches of one run stand in for runs."""
        return self.held_out.method == BLOCKS_OF_ONE_RUN

    @property
    def squares(self) -> Array:
        """[R, K] sums of squared errors, per run or per stretch of the only one.

        Outliers count by their weights: what they hold is neither gained nor lost by an effect.
        """
        errors = [np.sqrt(e.weights) * e.error for e in self.errors.values()]
        if self.is_one_run:
            errors = np.array_split(errors[0], BLOCKS)
        return np.stack([np.sum(error**2, axis=0) for error in errors])


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
    """Whether each run's own offset is taken off the errors, before and after."""

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

    Args:
        config: the project as it is.
        dataset: its runs.
        catalogue: the known effects.
        changes: forms of one change, simplest first; see `choose_form`.
    """
    models = [
        fit_config(replace(config, effects=wanted), dataset, catalogue)
        for wanted in (config.effects, *(change.effects for change in changes))
    ]
    tared = find_tared(models)  # errors must be comparable
    before, *fitted = (_hold_out(model, dataset, tared) for model in models)
    best = choose_form(before, fitted, dataset.units)
    change, after = changes[best], fitted[best]
    floor = measure_floor(dataset)
    judged = judge_removal if change.action == REMOVE else judge
    helps, reason = judged(before, after, dataset.units)
    return Revision(change, before, after, floor, helps, reason, tared)


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
    before, *after = _fit_alike((effects, *forms), dataset, catalogue)
    return judge(before, after[choose_form(before, after, dataset.units)], dataset.units)


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
    models = [
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
    tared = find_tared(models)
    return [_hold_out(model, dataset, tared) for model in models]


def find_tared(models: Sequence[PhysicalModel]) -> bool:
    """Return whether logs are zeroed one by one, as the richest of some models sees it.

    The richest decides: an effect may reveal offsets, or explain what looked like them.
    """
    most = max(len(model.terms) for model in models)
    return [model for model in models if len(model.terms) == most][-1].tared


def _hold_out(model: PhysicalModel, dataset: Dataset, tared: bool) -> Fitted:
    held_out = hold_out(model, dataset)
    runs = [*dataset.train, *dataset.test]
    errors = collect_errors(runs, held_out.predictions, tared, model.find_usable)
    return Fitted(model, held_out, errors)


@dataclass(frozen=True)
class _Change:
    """How the held-out errors changed."""

    ratio: Array
    """[K] RMSE after over before; 1 for outputs without any error."""
    overall: float
    """Geometric mean of the ratios, of outputs with an error."""
    gains: Array
    """[R] what each run, or stretch of the only one, gains, summed over the outputs in shares of
    their squared error before."""


def _measure_change(before: Fitted, after: Fitted) -> _Change:
    old, new = before.squares, after.squares
    whole = old.sum(axis=0)
    scale = np.where(whole > 0.0, whole, 1.0)
    ratio = np.where(whole > 0.0, np.sqrt(new.sum(axis=0) / scale), 1.0)
    # An output that never moves has no error to lower, and none that waters down the others'.
    moving = ratio[whole > 0.0]
    overall = float(np.exp(np.mean(np.log(np.maximum(moving, 1e-12))))) if moving.size else 1.0
    return _Change(ratio, overall, ((old - new) / scale).sum(axis=1))


def measure_nats(before: Fitted, after: Fitted) -> float:
    """Return the gain in log-likelihood on held-out data, each octave's noise refitted."""
    old, new = _take_apart(before), _take_apart(after)
    levels = np.unique(old[1])
    unjudged = levels == MEANS

    def sort(squares: Array, of_level: IntArray) -> Errors:
        rows = np.stack([squares[of_level == level].sum(axis=0) for level in levels])
        counts = np.array([float((of_level == level).sum()) for level in levels])
        return Errors(rows[None], counts[None])

    return compare_likelihoods(sort(*old), sort(*new), levels, unjudged)


def _take_apart(fitted: Fitted) -> tuple[Array, IntArray]:
    """Return the squares [M, K] of the held-out errors' octaves, and each one's octave [M]."""
    errors = [np.sqrt(e.weights) * e.error for e in fitted.errors.values()]
    octaves = cut_octaves(np.array([error.shape[0] for error in errors], dtype=np.int64), 1)
    joined = np.concatenate(errors)
    details = [octaves.transform(joined[:, k]) for k in range(joined.shape[1])]
    return np.stack(details, axis=1) ** 2, octaves.octave


def measure_overall(before: Fitted, after: Fitted) -> float:
    """Return the held-out RMSE after over before, geometric mean over the outputs."""
    return _measure_change(before, after).overall


def _tell(before: Fitted, after: Fitted, units: Sequence[str], k: int) -> str:
    name = before.model.outputs[k]
    return f"{name} from {before.steady_rmse[k]:.4g} to {after.steady_rmse[k]:.4g} {units[k]}"


def judge(before: Fitted, after: Fitted, units: Sequence[str]) -> tuple[bool, str]:
    """Return whether an effect helps on held-out data by more than runs differ, and why.

    The runs that lose show by how much gains come and go by chance.
    """
    change = _measure_change(before, after)
    ratio, runs = change.ratio, change.gains.size
    best = int(np.argmin(ratio))
    told = _tell(before, after, units, best)
    if change.overall > WORTHWHILE and ratio[best] > WORTHWHILE_ON_ONE:
        falls = "falls too little" if change.overall < 1.0 else "does not fall"
        return False, (
            f"the held-out error {falls}: {100.0 * (change.overall - 1.0):+.1f} % over all "
            f"outputs, at best {told}"
        )
    one = before.is_one_run
    if one and measure_nats(before, after) >= SURE_NATS:
        # Where slow noise hides a large fall, neither a small one nor a bad stretch is chance.
        return True, f"the held-out error falls by more than slow noise explains: {told}"
    if (runs < MANY_RUNS or one) and ratio[best] > WORTHWHILE_ON_FEW:
        count = (
            "stretches of one run" if one else f"{runs} held-out {'run' if runs == 1 else 'runs'}"
        )
        return False, (
            f"the held-out error falls, {told}, but with {count} a fall of less than "
            f"{100.0 * (1.0 - WORTHWHILE_ON_FEW):.0f} % may be chance"
        )
    noun = "stretches of the only run" if one else "runs"
    better = int((change.gains > 0.0).sum())
    gained = float(change.gains[change.gains > 0.0].sum())
    lost = float(-change.gains[change.gains < 0.0].sum())
    if gained < GAIN_OVER_LOSS * lost:
        return False, (
            f"the held-out error falls in {better} of {runs} {noun} and rises in the others by too "
            f"much to rule out chance, at best {told}"
        )
    return True, f"the held-out error falls in {better} of {runs} {noun}, most for {told}"


def judge_removal(before: Fitted, after: Fitted, units: Sequence[str]) -> tuple[bool, str]:
    """Return whether the model is as good without an effect, and by how much it is not."""
    change = _measure_change(before, after)
    worst = int(np.argmax(change.ratio))
    told = _tell(before, after, units, worst)
    overall = f"{100.0 * (change.overall - 1.0):+.1f} % over all outputs"
    if change.overall <= AS_GOOD and change.ratio[worst] <= 1.0 / WORTHWHILE_ON_ONE:
        return True, f"without it the held-out error is as good: {overall}, at worst {told}"
    return False, f"without it the held-out error is worse: {overall}, at worst {told}"


def summarise_revision(revision: Revision) -> RevisionSummary:
    """Return what the command prints, without the predictions behind it."""
    model, term = revision.after.model, revision.term
    outputs = model.outputs

    def by_output(values: Array) -> dict[str, float]:
        return {name: float(value) for name, value in zip(outputs, values, strict=True)}

    method = revision.after.held_out.method

    def tell(fitted: Fitted) -> HeldOutErrors:
        without = by_output(fitted.steady_rmse) if fitted.has_outliers else None
        return sort_errors(method, by_output(fitted.rmse), without)

    return RevisionSummary(
        effect=revision.change.effect.kind,
        parameters=describe_parameters(term) if term is not None else {},
        before=tell(revision.before),
        after=tell(revision.after),
        noise_floor=by_output(revision.floor.rms),
        noise_floor_source=revision.floor.source,
        units=dict(zip(outputs, model.units, strict=True)),
        held_out=method,
        tared=revision.tared,
        helps=revision.helps,
        reason=revision.reason,
        effects=tuple(model.effects),
        coefficients=describe_coefficients(model, term) if term is not None else (),
        notes=tuple(model.notes),
    )
