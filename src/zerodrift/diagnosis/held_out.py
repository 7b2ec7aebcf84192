"""What a model predicts for runs that it was not fitted to.

Each run is left out in turn and the model fitted to the others. The non-linear values move only a
little from the fit to all runs, so they follow by Gauss-Newton steps on sums of products; the
coefficients are then solved exactly at the moved values.
"""

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from zerodrift.base.arrays import Array
from zerodrift.base.config import EffectConfig
from zerodrift.dataset.runs import Dataset, Run
from zerodrift.diagnosis.run_errors import RunError, collect_errors
from zerodrift.physics.campaign import Sums
from zerodrift.physics.catalogue import Catalogue
from zerodrift.physics.effect import Feature
from zerodrift.physics.fit import fit
from zerodrift.physics.model import PhysicalModel
from zerodrift.physics.search import (
    Coordinate,
    get_coordinates,
    invert_scaled,
    list_coordinates,
    measure_cost,
    set_coordinates,
    slope_directions,
    solve,
    step_values,
    weigh,
)
from zerodrift.physics.signals import build_stretches
from zerodrift.physics.terms import Term, begin_at_rest

BLOCKS = 8
"""A single run is cut into this many stretches of time, each left out in turn."""
SLOPE_STEP = 1e-3
"""Finite-difference step in a parameter's own coordinate."""
STEPS = 3
"""Gauss-Newton steps with the same slopes."""
MOST_MOVE = 0.5
"""Largest move of a coordinate with the same slopes."""
LEFT_OUT_BY_SLOPES = 0.02
"""Slopes are taken again where a fold arrived if the curvature they ignore could amount to more
than this share of the error itself."""
MOST_ROUNDS = 4

TEST_LOGS = "test logs"
LEAVE_ONE_RUN_OUT = "leave one run out"
BLOCKS_OF_ONE_RUN = "blocks of one run"
NONE = "none"


@dataclass(frozen=True)
class HeldOut:
    """Predictions for data that the model did not learn from."""

    method: str
    """test logs | leave one run out | blocks of one run | none."""
    predictions: Mapping[str, Array]
    """Run's name -> [n, K] predicted drift."""

    def explain(self) -> str:
        """Return what the method is worth, in a sentence."""
        match self.method:
            case "test logs":
                return "held-out errors are those of the test logs"
            case "leave one run out":
                return "held-out errors leave each run out in turn and fit to the others"
            case "blocks of one run":
                return (
                    f"there is one run only, so {BLOCKS} stretches of it are left out in turn; "
                    "they resemble each other more than another run would, and the true error is "
                    "likely larger"
                )
            case _:
                return (
                    "nothing is held out: this model learnt from every run, and its error on "
                    "others is likely larger"
                )


@dataclass(frozen=True)
class _Fold:
    """What is left out together: rows of one run, its stretches laid end to end."""

    runs: tuple[Run, ...]
    rows: slice


def hold_out(model: PhysicalModel, dataset: Dataset) -> HeldOut:
    """Return predictions for the test logs, or for each training run from the others.

    Args:
        model: fitted to `dataset.train`.
        dataset: its runs.
    """
    if dataset.test:
        return HeldOut(TEST_LOGS, {run.name: model.predict(run) for run in dataset.test})
    groups = tuple(dict.fromkeys(run.group for run in dataset.train))
    stretches = [tuple(run for run in dataset.train if run.group == group) for group in groups]
    if len(groups) > 1:
        folds = [_Fold(runs, slice(None)) for runs in stretches]
        return HeldOut(LEAVE_ONE_RUN_OUT, predict_left_out(model, folds))
    edges = np.linspace(0, sum(len(run) for run in stretches[0]), BLOCKS + 1).round().astype(int)
    folds = [_Fold(stretches[0], slice(a, b)) for a, b in itertools.pairwise(edges.tolist())]
    return HeldOut(BLOCKS_OF_ONE_RUN, predict_left_out(model, folds))


