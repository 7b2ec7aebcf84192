"""The gate: whether the firmware matches the float model on held-out runs, and improves the drift.

Per output, on rows inside the calibrated ranges, the integer model must not be worse than any
baseline: no compensation, a constant, a line in temperature, the physical model alone. Where it is
not shown to be better than each, that is told. Nor may it be worse than the float model by more
than rounding explains, or, over all rows, than no compensation. What fails is not written.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import stdtr

from zerodrift.base.arrays import Array, Mask
from zerodrift.c_runtime.host import HostModel
from zerodrift.dataset.chip_codes import MEASURED
from zerodrift.dataset.runs import Dataset, Run
from zerodrift.diagnosis.baselines import fit_baselines
from zerodrift.diagnosis.held_out import TEST_LOGS
from zerodrift.diagnosis.run_errors import FindUsable
from zerodrift.export.encoding import find_held
from zerodrift.export.float_model import FloatModel
from zerodrift.export.integer_model import Channel, IntegerModel
from zerodrift.verify.chip_error import BEYOND_ROUNDING, RATE, ChipReplay, replay_runs
from zerodrift.verify.left_out import LeftOut
from zerodrift.verify.summary import ChipError, Statement

# Two models' errors on the same rows: whether one is worse, or shown to be better.
#
# What is compared is, run by run, the contrast of two squared errors: their difference over their
# sum, from -1 (ours is nothing beside theirs) over 0 (alike) to 1. Where our model errs like the
# other, either sign is as likely, and Student's distribution tells by how much the mean contrast
# may differ from 0. A squared error itself would not do: one run with a large drift would be most
# of its mean and of its spread.

LEVEL = 0.05
"""Chance that is taken of refusing a firmware that errs like all baselines, or of calling one
better that errs like them: the usual level of a test."""
WORSE = 0.05
"""Share by which the squared error has to exceed the other's, all rows together, to be worth a
refusal: 2.5 % of the error itself."""
FEWEST_RUNS = 3
"""Runs from which they themselves say whether the error is larger; of fewer, blocks of them do."""
UNCORRELATED = 0.05
"""The residual's correlation is summed up to the lag at which it falls below this."""


@dataclass(frozen=True)
class Contrast:
    """Two models' errors on the same rows."""

    ratio: float
    """Our squared error over theirs, all rows together."""
    chance_if_alike: float
    """Probability of a mean contrast so large where our model errs like the other."""
    chance_of_better: float
    """Probability of a mean contrast so small where it does, by runs alone."""
    runs: int
    runs_worse: int
    """In which our squared error is the larger one."""

    @property
    def is_worse(self) -> bool:
        """Whether our squared error exceeds theirs by more than WORSE."""
        return self.ratio > 1.0 + WORSE

    @property
    def is_shown_better(self) -> bool:
        """Whether ours is smaller over all rows, and by more than chance in the runs."""
        return self.ratio < 1.0 and self.chance_of_better <= LEVEL


def contrast_errors(
    ours: Sequence[Array], theirs: Sequence[Array], lengths: Sequence[int] | None = None
) -> Contrast:
    """Return how our errors differ from another model's.

    To be worse on the very runs that were held out is enough: where there are fewer than three of
    them, blocks longer than the residual's correlation speak for these runs. To be better is said
    of runs to come: only whole runs count for it.

    Args:
        ours: errors [n] per run, n > 0.
        theirs: errors [n] of the same rows.
        lengths: what `measure_correlation` says of ours, where it is known.
    """
    squares = [(float(a @ a), float(b @ b)) for a, b in zip(ours, theirs, strict=True)]
    own, other = (sum(part) for part in zip(*squares, strict=True))
    by_run = np.array([_contrast(a, b) for a, b in squares])
    units = by_run
    if len(ours) < FEWEST_RUNS:
        if lengths is None:
            lengths = [measure_correlation(e) for e in ours]
        units = np.concatenate(
            [_contrast_blocks(*parts) for parts in zip(ours, theirs, lengths, strict=True)]
        )
    return Contrast(
        ratio=own / other if other > 0.0 else (math.inf if own > 0.0 else 1.0),
        chance_if_alike=find_chance(units),
        chance_of_better=find_chance(-by_run),
        runs=len(ours),
        runs_worse=int((by_run > 0.0).sum()),
    )


