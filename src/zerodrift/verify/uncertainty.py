"""The uncertainty of a compensated value, by cause, in the terms of the GUM (JCGM 100:2008).

It is estimated from predictions for training runs by models that did not learn from them: the root
mean square of those errors is split into noise, parameters and what the model lacks; the chip's
rounding is added, and, outside the calibrated ranges, a share for the distance from them.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import stdtrit

from zerodrift.base.arrays import Array, Mask
from zerodrift.dataset.chip_codes import RANGE_MARGIN
from zerodrift.dataset.runs import Dataset, Run
from zerodrift.diagnosis.floor import measure_floor
from zerodrift.diagnosis.held_out import BLOCKS
from zerodrift.diagnosis.run_errors import RunError, collect_errors
from zerodrift.export.float_model import FloatModel
from zerodrift.export.integer_model import IntegerModel
from zerodrift.verify.chip_error import ChipReplay
from zerodrift.verify.left_out import LeftOut
from zerodrift.verify.summary import StatedUncertainty

FILE_NAME = "uncertainty.json"
COVERAGE_FACTOR = 2.0
COVERAGE = 0.9545
"""Of a normal distribution within two standard deviations (JCGM 100:2008, table G.1)."""
FEWEST_DEGREES = 2.0
"""Below this many degrees of freedom a spread between runs says next to nothing."""


@dataclass(frozen=True)
class OutputUncertainty:
    """Standard uncertainties of one output's compensated value, in its unit."""

    unit: str
    noise: float
    """Of a reading: what no compensation can take away."""
    parameters: float
    """RMS by which the predictions move when a run is left out."""
    left_out: float
    """Of what the model lacks: the rest of the error on runs left out."""
    rounding: float
    """RMS of integer less float model."""
    span: float
    """Of the drift over the calibrated range: what may happen once more beyond it."""
    degrees_of_freedom: float
    """Of the error's mean square, from its spread between runs."""
    covered: float | None = None
    """Share of the test logs' readings inside the calibrated ranges within the expanded one."""
    covered_readings: int = 0

    @property
    def standard(self) -> float:
        """Combined standard uncertainty inside the calibrated ranges."""
        parts = (self.noise, self.parameters, self.left_out, self.rounding)
        return float(np.sqrt(np.sum(np.square(parts))))

    @property
    def widening(self) -> float:
        """How much wider Student's interval is than the normal one, for these few runs."""
        quantile = stdtrit(self.degrees_of_freedom, (1.0 + COVERAGE) / 2.0)
        return float(quantile / COVERAGE_FACTOR)

    def expand(self, beyond: Array) -> Array:
        """Return the expanded uncertainty (k = 2) in the output's unit.

        Args:
            beyond: [n] how far outside its calibrated range an input is, as a share of that range;
                0 inside. The drift beyond is taken to be anything, evenly, up to as much per
                kelvin as the whole range showed (a rectangular distribution, JCGM 100:2008, 4.3.7).
        """
        outside = self.span * beyond / np.sqrt(3.0)
        standard = np.hypot(self.standard * self.widening, outside)
        return np.asarray(COVERAGE_FACTOR * standard)


@dataclass(frozen=True)
class Uncertainty:
    """What is known of a model's compensated values."""

    model_hash: str
    method: str
    """leave one run out | leave runs out in N parts | blocks of one run: where they come from."""
    tared: bool
    """Whether each run's own offset was taken off; it is not in the figures then."""
    outputs: Mapping[str, OutputUncertainty]

    def state(self) -> dict[str, StatedUncertainty]:
        """Return what every command states of each output, inside the calibrated ranges."""
        return {
            name: StatedUncertainty(
                unit=one.unit,
                expanded=float(one.expand(np.zeros(1))[0]),
                noise=one.noise,
                parameters=one.parameters,
                left_out=one.left_out,
                rounding=one.rounding,
                degrees_of_freedom=one.degrees_of_freedom,
                method=self.method,
                tared=self.tared,
                covered=one.covered,
                covered_readings=one.covered_readings,
            )
            for name, one in self.outputs.items()
        }


def measure_uncertainty(
    model: FloatModel,
    dataset: Dataset,
    left_out: LeftOut,
    *,
    model_hash: str,
    rounding: Sequence[float],
    span: Sequence[float],
    floor: Sequence[float] | None = None,
) -> Uncertainty:
    """Return the uncertainty of each output.

    Args:
        model: the float model, of all training runs.
        dataset: its runs.
        left_out: what models say of training runs that they did not learn from.
        model_hash: of the integer model.
        rounding: [K] RMS of integer less float model, in each output's unit.
        span: [K] of the drift over the calibrated range, likewise.
        floor: [K] RMS of the noise floor, likewise, where it is known; None: measured here.
    """
    runs = dataset.train
    covered = dict(zip((r.name for r in runs), left_out.covered, strict=True))

    def find_counted(run: Run) -> Mask:
        return np.asarray(model.find_usable(run) & covered[run.name][:, None])

    fitted = dict(zip((r.name for r in runs), model.predict_all_on_chip(runs), strict=True))
    others = dict(zip((r.name for r in runs), left_out.floating, strict=True))
    errors = collect_errors(runs, others, model.tared, find_counted)
    moved = _measure_moves(errors, fitted, others)
    noises = measure_floor(dataset).rms if floor is None else floor
    pieces = [(e.error, e.usable) for e in errors.values()]
    if len(pieces) == 1:
        pieces = list(zip(*(np.array_split(x, BLOCKS) for x in pieces[0]), strict=True))
    counts = np.array([usable.sum(axis=0) for _, usable in pieces], dtype=np.float64)
    squares = np.array([np.sum(error**2, axis=0) for error, _ in pieces]) / np.maximum(counts, 1.0)
    weights = counts / np.maximum(counts.sum(axis=0), 1.0)
    outputs = {}
    for k, name in enumerate(dataset.outputs):
        total = float(weights[:, k] @ squares[:, k])
        noise = min(float(noises[k]) ** 2, total)
        parameters = min(float(moved[k]), total - noise)
        outputs[name] = OutputUncertainty(
            unit=dataset.units[k],
            noise=noise**0.5,
            parameters=parameters**0.5,
            left_out=max(total - noise - parameters, 0.0) ** 0.5,
            rounding=float(rounding[k]),
            span=float(span[k]),
            degrees_of_freedom=min(
                count_degrees(squares[:, k], weights[:, k]),
                combine_degrees(total - noise, noise, len(errors)),
            ),
        )
    return Uncertainty(model_hash, left_out.method, model.tared, outputs)


