"""What a programme is expected to show: each truth is simulated, each rival refitted to it.

The squared distance that a rival's best refit leaves of the white coefficients of a staged log is
twice the expected log-likelihood ratio between the two, and what `diagnose` would find one gains
over the other, in its own units.

Source: Atkinson and Fedorov, Biometrika 62 (1975), T-optimality; Kullback and Leibler (1951).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.special import ndtr

from zerodrift.base.arrays import Array, IntArray, Mask
from zerodrift.dataset.runs import Run
from zerodrift.diagnosis.evidence import FEWEST_COEFFICIENTS, SURE_NATS
from zerodrift.diagnosis.examination import TIME_ALONE
from zerodrift.diagnosis.judgement import MANY_RUNS
from zerodrift.diagnosis.rules import (
    ALIKE_UNITS,
    ALIKE_UNLESS_SURE,
    ENOUGH_RUNS,
    SURE_UNITS,
    WORTHWHILE,
    WORTHWHILE_ON_ONE,
)
from zerodrift.discovery.contenders import Scene, Truth
from zerodrift.discovery.limits import Limits
from zerodrift.discovery.programme import Log, PlannedCourse, follow
from zerodrift.discovery.search import Space
from zerodrift.operations.backend import NumpyOperations
from zerodrift.physics.effect import Signals
from zerodrift.physics.reduction import MEANS, Octaves, cut_octaves
from zerodrift.physics.signals import read_signals
from zerodrift.physics.terms import Term, build_features

# Logs on the stage: what a sensor is exposed to in them, and how their noise becomes white.
#
# Signals are taken apart into octaves, in which the measured noise is white once each octave is
# weighted (see `physics.reduction`). A log's mean is left out, since logs may be tared.

POWERED_EARLIER_S = 7200.0


@dataclass(frozen=True)
class Whitening:
    """How block means of one log become white coefficients without the mean."""

    octaves: Octaves
    keep: Mask
    """Its rows but for the mean."""
    scale: Array
    """[K', R] one over the noise of each coefficient."""

    @property
    def octave(self) -> IntArray:
        """[R] the number of each coefficient's octave, larger is slower."""
        return self.octaves.octave[self.keep]

    @property
    def variance(self) -> Array:
        """[K', R] of each coefficient's noise, before it is white."""
        return np.asarray(self.scale**-2)

    def whiten(self, x: Array, k: int) -> Array:
        """Return the coefficients [P, R, J] of columns [P, n, J] of output k."""
        cut = self.octaves
        running = np.concatenate([np.zeros_like(x[:, :1]), np.cumsum(x, axis=1)], axis=1)
        middle = running[:, cut.middle[self.keep]]
        first = (middle - running[:, cut.start[self.keep]]) * cut.left[self.keep][:, None]
        second = (running[:, cut.stop[self.keep]] - middle) * cut.right[self.keep][:, None]
        return np.asarray((first - second) * self.scale[k][:, None])


@dataclass(frozen=True)
class Staged:
    """Staged signals [P, n] of P logs of one length, and how they become white."""

    signals: Signals[Array]
    period_s: float
    white: Whitening
    weight: Array
    """[P] square root of how many logs each stands for."""

    @property
    def rows(self) -> float:
        """Blocks of all logs."""
        return float(np.sum(self.weight**2) * self.signals.elapsed_s.shape[1])


def make_white(scene: Scene, rows: int, block: int, outputs: Sequence[int]) -> Whitening:
    """Return what turns `rows` means over `block` samples into white coefficients."""
    octaves = cut_octaves(np.array([rows], dtype=np.int64), block)
    keep = octaves.octave != MEANS
    numbers, place = np.unique(octaves.octave[keep], return_inverse=True)
    variance = scene.noise.variance(numbers, rows * block, block)[:, list(outputs)]
    floor = np.maximum(variance, 1e-30 + 1e-12 * variance.max(axis=0))
    return Whitening(octaves, keep, np.asarray(np.sqrt(block / floor)[place].T))


def make_signals(
    scene: Scene, logs: Sequence[Log], courses: Sequence[PlannedCourse]
) -> Signals[Array]:
    """Return what a sensor is exposed to in logs of one length."""
    plan = scene.plan
    time_s: Array = np.stack([course.time_s for course in courses])
    earlier = np.array([0.0 if log.power_on else POWERED_EARLIER_S for log in logs])
    elapsed: Array = time_s + earlier[:, None]
    still = np.zeros_like(time_s)

    def channel(name: str) -> Array:
        if name == "clock":
            return elapsed
        first = courses[0]
        if name in first.inputs:
            return np.stack([course.inputs[name] for course in courses])
        return still

    return Signals(
        temperature_degC=np.stack([course.temperature_degC for course in courses]),
        elapsed_s=elapsed,
        clock_s=elapsed,
        load={
            name: np.stack([c.loads[name] for c in courses]) if name in courses[0].loads else still
            for name in plan.loaded
        },
        saturated=dict.fromkeys(plan.saturated, still),
        channels={name: channel(name) for name in plan.channels},
        outputs=plan.outputs,
        full_scale=dict(zip(plan.outputs, plan.full_scale, strict=True)),
        reference_temperature_degC=plan.reference_temperature_degC,
    )


# What a programme is expected to show: each truth is simulated, each rival refitted to it.

ROWS = 192
"""Blocks of a log that are simulated, in a search."""
CLOSE_ROWS = 768
"""The same where one programme is looked at closely: what follows within seconds, or bends there,
is told apart by its corners."""
ROWS_BEFORE = 128
"""The same of each log that there is already."""
NEGLIGIBLE = 1e-9


@dataclass(frozen=True)
class Told:
    """What an experiment is expected to show, logs before it included."""

    gain: Array
    """[M, D] squared distance of each truth from the model without it, noise units."""
    apart: Array
    """[M, D, M] the same from each rival's best refit; infinite from itself."""
    runs: int
    """Logs in all."""
    excess: Array
    """[M, D, K'] mean square of what the model without it leaves of a truth, over the noise's."""
    beside: Array
    """[M, D] the squared distance from the nearest effect that is not among the open ones; infinite
    where none was looked at."""
    nats: Array
    """[M, D] gain of each truth in log-likelihood, the noise of each octave refitted beside either
    model; 0 of an effect that follows the time alone."""
    disguised: Array
    """[M, D, M] probability that a rival is seen to be another effect in disguise, at values that
    the ends of their ranges do as well as; 0 in a search, which does not look there."""
    samples: float
    """Samples of all outputs, logs before included."""


class _Seen(NamedTuple):
    """What the model as it is leaves of the truths in one stage."""

    lasts_s: float
    excess: Array
    """[M, K'] mean square over the noise's, in the mean over logs and time."""
    nats: Array
    """[M]."""


class _Laid(NamedTuple):
    """What all models and truths are in one output: whitened, rows that count alike."""

    truths: Array
    """[rows, M]."""
    models: list[Array]
    """Model -> [rows, p], the base first."""
    beside: Sequence[Array] = ()
    """Model -> the truths [rows, M] that stand beside its rows, where these differ."""

    def join(self, before: "_Laid | None", begin: int, end: int) -> tuple[Array, Array]:
        """Return models [N, R, p] of one form and truths [N, R, M], earlier logs below."""
        models = np.stack(self.models[begin:end])
        truths = np.broadcast_to(self.truths, (end - begin, *self.truths.shape))
        if before is None:
            return models, truths
        return (
            np.concatenate([models, np.stack(before.models[begin:end])], axis=1),
            np.concatenate([truths, np.stack(before.beside[begin:end])], axis=1),
        )


class Judge:
    """Judges programmes of one scene within limits.

    Args:
        scene: what is known.
        limits: how sensor and chamber follow.
        before: logs that there are already.
        outputs: indices of the outputs that are looked at.
        rows: blocks of a log that are simulated, at most.
    """

    def __init__(
        self,
        scene: Scene,
        limits: Limits,
        before: Sequence[Run],
        outputs: Sequence[int],
        rows: int = ROWS,
    ) -> None:
        self.scene, self.limits, self.outputs, self.rows = scene, limits, tuple(outputs), rows
        self._white: dict[tuple[int, int], Whitening] = {}
        self._floor = np.array(scene.noise.weights.sum(axis=0))[list(outputs)]
        self._before = self._look_back(before)

    def scale(self, logs: Sequence[Log], wide: Sequence[Log], sizes: Array) -> Scene:
        """Return the scene with coefficients of which nothing is known made as large as asked.

        Args:
            logs: a programme that moves everything.
            wide: one with the time to reach all that the limits allow, over which the columns of
                a truth bring alike.
            sizes: [K] RMS of what is beyond the model there, in each output's unit.
        """
        stage = self.stage(logs, np.ones(len(logs)))
        reach = self.stage(wide, np.ones(len(wide)))
        contenders = tuple(
            replace(
                c,
                truths=tuple(
                    t if t.known else self._scale_truth(stage, reach, t, sizes) for t in c.truths
                ),
            )
            for c in self.scene.contenders
        )
        return replace(self.scene, contenders=contenders)

    def _scale_truth(self, stage: Staged, reach: Staged, truth: Truth, sizes: Array) -> Truth:
        def stack(stage: Staged, terms: Sequence[Term]) -> tuple[Array, list[str | None]]:
            shape = stage.signals.temperature_degC.shape
            ops = NumpyOperations(stage.period_s, shape)
            features = build_features(ops, stage.signals, terms, self.scene.order)[1:]
            columns = np.stack([np.broadcast_to(f.signal, shape) for f in features], axis=-1)
            columns = columns - columns.mean(axis=1, keepdims=True)
            return columns.reshape(-1, len(features)), [f.output for f in features]

        columns, owners = stack(stage, truth.terms)
        base, base_owners = stack(stage, self.scene.base)
        spread = stack(reach, truth.terms)[0].std(axis=0)
        each = np.where(spread > 0.0, 1.0 / np.where(spread > 0.0, spread, 1.0), 0.0)
        coefficients = truth.coefficients[:, : len(owners)] * each
        for k, name in enumerate(self.scene.plan.outputs):
            coefficients[k] *= [owner in (None, name) for owner in owners]
            mine = base[:, [owner in (None, name) for owner in base_owners]]
            total = columns @ coefficients[k]
            beyond = np.sqrt(np.mean(total**2))
            if mine.shape[1]:
                beyond = np.sqrt(_leave(mine[None], total[None, :, None])[0, 0] / total.size)
            coefficients[k] *= sizes[k] / beyond if beyond > 0.0 else 0.0
        return replace(truth, coefficients=coefficients)

    def judge(self, space: Space, point: Array) -> Told:
        """Return what the programme of a point is expected to tell."""
        return self.judge_logs(space.list_patterns(point), space.repeats)

    def judge_logs(self, logs: Sequence[Log], repeats: Array) -> Told:
        """Return what logs of one length are expected to tell, each done so many times."""
        return self.judge_nodes(logs, repeats)[0]

    def judge_nodes(self, logs: Sequence[Log], repeats: Array) -> tuple[Told, list[Array]]:
        """Return the same, and rival's form -> [N, M D] what each node leaves of each truth."""
        stage = self.stage(logs, repeats[: len(logs)])
        return self._compare(stage, round(float(repeats.sum())))

    def _whiten(self, rows: int, block: int) -> Whitening:
        if (rows, block) not in self._white:
            self._white[rows, block] = make_white(self.scene, rows, block, self.outputs)
        return self._white[rows, block]

    def stage(self, logs: Sequence[Log], repeats: Array) -> Staged:
        """Return logs of one length, each done so many times."""
        period_s = self.scene.plan.sample_period_s
        block = max(1, round(logs[0].lasts_s / self.rows / period_s))
        step_s = block * period_s
        courses = [follow(log, self.limits, step_s, self.limits.start_degC) for log in logs]
        signals = make_signals(self.scene, logs, courses)
        rows = signals.elapsed_s.shape[1]
        return Staged(signals, step_s, self._whiten(rows, block), np.sqrt(repeats))

    def stage_run(self, run: Run) -> Staged:
        """Return a log that there is, its signals averaged over blocks."""
        block = max(1, len(run) // ROWS_BEFORE)
        rows = len(run) // block
        read = read_signals(run, self.scene.plan)

        def thin(x: Array) -> Array:
            return np.asarray(x[: rows * block].reshape(rows, block).mean(axis=1)[None])

        signals = replace(
            read,
            temperature_degC=thin(read.temperature_degC),
            elapsed_s=thin(read.elapsed_s),
            clock_s=thin(read.clock_s),
            load={name: thin(x) for name, x in read.load.items()},
            saturated={name: thin(x) for name, x in read.saturated.items()},
            channels={name: thin(x) for name, x in read.channels.items()},
        )
        period_s = block * self.scene.plan.sample_period_s
        return Staged(signals, period_s, self._whiten(rows, block), np.ones(1))

    def list_seen(self, stage: Staged, terms: Sequence[Term]) -> list[list[int]]:
        """Return, per output, the indices of the features that it sees."""
        ops = NumpyOperations(stage.period_s, stage.signals.temperature_degC.shape)
        features = build_features(ops, stage.signals, terms, self.scene.order)[1:]
        names = [self.scene.plan.outputs[place] for place in self.outputs]
        return [[j for j, f in enumerate(features) if f.output in (None, name)] for name in names]

    def lay_columns(
        self, stage: Staged, terms: Sequence[Term], *, whiten: bool = True
    ) -> list[Array]:
        """Return, per output, the columns [rows, J'] that it sees, whitened or as they are.

        As they are, each log's mean is taken off, as a tare does.
        """
        shape = stage.signals.temperature_degC.shape
        ops = NumpyOperations(stage.period_s, shape)
        features = build_features(ops, stage.signals, terms, self.scene.order)[1:]
        columns = np.stack([np.broadcast_to(f.signal, shape) for f in features], axis=-1)
        columns = columns * stage.weight[:, None, None]
        found = []
        for k, place in enumerate(self.outputs):
            name = self.scene.plan.outputs[place]
            seen = [j for j, f in enumerate(features) if f.output in (None, name)]
            mine = columns[..., seen]
            mine = (
                stage.white.whiten(mine, k) if whiten else mine - mine.mean(axis=1, keepdims=True)
            )
            found.append(mine.reshape(-1, len(seen)))
        return found

    def _truth(self, stage: Staged, truth: Truth) -> list[Array]:
        """Return, per output, the whitened drift [rows] of a truth."""
        shape = stage.signals.temperature_degC.shape
        ops = NumpyOperations(stage.period_s, shape)
        features = build_features(ops, stage.signals, truth.terms, self.scene.order)[1:]
        columns = np.stack([np.broadcast_to(f.signal, shape) for f in features], axis=-1)
        found = []
        for k, place in enumerate(self.outputs):
            name = self.scene.plan.outputs[place]
            seen = [f.output in (None, name) for f in features]
            total = columns @ np.where(seen, truth.coefficients[place, : len(features)], 0.0)
            total = total * stage.weight[:, None]
            found.append(stage.white.whiten(total[..., None], k).reshape(-1))
        return found

    def _lay_out(self, stage: Staged) -> list[_Laid]:
        """Return, per output, what all models and truths are in a stage."""
        contenders = self.scene.contenders
        truths = [self._truth(stage, t) for c in contenders for t in c.truths]
        rivals = (*contenders, *self.scene.outsiders)
        models = [self.scene.base, *(m for c in rivals for form in c.forms for m in form.models)]
        columns = [self.lay_columns(stage, terms) for terms in models]
        return [
            _Laid(np.stack([t[k] for t in truths], axis=1), [c[k] for c in columns])
            for k in range(len(self.outputs))
        ]

    def _weigh_rest(self, stage: Staged, laid: Sequence[_Laid]) -> _Seen:
        """Return what the base leaves of the truths in a stage, as the errors that are told."""
        excess, nats = [], np.zeros(laid[0].truths.shape[1])
        counts = np.repeat(stage.weight**2, stage.white.octave.size)
        octaves = np.tile(stage.white.octave, stage.weight.size)
        for k, one in enumerate(laid):
            squares = _rest(one.models[0][None], one.truths[None])[0] ** 2
            variance = np.tile(stage.white.variance[k], stage.weight.size)
            excess.append(squares.T @ variance / stage.rows / self._floor[k])
            nats += _count_nats(squares * variance[:, None], counts * variance, counts, octaves)
        return _Seen(stage.rows * stage.period_s, np.stack(excess, axis=1), nats)

    def _look_back(self, runs: Sequence[Run]) -> list[_Laid]:
        """Return the logs that there are, made as short as their sums of products allow."""
        stages = [self.stage_run(run) for run in runs]
        laid = [self._lay_out(stage) for stage in stages]
        self._seen = [self._weigh_rest(stage, one) for stage, one in zip(stages, laid, strict=True)]
        shortened = []
        for k in range(len(self.outputs) if laid else 0):
            truths = np.concatenate([one[k].truths for one in laid])
            count = truths.shape[1]
            parts = []
            for m in range(len(laid[0][k].models)):
                both = np.concatenate([one[k].models[m] for one in laid])
                stacked = np.concatenate([both, truths], axis=1)
                parts.append(np.asarray(np.linalg.qr(stacked, mode="r")))
            shortened.append(
                _Laid(np.empty((0, count)), [part[:, :-count] for part in parts])._replace(
                    beside=[part[:, -count:] for part in parts]
                )
            )
        return shortened

    def _compare(self, stage: Staged, logs: int) -> tuple[Told, list[Array]]:
        contenders = self.scene.contenders
        rivals = (*contenders, *self.scene.outsiders)
        draws = len(contenders[0].truths)
        count = len(contenders)
        scale = len(self.scene.plan.outputs) / len(self.outputs)
        laid = self._lay_out(stage)
        gain = np.zeros(count * draws)
        apart = np.full((count * draws, len(rivals)), np.inf)
        nodes = [(r, form) for r, c in enumerate(rivals) for form in c.forms]
        left = [np.zeros((len(form.models), count * draws)) for _, form in nodes]
        for k, one in enumerate(laid):
            before = self._before[k] if self._before else None
            models, truths = one.join(before, 0, 1)
            gain += _leave(models, truths)[0]
            place = 1
            for n, (_, form) in enumerate(nodes):
                size = len(form.models)
                left[n] += _leave(*one.join(before, place, place + size))
                place += size
        for n, (r, form) in enumerate(nodes):
            # Values are shared by the outputs: the nearest one is chosen for all together.
            if logs + self.scene.runs >= form.fewest_runs:
                apart[:, r] = np.minimum(apart[:, r], left[n].min(axis=0))
        apart[np.arange(count * draws), np.repeat(np.arange(count), draws)] = np.inf
        seen = [*self._seen, self._weigh_rest(stage, laid)]
        excess = np.average([s.excess for s in seen], axis=0, weights=[s.lasts_s for s in seen])
        shown = np.repeat([not set(c.effect.needs) <= TIME_ALONE for c in contenders], draws)
        nats = scale * shown * np.sum([s.nats for s in seen], axis=0)
        told = Told(
            scale * gain.reshape(count, draws),
            scale * apart[:, :count].reshape(count, draws, count),
            logs + self.scene.runs,
            excess.reshape(count, draws, -1),
            scale * apart[:, count:].min(axis=1, initial=np.inf).reshape(count, draws),
            nats.reshape(count, draws),
            np.zeros((count, draws, count)),
            len(self.scene.plan.outputs)
            * sum(s.lasts_s for s in seen)
            / self.scene.plan.sample_period_s,
        )
        return told, [scale * squares for squares in left]


def _leave(models: Array, truths: Array) -> Array:
    """Return [N, M] what least squares on models [N, R, p] leaves of truths [N, R, M], squared."""
    return np.asarray((_rest(models, truths) ** 2).sum(axis=1))


def _rest(models: Array, truths: Array) -> Array:
    """Return [N, R, M] what least squares on models [N, R, p] leaves of truths [N, R, M]."""
    norms = np.linalg.norm(models, axis=1, keepdims=True)
    scaled = models / np.where(norms > 0.0, norms, 1.0)
    q, r = np.linalg.qr(scaled)
    # A column that the others span adds nothing; without this it would add what rounding made.
    q = q * (np.abs(np.diagonal(r, axis1=-2, axis2=-1)) > NEGLIGIBLE)[:, None, :]
    return np.asarray(truths - q @ (np.swapaxes(q, -1, -2) @ truths))


def _count_nats(squares: Array, noise: Array, counts: Array, octaves: IntArray) -> Array:
    """Return [M] by how much each octave's noise grows without an effect, in log-likelihood.

    The slowest octaves share a variance until they have coefficients enough, as in `diagnose`.

    Args:
        squares: [R, M] of what is left, summed over logs.
        noise: [R] variance, summed likewise.
        counts: [R] logs.
        octaves: [R] their numbers.
    """
    nats = np.zeros(squares.shape[1])
    band = np.zeros(octaves.size, dtype=np.bool_)
    numbers = np.unique(octaves)
    for number in numbers[::-1]:
        band |= octaves == number
        count = float(counts[band].sum())
        if count < FEWEST_COEFFICIENTS and number != numbers[0]:
            continue
        nats += 0.5 * count * np.log1p(squares[band].sum(axis=0) / noise[band].sum())
        band[:] = False
    return nats


# From the expected figures of a programme to the probability of the right verdict.
#
# `diagnose` names an effect where its gain is sure and the error falls by enough, and alone where
# its rivals stay far enough behind, or are seen to be another effect in disguise. All but the last
# are logistic in the logarithm of the expected figures over what the rules ask for. An effect that
# is not among the open ones is named instead where noise makes up for its expected distance, which
# spreads by twice its root (the log-likelihood ratio of two models of Gaussian noise is so
# distributed; Cox, JRSS B 24 (1962)). Offsets and slopes are a maximum-likelihood fit to 290
# verdicts on simulated sensors (`python -m benchmarks.study_likely`, whose simulator shares no code
# with this one), rounded. The offset for one or two logs is of 29 earlier verdicts; of 40 of this
# version (`python -m benchmarks.study_few_logs`) the likeliest is 2.5, and the one below is less
# likely by 0.2 nats.

APART = (-0.2, 2.4)
"""Offset and slope of being told from the nearest rival."""
NAMED = (1.1, 3.7)
"""Offset and slope of being named at all with enough runs, ..."""
NAMED_OF_FEW = (-0.5, 2.6)
"""... and with fewer, where it may also lose next to nothing in any run, ..."""
NAMED_OF_FEWEST = (2.0, 2.6)
"""... but with one or two, whose pieces are the evidence; the slope is that of few."""
WORTH = (-1.4, 2.9)
"""Offset and slope of lowering the error by enough; in runs left out, by which `diagnose` judges,
it falls by less than is expected of a fit to all."""
MOST = 0.98
"""Not even a large effect is always named rightly."""


def grow(apart: Array, gain: Array) -> Array:
    """Return how far rivals stay behind over what is asked for, as a logarithm."""
    return np.asarray(np.log((apart + 1e-9) / (ALIKE_UNITS + 0.5 * ALIKE_UNLESS_SURE * gain)))


def rise(gain: Array, nats: Array) -> Array:
    """Return the gain over what makes it sure, as a logarithm, by the surer measure."""
    return np.asarray(np.log(np.maximum(gain / SURE_UNITS, nats / SURE_NATS) + 1e-9))


def outgrow(excess: Array) -> Array:
    """Return [M, D] the fall of the squared error over what is worth having, as a logarithm."""
    overall = excess.mean(axis=2) / (WORTHWHILE**-2 - 1.0)
    best = excess.max(axis=2) / (WORTHWHILE_ON_ONE**-2 - 1.0)
    return np.asarray(np.log(np.maximum(overall, best) + 1e-9))


def logistic(offset: float, slope: float, x: Array) -> Array:
    """Return 1 / (1 + exp(-(offset + slope x)))."""
    return np.asarray(1.0 / (1.0 + np.exp(-np.clip(offset + slope * x, -50.0, 50.0))))


def _expect_naming(told: Told) -> Array:
    """Return the probability [M, D] that each truth is named at all, before any other effect."""
    sure = NAMED if told.runs >= ENOUGH_RUNS else NAMED_OF_FEW
    sure = NAMED_OF_FEWEST if told.runs < MANY_RUNS else sure
    named = logistic(*sure, rise(told.gain, told.nats))
    worth = logistic(*WORTH, outgrow(told.excess))
    return np.asarray(MOST * named * worth * ndtr(0.5 * np.sqrt(np.maximum(told.beside, 0.0))))


def tell_disguised(apart: Array, distance: Array, disguised: Array) -> Array:
    """Return the probability that a rival is told from the truth, which may be in disguise.

    One that is seen to be in disguise is no look-alike unless it does better than the truth by
    chance: a difference of two squared errors spreads by twice its root.

    Args:
        apart: probability that it stays far enough behind.
        distance: squared distance of the two, noise units.
        disguised: probability that it is seen to be in disguise.
    """
    behind = ndtr(0.5 * np.sqrt(np.maximum(distance, 0.0)))
    return np.asarray(apart + disguised * np.maximum(behind - apart, 0.0))


def tell_rivals_apart(told: Told) -> Array:
    """Return the probability [M, D, M] that each rival is told from each truth."""
    near = np.isfinite(told.apart)
    distance = np.where(near, told.apart, 1e30)
    apart = logistic(*APART, grow(distance, told.gain[:, :, None]))
    return np.where(near, tell_disguised(apart, distance, told.disguised), 1.0)


def expect_verdicts(told: Told) -> Array:
    """Return the probability [M, D] that each truth is named, and alone."""
    return np.asarray(tell_rivals_apart(told).min(axis=2) * _expect_naming(told))


def expect_pairs(told: Told) -> Array:
    """Return the probability [M, M] that a pair is told apart, whichever is true."""
    one_way = (_expect_naming(told)[:, :, None] * tell_rivals_apart(told)).mean(axis=1)
    return np.asarray(0.5 * (one_way + one_way.T))


def weigh(told: Told) -> float:
    """Return the worth of a programme: the mean probability, and a little for what lies beyond.

    Where all probabilities are nearly 0, the second part still gives the search a direction.
    """
    p = expect_verdicts(told)
    nearest = np.minimum(told.apart.min(axis=2), 1e12)
    further = np.tanh(
        0.1
        * (
            grow(nearest, told.gain)
            + rise(told.gain, told.nats)
            + np.minimum(outgrow(told.excess), 0.0)
        )
    )
    return float(p.mean() + 0.02 * further.mean())