def find_chance(contrasts: Array) -> float:
    """Return the chance of a mean so large among contrasts [n] of models that err alike.

    Of two contrasts or more by Student's distribution of n - 1 degrees of freedom. A single one has
    no spread; its two squares count as one degree of freedom each, whose ratio follows Fisher's
    F(1, 1): errors 13 times as large, squares 161 times, come by a chance of 5 %.
    """
    count = contrasts.size
    mean = float(contrasts.mean())
    if count == 1:
        bounded = min(max(mean, -1.0), 1.0)
        root = math.sqrt((1.0 + bounded) / (1.0 - bounded)) if bounded < 1.0 else math.inf
        return 1.0 - 2.0 / math.pi * math.atan(root)
    error = float(contrasts.std(ddof=1)) / math.sqrt(count)
    if error == 0.0:
        return 0.0 if mean > 0.0 else 1.0
    return float(stdtr(count - 1, -mean / error))


def hold_jointly(chances: Sequence[float]) -> list[bool]:
    """Return which of several hypotheses fall, at most LEVEL being the chance that a true one does.

    The smallest chance is held against LEVEL over their number, the next against LEVEL over one
    less, and so on up to the first that stands, however they depend on each other.

    Source: Holm, Scandinavian Journal of Statistics 6 (1979) 65.
    """
    falls = [False] * len(chances)
    for place, i in enumerate(sorted(range(len(chances)), key=lambda i: chances[i])):
        if chances[i] > LEVEL / (len(chances) - place):
            break
        falls[i] = True
    return falls


def measure_correlation(residual: Array) -> int:
    """Return a length in samples beyond which a residual [n] is no longer correlated with itself.

    It is twice the sum of the autocorrelation on both sides, up to where that is lost in noise. The
    mean stays in: an offset lasts as long as the run.
    """
    x, count = residual, residual.size
    power = float(x @ x)
    if count < 2 or power == 0.0:
        return max(int(count), 1)
    spectrum = np.fft.rfft(x, 2 * count)
    lags = np.fft.irfft(spectrum * np.conj(spectrum))[:count] / power
    below = np.flatnonzero(lags < UNCORRELATED)
    end = int(below[0]) if below.size else count
    return min(int(count), math.ceil(2.0 * (1.0 + 2.0 * float(lags[1:end].sum()))))


def _contrast(own: float, other: float) -> float:
    """Return the difference of two squared errors over their sum."""
    return (own - other) / (own + other) if own + other > 0.0 else 0.0


def _contrast_blocks(ours: Array, theirs: Array, length: int) -> Array:
    """Return the contrasts [B] of equal blocks of at least `length` samples.

    Fewer samples than two blocks are one. The first blocks have one sample more than the others
    where they cannot all be equal, as `numpy.array_split` cuts them.
    """
    own, other = (_sum_blocks(e**2, length) for e in (ours, theirs))
    return np.array([_contrast(a, b) for a, b in zip(own, other, strict=True)])


