"""The input sequences that a model is checked on: the logs themselves, and what logs never show."""

import numpy as np
from numpy.typing import NDArray

from zerodrift.codegen.selftest import limits_of
from zerodrift.export.integer_model import IntegerModel
from zerodrift.export.reference import Reference
from zerodrift.operations.arithmetic import CodeArray, IntArray
from zerodrift.operations.tables import NODES, watching_lines

RANDOM_SEED = 20250217
"""Only makes the sequences repeatable; any other would do."""
MISSING_SHARE = 0.1
"""Of the noise's codes, where a channel has one that means no reading."""
EDGE_SHARE = 0.04
"""Of the noise's codes, at either end of what is not flagged."""


def draw_sequences(model: IntegerModel, steps: int) -> dict[str, CodeArray]:
    """Return sequences [T, C] of raw codes by name, `steps` in all.

    Noise over everything that the input's type holds and within the calibrated range, with codes
    that mean no reading and those at which a flag changes; jumps, the rails, a slow walk through
    the calibrated range and beyond it, and a long dwell.

    Args:
        model: gives the channels and their calibrated range.
        steps: total number of steps, at least 50.
    """
    rng = np.random.default_rng(RANDOM_SEED)
    part, channels = steps // 5, len(model.channels)
    low, high = (np.array(x, dtype=np.float64) for x in limits_of(model))
    bits = np.array([channel.bits for channel in model.channels])
    first, last = -(1 << (bits - 1)), (1 << (bits - 1)) - 1
    noise = rng.integers(first, last + 1, size=(part, channels))
    within = rng.integers(low.astype(np.int64), high.astype(np.int64) + 1, size=(part, channels))
    noise = np.where(rng.random((part, 1)) < 0.5, noise, within)
    none = np.array([channel.no_reading or 0 for channel in model.channels], dtype=np.int64)
    for channel in model.optional:
        lacks = rng.random(part) < MISSING_SHARE
        lacks[:2] = True  # nothing to start from
        noise[lacks, channel] = none[channel]
    guards = model.guards
    temperature = (guards.temperature_channel, guards.temperature_low, guards.temperature_high)
    for channel, lowest, highest in (temperature, *guards.ranges):
        at = rng.random(part) < EDGE_SHARE
        edges = (lowest - 1, lowest, highest, highest + 1)
        noise[at, channel] = rng.choice(edges, size=int(at.sum()))
    rails = np.where(rng.random((part, channels)) < 0.5, first, last)
    jumps = np.repeat(noise[:: max(part // 40, 1)], max(part // 40, 1), axis=0)[:part]
    span = high - low
    walk = np.cumsum(rng.normal(size=(part, channels)) * span / 50.0, axis=0)
    walk = low - 0.25 * span + np.abs((walk % (3.0 * span)) - 1.5 * span)
    dwell = np.repeat(((low + high) / 2.0)[None], steps - 4 * part, axis=0)
    named = {"noise": noise, "rails": rails, "jumps": jumps, "walk": walk, "constant": dwell}
    return {
        name: np.clip(np.round(codes), first, last).astype(model.code_type)
        for name, codes in named.items()
    }


GOLDEN_LOG_STEPS = 2000
"""Of a log, at the beginning of the golden vectors."""
_RAMP_STEPS = 128
_PIECE_STEPS, _PIECES, _LONGEST_SEARCH = 24, 64, 64
"""The search for lines of the table: steps of a piece, pieces to choose from, pieces at most."""


def draw_golden(model: IntegerModel, log: CodeArray) -> CodeArray:
    """Return the codes [T, C] of the golden vectors, one sequence.

    The log; each input alone and all together at the ends of their types and at either side of
    every limit, with its code for no reading; a ramp over all codes; then pieces of noise, chosen
    so that every line of the activation table is read that can be reached.

    Args:
        model: gives the channels and their limits.
        log: [T, C] codes of a log, of which the first 2000 steps are taken.
    """
    log = log[:GOLDEN_LOG_STEPS].astype(np.int64)
    limits = [{c.least, c.most} for c in model.channels]
    guards = model.guards
    temperature = (guards.temperature_channel, guards.temperature_low, guards.temperature_high)
    for channel, low, high in (temperature, *guards.ranges):
        limits[channel] |= {low - 1, low, high, high + 1}
    for channel, (low, high) in enumerate(zip(*limits_of(model), strict=True)):
        limits[channel] |= {low - 1, low, high, high + 1}
    rest = log[-1]
    rows = [rest]
    for k, own in enumerate(model.channels):
        within = sorted(x for x in limits[k] if own.least <= x <= own.most)
        if own.no_reading is not None:
            within += [own.no_reading, within[0], own.no_reading]
        for code in within:
            rows += [np.where(np.arange(len(rest)) == k, code, rest)] * 2
    at = guards.temperature_channel  # the rate at, and just beyond, its limit, up and down
    for change in (guards.rate_max, -guards.rate_max, guards.rate_max + 1, -guards.rate_max - 1):
        rows += [rest, np.where(np.arange(len(rest)) == at, rest + change, rest), rest]
    least, most = (np.array([getattr(c, end) for c in model.channels]) for end in ("least", "most"))
    rows += [least, most, least, least, most, most]
    share = np.linspace(0.0, 1.0, _RAMP_STEPS)[:, None]
    ramp = np.round(least + share * (most - least)).astype(np.int64)
    codes = np.clip(np.concatenate([log, np.array(rows), ramp]), least, most)
    return np.concatenate([codes, _search_lines(model, codes)]).astype(model.code_type)


def count_lines(model: IntegerModel, codes: CodeArray) -> NDArray[np.bool_]:
    """Return which lines [512] of the activation table a run over codes [T, C] reads."""
    seen = np.zeros(NODES - 1, dtype=bool)
    with watching_lines(lambda index: seen.__setitem__(index.ravel(), True)):
        Reference(model).run(codes[None])
    return seen


def _search_lines(model: IntegerModel, before: IntArray) -> IntArray:
    """Return pieces [T, C] to go on with that read lines of the table which were not read yet."""
    seen = np.zeros(NODES - 1, dtype=bool)
    reference = Reference(model)
    with watching_lines(lambda index: seen.__setitem__(index.ravel(), True)):
        state = reference.run(before[None]).state
    chosen = [before[:0]]
    if not seen.any():
        return chosen[0]
    rng = np.random.default_rng(RANDOM_SEED)
    low, high = (np.array(x) for x in limits_of(model))
    least, most = (np.array([getattr(c, end) for c in model.channels]) for end in ("least", "most"))
    misses = 0
    for _ in range(_LONGEST_SEARCH):
        shape = (_PIECES, _PIECE_STEPS, len(low))
        wild = rng.random((_PIECES, 1, 1)) < 0.5
        pieces = rng.integers(np.where(wild, least, low), np.where(wild, most, high) + 1, shape)
        pick = rng.random((_PIECES, 1, 1))
        ends = np.where(rng.random(shape) < 0.5, least, most)
        pieces = np.where(pick < 0.3, pieces[:, :1], np.where(pick < 0.5, ends, pieces))
        pieces = np.where((pick > 0.4) & (pick < 0.5), pieces[:, :1], pieces)
        read = np.zeros((_PIECES, NODES - 1), dtype=bool)

        def note(index: IntArray, read: NDArray[np.bool_] = read) -> None:
            read[np.arange(_PIECES)[:, None], index.reshape(_PIECES, -1)] = True

        with watching_lines(note):
            reference.run(pieces, state=state.unpack(np.repeat(state.pack(), _PIECES, axis=0)))
        gains = (read & ~seen).sum(axis=1)
        best = int(gains.argmax())
        misses = misses + 1 if gains[best] == 0 else 0
        if misses == 3:
            break
        if gains[best]:
            seen |= read[best]
            chosen.append(pieces[best])
            state = reference.run(pieces[best : best + 1], state=state).state
    return np.concatenate(chosen)
