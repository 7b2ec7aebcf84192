"""The gate: whether the firmware matches the float model on held-out runs, and improves the drift.

Per output, on rows inside the calibrated ranges, the integer model must not be worse than no
compensation, than the physical model alone, or than the float model by more than rounding explains;
over all rows it must not be worse than no compensation. What fails is not written.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import NDArray

from zerodrift.c_runtime.host import HostModel
from zerodrift.dataset.runs import Dataset, Run
from zerodrift.diagnosis.held_out import TEST_LOGS
from zerodrift.diagnosis.run_errors import FindUsable
from zerodrift.export.encoding import find_held
from zerodrift.export.float_model import FloatModel
from zerodrift.verify.chip_error import ChipReplay, replay_runs
from zerodrift.verify.contrast import (
    FEWEST_RUNS,
    WORSE,
    contrast_errors,
    measure_correlation,
)
from zerodrift.verify.excursions import Excursion, list_excursions
from zerodrift.verify.left_out import LeftOut
from zerodrift.verify.summary import ChipError, Statement

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

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
    """What several models predict for the same runs, beside the chip."""

    chip: Sequence[Array]
    """[n, K] per run."""
    floating: Sequence[Array]
    physics: Sequence[Array] | None
    """Of the physical model alone; None where nothing was learnt beside it."""


@dataclass(frozen=True)
class _Pool:
    """Errors of one output by run, on rows that count."""

    groups: tuple[str, ...]
    chip: tuple[Array, ...]
    """[n] per run."""
    none: tuple[Array, ...]
    physics: tuple[Array, ...] | None
    floating: tuple[Array, ...]

    @property
    def rows(self) -> int:
        """Number of rows."""
        return sum(part.size for part in self.chip)


def judge_firmware(
    model: FloatModel, host: HostModel, dataset: Dataset, left_out: LeftOut | None
) -> tuple[GateVerdict, ChipReplay]:
    """Return whether the firmware may be written, and the rows that say so.

    Args:
        model: the float model.
        host: the integer model's C, shown equal to the reference.
        dataset: its logs; the test runs are the held-out ones.
        left_out: without those, what models say of each training run that did not learn from it;
            None of a network, which is judged on test logs alone.
    """
    runs = dataset.test or dataset.train
    replay = replay_runs(model, host, runs)
    method, covered = TEST_LOGS, None
    if dataset.test:
        answers = Answers(
            [r.chip for r in replay.runs],
            [r.floating for r in replay.runs],
            None if model.physics is None else model.physics.predict_all_on_chip(runs),
        )
    else:
        if left_out is None:
            why = "no test logs are configured, and a network is judged on those alone"
            return leave_unjudged(replay, f"{why}. Record a test run."), replay
        differences = [r.difference for r in replay.runs]
        answers = Answers(
            [x + d for x, d in zip(left_out.floating, differences, strict=True)],
            left_out.floating,
            left_out.physics,
        )
        method, covered = left_out.method, left_out.covered
    verdict = judge(
        replay,
        list_excursions(replay, dataset.train),
        answers,
        list(zip(dataset.outputs, dataset.units, strict=True)),
        method=method,
        tared=model.tared,
        find_usable=model.find_usable,
        covered=covered,
    )
    return verdict, replay


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
            found, told = _judge_inside(pool, name, unit, float(replay.budget[k]), split[k], replay)
            refused += found
            warnings += told
        if excursions:
            refused += _judge_all(_collect(runs, answers, usable, k, tared), name, unit, excursions)
    return GateVerdict(
        method=method,
        refused=tuple(refused),
        warnings=tuple(dict.fromkeys(warnings)),
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
        pick(gather(None)),
        None if answers.physics is None else pick(gather(answers.physics)),
        pick(gather(answers.floating)),
    )


def _judge_inside(
    pool: _Pool, name: str, unit: str, budget: float, split: ChipError, replay: ChipReplay
) -> tuple[list[Statement], list[Statement]]:
    """Return refusals and warnings for the rows inside the calibrated ranges."""
    refused, warnings = [], []
    own = _rms(pool.chip)
    others = [("worse_than_none", "without compensation it is", pool.none)]
    if pool.physics is not None:
        others.append(("worse_than_physics", "the physical model alone leaves", pool.physics))
    lengths = [measure_correlation(e) for e in pool.chip] if len(others) > 1 else None
    for kind, words, other in others:
        contrast = contrast_errors(pool.chip, other, lengths)
        if contrast.beyond_chance is None:
            warnings.append(
                Statement(
                    kind="few_blocks",
                    output=name,
                    text=(
                        f"{name}: too few independent stretches to tell chance: judged by"
                        f" {100 * WORSE:g} % alone. Record {FEWEST_RUNS} test runs or more."
                    ),
                )
            )
        if not contrast.counts:
            continue
        refused.append(
            Statement(
                kind=kind,
                output=name,
                text=(
                    f"{name}: on rows inside the calibrated ranges the chip's error is {own:.3g}"
                    f" {unit} RMS, {words} {_rms(other):.3g} {unit} ({_count(pool)})."
                    " Look at the logs (`zerodrift compare`), or record more runs."
                ),
            )
        )
    floating = _rms(pool.floating)
    if own**2 > (1.0 + WORSE_THAN_FLOAT) * (floating**2 + budget**2):
        refused.append(
            Statement(
                kind="worse_than_float",
                output=name,
                text=(
                    f"{name}: on rows inside the calibrated ranges the chip errs by {own:.3g}"
                    f" {unit} RMS, the float model by {floating:.3g} {unit}; rounding is budgeted"
                    f" with {budget:.2g} {unit}. {_name_cause(split, name, unit, replay)}"
                ),
            )
        )
    return refused, warnings


def _judge_all(
    pool: _Pool, name: str, unit: str, excursions: Sequence[Excursion]
) -> list[Statement]:
    """Return the refusal where all rows together are worse off than without compensation."""
    if not pool.rows:
        return []
    own, none = _rms(pool.chip), _rms(pool.none)
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


def _name_cause(split: ChipError, name: str, unit: str, replay: ChipReplay) -> str:
    """Return what the largest part of the difference is, and what to do about it."""
    parts = asdict(split)
    parts.pop("out_of_range")
    worst = max(parts, key=lambda part: parts[part])
    k = [output.name for output in replay.model.outputs].index(name)
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
            f"The correction stands at its limit ({split.clamped:.2g} {unit} of it): the training"
            " runs drift less than these."
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
