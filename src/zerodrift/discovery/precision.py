"""How precise a programme makes a model: widths of its values, and the error that is left by them.

Linear least squares around a model's values: coefficients of each output, and shared values along
their slopes. The noise is white once octaves are weighted, so the inverse of the normal matrix is
the covariance; a log's mean says nothing, since logs may be tared.

Source: Golub and Pereyra, SIAM J. Numer. Anal. 10 (1973); JCGM 100 (GUM), 5.1.2.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from zerodrift.base.arrays import Array
from zerodrift.discovery.contenders import Truth
from zerodrift.discovery.criterion import Judge
from zerodrift.discovery.stage import Staged
from zerodrift.physics.projection import (
    Coordinate,
    get_coordinates,
    invert_scaled,
    list_coordinates,
    set_coordinates,
)

STEP = 1e-3
"""Finite-difference step of a shared value, in its own coordinate."""
PRIOR = 2.0
"""Standard deviation of a shared value of which nothing is known, in its own coordinate."""


@dataclass(frozen=True)
class Precision:
    """What an experiment leaves uncertain of one model."""

    widths: Array
    """[P] standard error of each shared value, in its own coordinate (a logarithm, or a share)."""
    relative: Array
    """[K', J] standard error of each coefficient over its size; infinite for one of zero."""
    error: Array
    """[K'] RMS error of the prediction over the use profile, in each output's unit."""


def list_free(truth: Truth, *, known: bool) -> list[Coordinate]:
    """Return the shared values that are to be determined; none where they are known already."""
    return [] if known else [c for c in list_coordinates(truth.terms) if not c.parameter.is_setting]


def measure_precision(
    judge: Judge, stages: Sequence[Staged], use: Staged, truth: Truth, *, known: bool
) -> Precision:
    """Return what a model's values are still uncertain by after an experiment.

    Args:
        judge: of the scene.
        stages: the experiment's logs, and those before it.
        use: the use profile.
        truth: the model, with coefficients.
        known: whether shared values are known, as from another unit of the design.
    """
    free = list_free(truth, known=known)
    u = get_coordinates(truth.terms, free)
    moved = []
    for p in range(len(free)):
        there = u.copy()
        there[p] += STEP if u[p] + STEP <= free[p].bounds[1] else -STEP
        moved.append((set_coordinates(truth.terms, free, there), there[p] - u[p]))
    outputs = len(judge.outputs)
    told = [judge.lay_columns(stage, truth.terms) for stage in stages]
    shifted = [[judge.lay_columns(s, terms) for s in stages] for terms, _ in moved]
    used = judge.lay_columns(use, truth.terms, whiten=False)
    used_shifted = [judge.lay_columns(use, terms, whiten=False) for terms, _ in moved]
    places = judge.list_seen(use, truth.terms)
    own = [truth.coefficients[judge.outputs[k], places[k]] for k in range(outputs)]
    normals, crosses, seen = [], [], []
    information = np.eye(len(free)) / PRIOR**2
    for k in range(outputs):
        now = np.concatenate([one[k] for one in told])
        coefficients = own[k]
        slopes = np.stack(
            [
                (np.concatenate([one[k] for one in shifted[p]]) - now) @ coefficients / moved[p][1]
                for p in range(len(free))
            ]
            or [np.empty(0)],
            axis=-1,
        )
        slopes = slopes.reshape(len(now), -1) if free else np.empty((len(now), 0))
        inverse = invert_scaled(now.T @ now)
        cross = inverse @ now.T @ slopes
        information += slopes.T @ slopes - slopes.T @ now @ cross
        normals.append(inverse)
        crosses.append(cross)
        use_slopes = [
            (used_shifted[p][k] - used[k]) @ coefficients / moved[p][1] for p in range(len(free))
        ]
        seen.append(np.stack(use_slopes, axis=-1) if free else np.empty((len(used[k]), 0)))
    shared = np.linalg.inv(information) if free else np.empty((0, 0))
    relative, error = [], []
    for k in range(outputs):
        covariance = normals[k] + crosses[k] @ shared @ crosses[k].T
        size = np.abs(own[k])
        spread = np.sqrt(np.maximum(np.diag(covariance), 0.0))
        relative.append(np.where(size > 0.0, spread / np.where(size > 0.0, size, 1.0), np.inf))
        along = seen[k] - used[k] @ crosses[k]
        rows = np.einsum("np,pq,nq->n", used[k], normals[k], used[k])
        rows = rows + np.einsum("np,pq,nq->n", along, shared, along)
        error.append(float(np.sqrt(np.mean(rows))))
    width = max(len(one) for one in relative)
    padded = np.stack(
        [np.pad(one, (0, width - len(one)), constant_values=np.inf) for one in relative]
    )
    return Precision(np.sqrt(np.diag(shared)), padded, np.array(error))