def predict_left_out(model: PhysicalModel, folds: Sequence[_Fold]) -> dict[str, Array]:
    """Return each run's prediction [n, K], every fold from a fit to the others."""
    terms = [fitted.term for fitted in model.terms]
    coordinates = list_coordinates(terms)
    together = _Design(model, terms, coordinates, folds)
    predictions: dict[str, list[Array]] = {}
    for fold, left_out in enumerate(folds):
        design, now = together, terms
        shift = np.zeros(len(coordinates))
        for _ in range(MOST_ROUNDS):
            total = design.pool_others(fold)
            shift = _find_shift(design.sums, total, now, coordinates)
            moved = set_coordinates(now, coordinates, get_coordinates(now, coordinates) + shift)
            if design.is_straight(total, shift):
                now = moved
                break
            there = _Design(model, moved, coordinates, folds)
            shift = np.zeros_like(shift)
            if there.measure_cost(fold) >= design.measure_cost(fold):
                # The slopes promised what is not there: better stay where all runs' fit is.
                break
            design, now = there, moved
        coefficients, constant = design.solve(fold, shift)
        _, features = _build(model, begin_at_rest(now), left_out.runs)
        prediction = features[left_out.rows] @ coefficients + constant
        predictions.setdefault(left_out.runs[0].group, []).append(prediction)
    result: dict[str, Array] = {}
    for runs in {fold.runs[0].group: fold.runs for fold in folds}.values():
        whole = np.concatenate(predictions[runs[0].group])
        ends = np.cumsum([len(run) for run in runs])[:-1]
        parts = np.split(whole, ends)
        result |= {run.name: part for run, part in zip(runs, parts, strict=True)}
    return result


def _find_shift(
    sums: Sums, total: Array, terms: Sequence[Term], coordinates: Sequence[Coordinate]
) -> Array:
    """Return the move [P] of the coordinates that lowers the pooled errors, slopes kept."""
    if not coordinates:
        return np.zeros(0)
    position = get_coordinates(terms, coordinates)
    bounds = np.array([c.bounds for c in coordinates])
    low = np.maximum(bounds[:, 0] - position, -MOST_MOVE)
    high = np.minimum(bounds[:, 1] - position, MOST_MOVE)
    shift = np.zeros(len(coordinates))
    for _ in range(STEPS):
        solution = solve(sums, total, shift)
        gradient, normal = step_values(sums, total, solution, len(coordinates), shift)
        # A share of the trace keeps a coordinate still that these runs say nothing about.
        normal = normal + 1e-6 * np.eye(len(coordinates)) * np.trace(normal)
        shift = np.clip(shift + invert_scaled(normal) @ gradient, low, high)
    return shift