def _sum_blocks(part: Array, length: int) -> Array:
    """Return the sums over the blocks of a part [n]."""
    count = max(1, part.size // max(length, 1))
    size, longer = divmod(part.size, count)
    starts = np.arange(count) * size + np.minimum(np.arange(count), longer)
    return np.asarray(np.add.reduceat(part, starts))


# Where held-out runs leave the ranges that the training runs calibrated: run, channel, time.

TEMPERATURE = "temperature_degC"
KELVIN_APART = 150.0
"""K beyond the calibrated range from which a log is rather in kelvin than so hot."""


@dataclass(frozen=True)
class Excursion:
    """One run that leaves one calibrated range on one side."""

    run: str
    channel: str
    """Of the model, or "rate"."""
    unit: str
    side: str
    """above | below."""
    beyond: float
    """How far from the calibrated range, in the channel's unit."""
    reach: float
    """The value furthest from it."""
    from_s: float
    """The log's time of the first such row."""
    rows: int

    def __str__(self) -> str:
        """Return it as a sentence that says what to record."""
        place = f"from {self.from_s:g} s"
        if self.channel == RATE:
            return (
                f"{self.run} changes its temperature faster than any training run, by"
                f" {self.beyond:.2g} {self.unit}, {place}; record changes up to"
                f" {self.reach:.2g} {self.unit}"
            )
        whose = "" if self.unit == "K" else f" of {self.channel}"
        unit = "degC" if self.unit == "K" else self.unit
        end = np.ceil if self.side == "above" else np.floor
        reach = end(self.reach) if self.unit == "K" else self.reach
        if self.unit == "K" and self.beyond > KELVIN_APART:
            return (
                f"{self.run} leaves the calibrated range by {self.beyond:.3g} K {place}, to"
                f" {self.reach:.4g} degC; if it is in kelvin, subtract 273.15"
            )
        towards = "up to" if self.side == "above" else "down to"
        return (
            f"{self.run} leaves the calibrated range{whose} by {self.beyond:.3g} {self.unit}"
            f" {place}; record {towards} {reach:.4g} {unit}"
        )


def list_excursions(replay: ChipReplay, train: Sequence[Run]) -> tuple[Excursion, ...]:
    """Return where the replayed runs leave the ranges of the training runs.

    Args:
        replay: the held-out runs.
        train: what was calibrated on.
    """
    found = []
    for name in dict.fromkeys(channel for r in replay.runs for channel in r.outside):
        low, high, unit = _find_range(replay.model, name, train)
        for group in dict.fromkeys(r.run.group for r in replay.runs):
            own = [r for r in replay.runs if r.run.group == group and r.outside[name].any()]
            if not own:
                continue
            values = np.concatenate(
                [_read(replay.model, name, r.run)[r.outside[name]] for r in own]
            )
            times = np.concatenate([r.run.time_s[r.outside[name]] for r in own])
            for side, beyond in (("above", values - high), ("below", low - values)):
                rows = beyond > 0.0
                if rows.any():
                    worst = int(np.argmax(beyond))
                    found.append(
                        Excursion(
                            run=group,
                            channel=name,
                            unit=unit,
                            side=side,
                            beyond=float(beyond[worst]),
                            reach=float(values[worst]),
                            from_s=float(times[rows].min()),
                            rows=int(rows.sum()),
                        )
                    )
    return tuple(found)


def _find_range(model: IntegerModel, name: str, train: Sequence[Run]) -> tuple[float, float, str]:
    """Return lowest, highest and unit of a channel over the training runs."""
    channel = next((c for c in model.channels if c.name == name), None)
    if channel is not None and channel.source.startswith(MEASURED):
        k = _find_output(model, channel)
        values = np.concatenate([run.reference[:, k] for run in train])
    else:
        values = np.concatenate([_read(model, name, run) for run in train])
    unit = "K per step" if channel is None else channel.unit
    return float(values.min()), float(values.max()), "K" if unit == "degC" else unit


def _read(model: IntegerModel, name: str, run: Run) -> Array:
    """Return the values [n] of a channel as they were logged; of a load, its reference."""
    if name == RATE:
        steps = np.abs(np.diff(run.temperature_degC, prepend=run.temperature_degC[:1]))
        return np.asarray(steps)
    channel = next(c for c in model.channels if c.name == name)
    if channel.source == TEMPERATURE:
        return run.temperature_degC
    if channel.source.startswith(MEASURED):
        return np.asarray(run.reference[:, _find_output(model, channel)])
    return run.inputs[channel.source]


def _find_output(model: IntegerModel, channel: Channel) -> int:
    names = [output.name for output in model.outputs]
    return names.index(channel.source.removeprefix(MEASURED))


# The gate: whether the firmware matches the float model on held-out runs, and improves the drift.

WORSE_THAN_FLOAT = 0.10
"""Share by which it may exceed the float model's and the budgeted rounding's together."""
FEWEST_ROWS = 30
"""Rows inside the calibrated ranges from which an output is judged."""

NOT_JUDGED = "not judged"


@dataclass(frozen=True)
class GateVerdict:
    """What the gate found."""

    method: str
    """test logs | leave one run out | blocks of one run | not judged."""
    refused: tuple[Statement, ...]
    """Why the firmware is not to be written; empty: it may be."""
    warnings: tuple[Statement, ...]
    chip_error: tuple[ChipError, ...]
    """Of each output, over all replayed rows."""
    excursions: tuple[Excursion, ...]
    rows: int
    """Rows that were judged, those inside the calibrated ranges."""

    @property
    def passes(self) -> bool:
        """Whether the firmware may be written: there is no refusal."""
        return not self.refused

    def explain(self) -> str:
        """Return the refusals as one message."""
        lines = "\n  ".join(statement.text for statement in self.refused)
        return f"the firmware is refused:\n  {lines}"


@dataclass(frozen=True)
class Answers:
    """What several models predict for the same runs."""

    chip: Sequence[Array]
    """[n, K] per run."""
    floating: Sequence[Array]
    baselines: Mapping[str, Sequence[Array] | None]
    """Kind of the refusal -> [n, K] per run; None: no compensation. Fitted to what `chip` is."""


NONE, CONSTANT, LINE, PHYSICS = (
    f"worse_than_{name}" for name in ("none", "constant", "line", "physics")
)
WORDS = {
    NONE: "no compensation",
    CONSTANT: "the mean of the training runs",
    LINE: "a line in temperature",
    PHYSICS: "the physical model alone",
}
"""Kind of the refusal -> the baseline."""


@dataclass(frozen=True)
class _Pool:
    """Errors of one output by run, on rows that count."""

    groups: tuple[str, ...]
    chip: tuple[Array, ...]
    """[n] per run."""
    floating: tuple[Array, ...]
    baselines: Mapping[str, tuple[Array, ...]]
    """Kind of the refusal -> [n] per run; no compensation among them."""

    @property
    def rows(self) -> int:
        """Number of rows."""
        return sum(part.size for part in self.chip)


@dataclass(frozen=True)
class _BaselineTrial:
    """One output held against one baseline."""

    output: int
    kind: str
    contrast: Contrast
    left: float
    """RMSE of the baseline."""


def judge_firmware(
    model: FloatModel, host: HostModel, dataset: Dataset, left_out: LeftOut | None
) -> tuple[GateVerdict, ChipReplay]:
    """Return whether the firmware may be written, and the rows that say so.

    A tare that the project states is taken off every run's errors. One that was only inferred from
    the logs excuses nothing: where it alone would let the firmware pass, or stop it, that is the
    verdict.

    Args:
        model: the float model.
        host: the integer model's C, shown equal to the reference.
        dataset: its logs; the test runs are the held-out ones.
        left_out: without those, what models say of each training run that did not learn from it;
            None of a network, which is judged on test logs alone.
    """
    runs = dataset.test or dataset.train
    replay = replay_runs(model, host, runs)
    if not dataset.test and left_out is None:
        why = "no test logs are configured, and a network is judged on those alone"
        return leave_unjudged(replay, f"{why}. Record a test run."), replay

    def judge_with(tared: bool) -> GateVerdict:
        return judge(
            replay,
            list_excursions(replay, dataset.train),
            _collect_answers(model, dataset, replay, left_out, tared=tared),
            list(zip(dataset.outputs, dataset.units, strict=True)),
            method=TEST_LOGS if left_out is None or dataset.test else left_out.method,
            tared=tared,
            find_usable=model.find_usable,
            covered=None if left_out is None or dataset.test else left_out.covered,
        )

    if not model.tared or dataset.train[0].tared:
        return judge_with(model.tared), replay
    return ask_for_tare(judge_with(True), judge_with(False)), replay


def ask_for_tare(tared: GateVerdict, shared: GateVerdict) -> GateVerdict:
    """Return the verdict where the logs were only guessed to be tared.

    Args:
        tared: with each run's own offset taken off.
        shared: with the offsets as errors, as the chip is used.
    """
    guess = (
        "[logs] tared is not stated in zerodrift.toml, and the runs look as if each log had been"
        " zeroed by itself"
    )
    if tared.passes == shared.passes:
        known = {(one.kind, one.output) for one in tared.warnings}
        outputs = [w.output for w in shared.warnings if (w.kind, w.output) not in known]
        if not shared.passes or not outputs:
            return shared
        text = (
            f"{guess}. If that is wrong, each run's own offset is an error of the chip, which is"
            f" then not shown to be better than the simplest compensators in {', '.join(outputs)}:"
            " state tared = true or false."
        )
        return replace(tared, warnings=(Statement(kind="tare_decides", text=text), *tared.warnings))
    stopped = shared if tared.passes else tared
    gives = {True: "the firmware is written", False: stopped.explain()}
    text = (
        f"{guess}. Only that guess decides whether the firmware is written: state it."
        f"\n  tared = true (each log was zeroed on its own): {gives[tared.passes]}"
        f"\n  tared = false (offsets between runs are errors of the chip): {gives[shared.passes]}"
    )
    return replace(shared, refused=(Statement(kind="tare_decides", text=text),))


def _collect_answers(
    model: FloatModel,
    dataset: Dataset,
    replay: ChipReplay,
    left_out: LeftOut | None,
    *,
    tared: bool,
) -> Answers:
    """Return what chip, float model and baselines predict for the held-out runs."""
    runs = [replayed.run for replayed in replay.runs]
    chip: Sequence[Array] = [r.chip for r in replay.runs]
    floating: Sequence[Array] = [r.floating for r in replay.runs]
    physics: Sequence[Array] | None = None
    if model.physics is not None:
        physics = model.physics.predict_all_on_chip(runs)
    if not dataset.test and left_out is not None:
        floating, physics = left_out.floating, left_out.physics
        chip = [x + r.difference for x, r in zip(floating, replay.runs, strict=True)]
    baselines: dict[str, Sequence[Array] | None] = {NONE: None}
    for baseline in fit_baselines(dataset, tared=tared):
        baselines[f"worse_than_{baseline.name}"] = [baseline.held_out[run.name] for run in runs]
    if physics is not None:
        baselines[PHYSICS] = physics
    return Answers(chip, floating, baselines)


def judge(
    replay: ChipReplay,
    excursions: Sequence[Excursion],
    answers: Answers,
    names: Sequence[tuple[str, str]],
    *,
    method: str,
    tared: bool,
    find_usable: FindUsable | None = None,
    covered: Sequence[Mask] | None = None,
) -> GateVerdict:
    """Return whether the firmware may be written.

    Args:
        replay: integer and float model over the held-out runs.
        excursions: where these leave the calibrated ranges.
        answers: what is judged: `replay`'s own answers, or those of models that left a run out.
        names: name and unit of each output.
        method: what the runs are.
        tared: each log has an offset of its own, which is taken off every error.
        find_usable: run -> [n, K] samples that count; None: all.
        covered: [n] per run: rows that are inside for a model that left the run out; None: all.
    """
    runs = [replayed.run for replayed in replay.runs]
    usable = [
        np.ones(run.drift.shape, np.bool_) if find_usable is None else find_usable(run)
        for run in runs
    ]
    inside = [u & r.inside for u, r in zip(usable, replay.runs, strict=True)]
    if covered is not None:
        inside = [rows & own[:, None] for rows, own in zip(inside, covered, strict=True)]
    split = replay.split()
    refused: list[Statement] = []
    warnings = [Statement(kind="out_of_range", text=f"{excursion}.") for excursion in excursions]
    pools: dict[int, _Pool] = {}
    for k, (name, unit) in enumerate(names):
        pool = _collect(runs, answers, inside, k, tared)
        if pool.rows < FEWEST_ROWS:
            warnings.append(
                Statement(
                    kind="not_judged",
                    output=name,
                    text=(
                        f"{name}: not judged, for {pool.rows} rows of the held-out runs lie inside"
                        f" the calibrated ranges; {FEWEST_ROWS} are needed."
                    ),
                )
            )
        else:
            pools[k] = pool
            refused += _judge_by_float(pool, name, unit, split[k], replay)
        if excursions:
            refused += _judge_all(_collect(runs, answers, usable, k, tared), name, unit, excursions)
    worse, unproven = _judge_by_baselines(pools, names, replay)
    return GateVerdict(
        method=method,
        refused=(*worse, *refused),
        warnings=(*warnings, *unproven),
        chip_error=split,
        excursions=tuple(excursions),
        rows=max((int(sum(m[:, k].sum() for m in inside)) for k in range(len(names))), default=0),
    )


def leave_unjudged(replay: ChipReplay, why: str) -> GateVerdict:
    """Return the verdict where no run was held out: chip against float, and a warning."""
    statement = Statement(kind="not_judged", text=f"not judged on held-out runs: {why}")
    return GateVerdict(NOT_JUDGED, (), (statement,), replay.split(), (), 0)


def _collect(
    runs: Sequence[Run], answers: Answers, counts: Sequence[Mask], k: int, tared: bool
) -> _Pool:
    """Return the errors of output k on the rows that count, without each run's own offset."""
    groups = tuple(dict.fromkeys(run.group for run in runs))

    def gather(predictions: Sequence[Array] | None) -> dict[str, Array]:
        parts: dict[str, list[Array]] = {}
        for i, run in enumerate(runs):
            answer = 0.0 if predictions is None else predictions[i][:, k]
            error = (run.drift[:, k] - answer)[counts[i][:, k]]
            parts.setdefault(run.group, []).append(error)
        whole = {group: np.concatenate(own) for group, own in parts.items()}
        return {g: e - e.mean() if tared and e.size else e for g, e in whole.items()}

    chip = gather(answers.chip)
    kept = tuple(group for group in groups if chip[group].size)

    def pick(errors: Mapping[str, Array]) -> tuple[Array, ...]:
        return tuple(errors[group] for group in kept)

    return _Pool(
        kept,
        pick(chip),
        pick(gather(answers.floating)),
        {kind: pick(gather(own)) for kind, own in answers.baselines.items()},
    )


def _judge_by_baselines(
    pools: Mapping[int, _Pool], names: Sequence[tuple[str, str]], replay: ChipReplay
) -> tuple[list[Statement], list[Statement]]:
    """Return refusals and warnings: worse than a baseline, or not shown to be better.

    All outputs and baselines are held jointly. A baseline that the chip repeats within rounding is
    what was learnt, and no alternative to it; no compensation always is one.

    Args:
        pools: output -> its errors, of those that can be judged.
        names: name and unit of each output.
        replay: says what rounding may cost.
    """
    trials: list[_BaselineTrial] = []
    for k, pool in pools.items():
        lengths = [measure_correlation(e) for e in pool.chip]
        for kind, other in pool.baselines.items():
            apart = [a - b for a, b in zip(pool.chip, other, strict=True)]
            if kind == NONE or _rms(apart) > BEYOND_ROUNDING * float(replay.budget[k]):
                contrast = contrast_errors(pool.chip, other, lengths)
                trials.append(_BaselineTrial(k, kind, contrast, _rms(other)))
    falls = hold_jointly([trial.contrast.chance_if_alike for trial in trials])
    refused, warnings = [], []
    for trial, is_beyond_chance in zip(trials, falls, strict=True):
        if is_beyond_chance and trial.contrast.is_worse:
            (name, unit), pool = names[trial.output], pools[trial.output]
            refused.append(
                Statement(
                    kind=trial.kind,
                    output=name,
                    text=(
                        f"{name}: on rows inside the calibrated ranges the chip leaves"
                        f" {_rms(pool.chip):.3g} {unit} RMS, {WORDS[trial.kind]} {trial.left:.3g}"
                        f" {unit} ({_count(pool)}). Look at the logs (`zerodrift compare`), or"
                        " record more runs."
                    ),
                )
            )
    stopped = {statement.output for statement in refused}
    for k, pool in pools.items():
        name, unit = names[k]
        own = [t for t in trials if t.output == k and not t.contrast.is_shown_better]
        if own and name not in stopped:
            least = min(own, key=lambda trial: trial.left)
            warnings.append(_tell_unproven(least, _rms(pool.chip), name, unit))
    return refused, warnings


def _tell_unproven(trial: _BaselineTrial, chip: float, name: str, unit: str) -> Statement:
    """Return the warning that the chip is not shown to be better than a baseline."""
    found = trial.contrast
    text = (
        f"{name}: not shown to be better than {WORDS[trial.kind]}: the chip leaves {chip:.3g}"
        f" {unit} RMS, {WORDS[trial.kind]} {trial.left:.3g} {unit}, and less than the chip in"
        f" {found.runs_worse} of {found.runs} held-out run{'s' if found.runs > 1 else ''}."
    )
    if found.ratio < 1.0:
        chance = 100.0 * found.chance_of_better
        text += f" Its lead comes by chance with {chance:.2g} %: record more runs."
    else:
        text += " Look at the logs (`zerodrift compare`)."
    return Statement(kind="not_shown_better", output=name, text=text)


def _judge_by_float(
    pool: _Pool, name: str, unit: str, split: ChipError, replay: ChipReplay
) -> list[Statement]:
    """Return the refusal where the chip errs by more than float model and rounding explain."""
    own, floating = _rms(pool.chip), _rms(pool.floating)
    k = [output.name for output in replay.model.outputs].index(name)
    budget = float(replay.budget[k])
    if own**2 <= (1.0 + WORSE_THAN_FLOAT) * (floating**2 + budget**2):
        return []
    text = (
        f"{name}: on rows inside the calibrated ranges the chip errs by {own:.3g} {unit} RMS, the"
        f" float model by {floating:.3g} {unit}; rounding is budgeted with {budget:.2g} {unit}."
        f" {_name_cause(split, k, unit, replay)}"
    )
    return [Statement(kind="worse_than_float", output=name, text=text)]


def _judge_all(
    pool: _Pool, name: str, unit: str, excursions: Sequence[Excursion]
) -> list[Statement]:
    """Return the refusal where all rows together are worse off than without compensation."""
    if not pool.rows:
        return []
    own, none = _rms(pool.chip), _rms(pool.baselines[NONE])
    if own**2 <= (1.0 + WORSE) * none**2:
        return []
    reasons = "; ".join(str(excursion) for excursion in excursions)
    return [
        Statement(
            kind="worse_beyond_range",
            output=name,
            text=(
                f"{name}: over all rows, those outside the calibrated ranges among them, the chip's"
                f" error is {own:.3g} {unit} RMS, without compensation it is {none:.3g} {unit}:"
                f" {reasons}."
            ),
        )
    ]


def _name_cause(split: ChipError, k: int, unit: str, replay: ChipReplay) -> str:
    """Return what the largest part of the difference is, and what to do about it."""
    worst = max(("rounding", "clamped", "saturated"), key=lambda part: getattr(split, part))
    output = replay.model.outputs[k]
    if worst == "rounding":
        if 1.0 / output.lsb_per_unit > replay.budget[k]:
            return (
                f"One count of the output is {1.0 / output.lsb_per_unit:g} {unit}: full_scale ="
                f" {output.full_scale:g} {unit} is too large, or its unit is."
            )
        return f"Rounding costs {split.rounding:.2g} {unit}: use 16-bit weights, or fewer effects."
    if worst == "clamped":
        return (
            f"The correction stands at its limit ({split.clamped:.2g} {unit} of it): the network"
            " answers more here than on the training runs. Train on runs like these, too."
        )
    ends = [
        f"{channel.name} from {find_held(channel)[0]:g} to {find_held(channel)[1]:g} {channel.unit}"
        for i, channel in enumerate(replay.model.channels)
        if any(r.rail[:, i].any() for r in replay.runs)
    ]
    if ends:
        return (
            f"Codes stand at the end of their type ({split.saturated:.2g} {unit} of it): they hold"
            f" {', '.join(ends)}, and these runs go beyond."
        )
    return f"Operations stand at their limits ({split.saturated:.2g} {unit} of it)."


def _rms(parts: Sequence[Array]) -> float:
    count = sum(part.size for part in parts)
    return math.sqrt(sum(float(np.sum(part**2)) for part in parts) / max(count, 1))


def _count(pool: _Pool) -> str:
    many = len(pool.groups)
    return f"{many} run{'s' if many > 1 else ''}, {pool.rows} rows"
