"""Whether a change of a model helps: its errors on training runs left out, before and after."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from zerodrift.base.arrays import Array
from zerodrift.diagnosis.evidence import SURE_NATS, Errors, compare_likelihoods
from zerodrift.diagnosis.held_out import BLOCKS, BLOCKS_OF_ONE_RUN, HeldOut
from zerodrift.diagnosis.run_errors import RunError, pool_rmse, pool_steady_rmse
from zerodrift.physics.model import PhysicalModel
from zerodrift.physics.reduction import MEANS, cut_octaves

IntArray = NDArray[np.int64]

WORTHWHILE = 0.985
"""A change must bring the held-out RMSE, over all outputs, below this share of what it was, ..."""
WORTHWHILE_ON_ONE = 0.97
"""... or that of one output below this, ..."""
WORTHWHILE_ON_FEW = 0.9
"""... or below this where fewer than MANY_RUNS runs show how runs differ, unless the gain in
likelihood is more than slow noise explains."""
MANY_RUNS = 3
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
    """Run -> what the held-out prediction leaves, offsets read alike in all that is compared."""
    own_errors: Mapping[str, RunError]
    """The same with offsets as the model itself reads them: what `compare` tells of it."""

    @property
    def rmse(self) -> Array:
        """[K] over all held-out samples, as `compare` tells it."""
        return pool_rmse(list(self.own_errors.values()))

    @property
    def steady_rmse(self) -> Array:
        """[K] over all held-out samples, outliers by their weights, as `compare` tells it."""
        return pool_steady_rmse(list(self.own_errors.values()))

    @property
    def judged_rmse(self) -> Array:
        """[K] over all held-out samples, as it is judged beside the others."""
        return pool_rmse(list(self.errors.values()))

    @property
    def judged_steady_rmse(self) -> Array:
        """[K] as it is judged beside the others, outliers by their weights."""
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
    name, old, new = before.model.outputs[k], before.judged_steady_rmse, after.judged_steady_rmse
    return f"{name} from {old[k]:.4g} to {new[k]:.4g} {units[k]}"


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
    few = one or runs < MANY_RUNS
    sure = few and measure_nats(before, after) >= SURE_NATS
    if one and sure:
        # Where slow noise hides a large fall, neither a small one nor a bad stretch is chance.
        return True, f"the held-out error falls by more than slow noise explains: {told}"
    # Of two runs a small fall is no more chance than of one; but both have to get better.
    if few and not sure and ratio[best] > WORTHWHILE_ON_FEW:
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