class _Design:
    """The model's columns at given values over all folds, reduced to sums of products."""

    def __init__(
        self,
        model: PhysicalModel,
        terms: Sequence[Term],
        coordinates: Sequence[Coordinate],
        folds: Sequence[_Fold],
    ) -> None:
        self._tared = model.tared
        moved = _move_each(terms, coordinates)
        names: tuple[Feature[Array], ...] = ()
        features: dict[str, Array] = {}
        slopes: dict[str, list[Array]] = {}
        stretches = {fold.runs[0].group: fold.runs for fold in folds}
        for group, runs in stretches.items():
            names, features[group] = _build(model, terms, runs)
            slopes[group] = [
                (_build(model, there, runs)[1] - features[group]) / step for step, there in moved
            ]
        pairs = tuple(
            (p, j)
            for p in range(len(moved))
            for j in range(len(names))
            if any(bool(of_run[p][:, j].any()) for of_run in slopes.values())
        )
        products, totals = {}, {}
        for group, runs in stretches.items():
            columns = [features[group], *(slopes[group][p][:, j : j + 1] for p, j in pairs)]
            if not model.tared:
                columns.append(np.ones((features[group].shape[0], 1)))
            columns.append(np.concatenate([model.fill_rails(run) for run in runs]))
            table = np.concatenate(columns, axis=1)
            mean = table.mean(axis=0)
            if model.tared:
                # A run's own offset says nothing about the model: it is projected out.
                table -= mean
            for fold, left_out in enumerate(folds):
                if left_out.runs[0].group == group:
                    rows = table[left_out.rows]
                    products[fold] = rows.T @ rows
                    totals[fold] = mean
        self._means = np.stack([totals[fold] for fold in range(len(folds))])
        seen = [[f.output in (None, output) for output in model.outputs] for f in names]
        self.sums = Sums(
            products=np.stack([products[fold] for fold in range(len(folds))])[:, None],
            counts=np.ones((len(folds), 1)),
            features=names,
            slopes=pairs,
            offsets=0 if model.tared else 1,
            outputs=len(model.outputs),
            mask=np.array(seen, dtype=np.bool_).reshape(len(names), len(model.outputs)),
        )
        self._weighted = weigh(self.sums, np.ones((1, len(model.outputs))))

    def pool_others(self, fold: int) -> Array:
        """Return the sums [K, C, C] over all folds but one."""
        return np.asarray(np.delete(self._weighted, fold, axis=0).sum(axis=0))

    def measure_cost(self, fold: int) -> float:
        """Return what the fit to all folds but one leaves at the present values."""
        return measure_cost(solve(self.sums, self.pool_others(fold)).errors)

    def is_straight(self, total: Array, shift: Array) -> bool:
        """Return whether the slopes hold for a move of the coordinates, as far as errors go."""
        if not shift.any():
            return True
        solution = solve(self.sums, total, shift)
        along = slope_directions(self.sums, solution, shift.size)
        squares = np.einsum("kcp,kcd,kdp->kp", along, total, along)
        ignored = 0.5 * np.sqrt(np.maximum(squares, 0.0)) @ shift**2
        return bool((ignored <= LEFT_OUT_BY_SLOPES * np.sqrt(solution.errors)).all())

    def solve(self, fold: int, shift: Array) -> tuple[Array, Array]:
        """Return coefficients [J, K] and constant [K] fitted to all folds but one."""
        solution = solve(self.sums, self.pool_others(fold), shift if shift.size else None)
        if self._tared:
            # The mean of the other runs' offsets, each run counting once.
            constant = solution.residual @ np.delete(self._means, fold, axis=0).mean(axis=0)
        else:
            ones = len(self.sums.features) + len(self.sums.slopes)
            constant = -solution.residual[:, ones]
        return solution.coefficients.T, np.asarray(constant)


def _move_each(
    terms: Sequence[Term], coordinates: Sequence[Coordinate]
) -> list[tuple[float, list[Term]]]:
    """Return, for each coordinate, a small step and the terms moved along it by that step."""
    position = get_coordinates(terms, coordinates)
    moved = []
    for p, coordinate in enumerate(coordinates):
        step = SLOPE_STEP if position[p] + SLOPE_STEP <= coordinate.bounds[1] else -SLOPE_STEP
        there = position.copy()
        there[p] += step
        moved.append((step, set_coordinates(terms, coordinates, there)))
    return moved


def _build(
    model: PhysicalModel, terms: Sequence[Term], runs: Sequence[Run]
) -> tuple[tuple[Feature[Array], ...], Array]:
    """Return the features without the constant, and their values [n, J] over a run's stretches."""
    built = [columns[1:] for columns in build_stretches(runs, model.plan, terms, model.order)]
    values = [
        np.stack([column.signal for column in columns], axis=1)
        if columns
        else np.empty((len(run), 0))
        for run, columns in zip(runs, built, strict=True)
    ]
    return tuple(built[-1]), np.concatenate(values)


# The errors that one model, fitted as it ships, makes on runs that it was not fitted to.


def leave_out(
    effects: Sequence[EffectConfig], dataset: Dataset, catalogue: Catalogue
) -> tuple[str, dict[str, RunError]]:
    """Return how training runs were left out, and the errors on each of them.

    Args:
        effects: the `[[effect]]` tables of the model, fitted by plain least squares.
        dataset: its runs; only the training runs are used.
        catalogue: the known effects.
    """
    model = fit(
        effects,
        dataset.train,
        outputs=dataset.outputs,
        units=dataset.units,
        full_scale=dataset.full_scale,
        catalogue=catalogue,
    )
    held_out = hold_out(model, replace(dataset, test=()))
    errors = collect_errors(dataset.train, held_out.predictions, model.tared, model.find_usable)
    return held_out.method, errors