def measure_firmware(
    described: FloatModel,
    model: IntegerModel,
    dataset: Dataset,
    left_out: LeftOut,
    rounding: Sequence[float],
    replay: ChipReplay,
    floor: Sequence[float] | None = None,
) -> Uncertainty:
    """Return the uncertainty of a firmware's values, checked on the test runs where there are any.

    Args:
        described: the float model.
        model: the integer model.
        dataset: its runs.
        left_out: what models say of training runs that they did not learn from.
        rounding: [K] RMS of integer less float model, in each output's unit.
        replay: the test runs as the chip answers them.
        floor: [K] RMS of the noise floor, in each output's unit, where it is known.
    """
    scale = [output.lsb_per_unit for output in model.outputs]
    limits = zip(model.drift.low, model.drift.high, scale, strict=True)
    measured = measure_uncertainty(
        described,
        dataset,
        left_out,
        model_hash=model.hash,
        rounding=rounding,
        span=[(high - low) / lsb / (1.0 + 2.0 * RANGE_MARGIN) for low, high, lsb in limits],
        floor=floor,
    )
    return check_coverage(measured, described, replay) if dataset.test else measured


def check_coverage(uncertainty: Uncertainty, model: FloatModel, replay: ChipReplay) -> Uncertainty:
    """Return the uncertainty with the share of readings of test runs that it covers.

    Counted are the chip's answers on rows inside the calibrated ranges, at no limit.

    Args:
        uncertainty: of training runs.
        model: the float model, which knows the rows that count.
        replay: the test runs, as the chip answers them.
    """
    replayed = {r.run.name: r for r in replay.runs}
    answers = {name: r.chip for name, r in replayed.items()}
    runs = [r.run for r in replay.runs]
    errors = collect_errors(runs, answers, model.tared, model.find_usable)
    outputs = {}
    for k, (name, one) in enumerate(uncertainty.outputs.items()):
        expanded = float(one.expand(np.zeros(1))[0])
        inside, count = 0, 0
        for error in errors.values():
            own = [replayed[run.name] for run in error.runs]
            plain = np.concatenate([r.inside[:, k] & ~r.clamped[:, k] for r in own])
            counts = error.usable[:, k] & plain
            inside += int(np.sum(np.abs(error.error[counts, k]) <= expanded))
            count += int(counts.sum())
        share = inside / count if count else None
        outputs[name] = replace(one, covered=share, covered_readings=count)
    return replace(uncertainty, outputs=outputs)


def _measure_moves(
    errors: Mapping[str, RunError], fitted: Mapping[str, Array], others: Mapping[str, Array]
) -> Array:
    """Return the mean square [K] by which predictions move when their own run is left out."""
    squares, counts = 0.0, 0.0
    for error in errors.values():
        moves = np.concatenate([fitted[run.name] - others[run.name] for run in error.runs])
        counts = counts + error.usable.sum(axis=0)
        squares = squares + np.sum(np.where(error.usable, moves, 0.0) ** 2, axis=0)
    return np.asarray(squares / np.maximum(counts, 1.0))


def combine_degrees(slow: float, noise: float, runs: int) -> float:
    """Return the degrees of freedom of an error's mean square (Welch-Satterthwaite, G.4).

    Noise is known from thousands of readings; what is slower is alike all along a run, so that each
    run counts as one observation of it.

    Args:
        slow: mean square of what is no noise.
        noise: mean square of the noise.
        runs: how many there are.
    """
    return 1e6 if slow <= 0.0 else runs * ((slow + noise) / slow) ** 2


def count_degrees(squares: Array, weights: Array) -> float:
    """Return the degrees of freedom of a mean square, from its spread between runs.

    The variance of a mean square with n degrees of freedom is 2/n of its own square, so that what
    the runs [R] show of the one tells the other (Welch-Satterthwaite, JCGM 100:2008, G.4).
    """
    total = float(weights @ squares)
    own = weights > 0.0
    if total == 0.0 or own.sum() < 2:
        return FEWEST_DEGREES
    spread = float(np.sum(weights**2 * (squares - total) ** 2)) * own.sum() / (own.sum() - 1)
    return max(2.0 * total**2 / spread, FEWEST_DEGREES) if spread > 0.0 else 1e6
