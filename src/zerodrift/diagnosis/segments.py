"""The stretches of time in which a model is worst, each with what was going on, in words."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from zerodrift.base.arrays import Array, Mask
from zerodrift.dataset.runs import Run
from zerodrift.diagnosis.descriptors import Blocks, cut_blocks, describe
from zerodrift.diagnosis.patterns import find_patterns
from zerodrift.diagnosis.scan import CONCENTRATED, Pattern, Scan

NO_PATTERN = "no pattern found"
CLOSED_GAP = 3
"""Gaps of up to this many blocks within a segment are bridged."""
STANDS_OUT = 1.5
"""A segment is told if its RMSE is this much above the noise floor, and above the output's own."""
STANDS_ALONE = 2.0
"""The same for a segment without a pattern, which may be chance."""
SHORTEST = 30
"""Samples that a segment without a pattern has at least; less is an outlier."""
ALIKE = 2
"""Most segments of one output and one pattern."""
MOST_SEGMENTS = 10


@dataclass(frozen=True)
class Segment:
    """An uninterrupted stretch of one run in which one output is badly off."""

    run: str
    output: str
    from_s: float
    """First sample, on the log's own clock."""
    to_s: float
    """Last sample."""
    rmse: float
    """In the output's unit."""
    mean_error: float
    """What is left on average: measured minus reference minus model."""
    pattern: str
    """In words, or `no pattern found`."""


@dataclass(frozen=True)
class Failures:
    """Where a model fails."""

    worst: tuple[Segment, ...]
    """The worst stretches, by RMSE over full scale, a few of each kind."""
    patterns: tuple[Pattern, ...]


def find_failures(
    runs: Sequence[Sequence[Run]],
    errors: Sequence[Sequence[Array]],
    floor: Array,
    *,
    outputs: Sequence[str],
    units: Sequence[str],
    full_scale: Sequence[float],
    channel_units: Mapping[str, str] | None = None,
    most: int = MOST_SEGMENTS,
) -> Failures:
    """Return the patterns in the errors of these runs, and the worst segments.

    Args:
        runs: the stretches of each run.
        errors: [n, K] of each stretch.
        floor: [K] RMS of the noise.
        outputs: names of the K outputs.
        units: their units.
        full_scale: their full scales, by which segments of different outputs are ranked.
        channel_units: units of the input channels.
        most: how many segments to return.
    """
    blocks = cut_blocks(runs)
    flat = [error for stretches in errors for error in stretches]
    squares = blocks.average([error**2 for error in flat])
    means = blocks.average(flat)
    excess = np.maximum(squares - floor**2, 0.0)
    scan = Scan(describe(blocks, flat, outputs, units, channel_units), blocks.run)
    rmse = np.sqrt(squares.mean(axis=0))
    patterns = find_patterns(scan, means, np.where(rmse > floor, excess, 0.0))
    candidates: list[Segment] = []
    for k, output in enumerate(outputs):
        least = max(STANDS_OUT * float(floor[k]), float(rmse[k]))
        segments: list[Segment] = []
        free = np.ones(blocks.run.size, dtype=np.bool_)
        for pattern in (p for p in patterns if p.output == k):
            held = pattern.blocks
            if pattern.kind != CONCENTRATED:
                held = held & _find_bursts(blocks, np.where(held, squares[:, k], 0.0), least**2)
            segments += _list_segments(blocks, flat, held, k, output, pattern.words)
            free &= ~held
        rest = _find_bursts(blocks, np.where(free, squares[:, k], 0.0), least**2)
        shortest_s = (SHORTEST - 1) * blocks.seconds / blocks.size
        segments += [
            segment
            for segment in _list_segments(blocks, flat, rest, k, output, NO_PATTERN)
            if segment.to_s - segment.from_s >= shortest_s
            and segment.rmse >= STANDS_ALONE * float(floor[k])
        ]
        candidates += [s for s in segments if s.rmse >= least]
    scale = dict(zip(outputs, full_scale, strict=True))
    candidates.sort(key=lambda s: (-s.rmse / scale[s.output], s.run, s.from_s))
    kept: list[Segment] = []
    for segment in candidates:
        kind = (segment.output, segment.pattern)
        if sum((s.output, s.pattern) == kind for s in kept) < ALIKE and len(kept) < most:
            kept.append(segment)
    return Failures(tuple(kept), tuple(patterns))


def _find_bursts(blocks: Blocks, square: Array, level: float) -> Mask:
    """Return in each stretch the interval that exceeds a level most in total, if one does.

    The level is raised to the stretch's own mean, so that a run that is bad throughout is told by
    its worst part.
    """
    found = np.zeros(square.size, dtype=np.bool_)
    for stretch in range(len(blocks.stretches)):
        here = np.flatnonzero(blocks.stretch == stretch)
        own = square[here]
        sums = np.concatenate([[0.0], np.cumsum(own - max(level, float(own.mean())))])
        rise = sums - np.minimum.accumulate(sums)
        stop = int(np.argmax(rise))
        if rise[stop] > 0.0:
            start = int(np.argmin(sums[:stop]))
            found[here[start:stop]] = True
    return found


def _list_segments(
    blocks: Blocks, errors: Sequence[Array], held: Mask, k: int, output: str, words: str
) -> list[Segment]:
    """Return the uninterrupted parts of the blocks that are marked."""
    segments = []
    for number, run in enumerate(blocks.stretches):
        marked = np.flatnonzero(held & (blocks.stretch == number))
        if not marked.size:
            continue
        for part in np.split(marked, np.flatnonzero(np.diff(marked) > CLOSED_GAP) + 1):
            first, last = int(blocks.row[part[0]]), int(blocks.row[part[-1]]) + blocks.size - 1
            error = errors[number][first : last + 1, k]
            segments.append(
                Segment(
                    run.group,
                    output,
                    float(run.time_s[first]),
                    float(run.time_s[last]),
                    float(np.sqrt(np.mean(error**2))),
                    float(error.mean()),
                    words,
                )
            )
    return segments
