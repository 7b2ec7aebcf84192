"""The input sequences that a model is checked on: the logs, and inputs that logs never have."""

import numpy as np

from zerodrift.base.arrays import Array, IntArray, Mask
from zerodrift.codegen.selftest import limits_of
from zerodrift.export.integer_model import Channel, IntegerModel
from zerodrift.export.reference import Reference
from zerodrift.operations.arithmetic import CodeArray
from zerodrift.operations.tables import NODES, watching_lines

RANDOM_SEED = 20250217
"""Only makes the sequences repeatable; any other would do."""
LONGEST_DRAWN_BITS = 47
"""Of a time between steps, in microseconds: four years."""
_RUN_STEPS = 16
"""In which steps are equal, or not."""
_EDGES_US, _EDGE_EVERY = (0, 1, 2**32, -1, 2**63 - 1), 24
"""Times at which something changes, the largest of 64 bits among them; one every so many steps."""
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
    first, last = _list_ends(model)
    noise = rng.integers(first, last + 1, size=(part, channels))
    within = rng.integers(low.astype(np.int64), high.astype(np.int64) + 1, size=(part, channels))
    noise = np.where(rng.random((part, 1)) < 0.5, noise, within)
    for channel in model.optional:
        lacks = rng.random(part) < MISSING_SHARE
        lacks[:2] = True  # nothing to start from
        none = model.channels[channel].raw_lacks
        noise[lacks, channel] = np.resize(np.array(none, dtype=np.int64), int(lacks.sum()))
    guards = model.guards
    temperature = (guards.temperature_channel, guards.temperature_low, guards.temperature_high)
    for channel, lowest, highest in (temperature, *guards.ranges):
        at = rng.random(part) < EDGE_SHARE
        edges = find_given(model, channel, (lowest - 1, lowest, highest, highest + 1))
        noise[at, channel] = rng.choice(edges, size=int(at.sum()))
    rails = np.where(rng.random((part, channels)) < 0.5, first, last)
    jumps = np.repeat(noise[:: max(part // 40, 1)], max(part // 40, 1), axis=0)[:part]
    span = high - low
    walk = np.cumsum(rng.normal(size=(part, channels)) * span / 50.0, axis=0)
    walk = low - 0.25 * span + np.abs((walk % (3.0 * span)) - 1.5 * span)
    dwell = np.repeat(((low + high) / 2.0)[None], steps - 4 * part, axis=0)
    named = {"noise": noise, "rails": rails, "jumps": jumps, "walk": walk, "constant": dwell}
    return {
        name: tell_times(model, np.clip(np.round(codes), first, last)).astype(model.code_type)
        for name, codes in named.items()
    }


def tell_times(model: IntegerModel, codes: IntArray | Array) -> IntArray:
    """Return codes [T, C] followed by times between steps, where the model is told them.

    Times are the logs' period in one half of the steps, and in the other spread over all powers of
    two up to 2**47 us, with 0 and the largest number there is among them.
    """
    whole = codes.astype(np.int64)
    if not model.variable_step:
        return whole
    rng = np.random.default_rng(RANDOM_SEED + 1)
    row = np.arange(len(codes))
    drawn = np.floor(np.exp2(rng.uniform(0.0, LONGEST_DRAWN_BITS, len(codes)))).astype(np.int64)
    times = np.where((row // _RUN_STEPS) % 2 == 1, model.period_us, drawn)
    edges = row[_EDGE_EVERY // 2 :: _EDGE_EVERY]
    times[edges] = np.resize(np.array(_EDGES_US), edges.size)
    return np.concatenate([whole, times[:, None]], axis=1)


def _list_ends(model: IntegerModel) -> tuple[IntArray, IntArray]:
    """Return the lowest and the highest code [C] that the chip can be given."""
    least = np.array([channel.raw_least for channel in model.channels], dtype=np.int64)
    return least, np.array([channel.raw_most for channel in model.channels], dtype=np.int64)


def find_given(
    model: IntegerModel, channel: int, codes: tuple[int, ...], others: IntArray | None = None
) -> tuple[int, ...]:
    """Return what the chip is given for codes of a channel, or for the nearest beyond them.

    Args:
        model: has the channel.
        channel: its place.
        codes: of the quantity.
        others: [C] what the chip is given of all channels, a cold junction's among them.
    """
    by = model.channels[channel].conversion
    if by is None:
        return codes
    cold = None
    if by.junction is not None and others is not None:
        cold = int(model.convert(others)[by.junction.channel])
    return tuple(int(code) for code in by.find(np.array(codes), cold))


def _list_edges(channel: Channel) -> set[int]:
    """Return the codes at the ends of a channel's type, and at those of its conversion."""
    edges = {channel.raw_least, channel.raw_most}
    by = channel.conversion
    if by is not None and not by.is_plain and by.junction is None:
        for end in (by.begin, by.low, by.high, by.end):
            edges |= {end - 1, end, end + 1}
    return edges


def draw_starts(model: IntegerModel) -> list[CodeArray]:
    """Return short sequences [3, C] whose first readings are at their ends or lacking.

    `settle` is given a first reading once per power-on; a long sequence shows one of them. Each
    channel alone is at the ends of its type and of what the model uses, and lacks its reading
    where a code says so; then all channels together.

    Args:
        model: gives the channels and their calibrated range.
    """
    low, high = (np.array(x, dtype=np.int64) for x in limits_of(model))
    middle = (low + high) // 2
    least, most = _list_ends(model)
    firsts = [least, most]
    for k, channel in enumerate(model.channels):
        codes = {x for x in _list_edges(channel) if channel.raw_least <= x <= channel.raw_most}
        codes |= {int(low[k]), int(high[k]), *channel.raw_lacks}
        firsts += [np.where(np.arange(middle.size) == k, code, middle) for code in sorted(codes)]
    stretches = [np.stack([first, first, middle]) for first in firsts]
    return [tell_times(model, codes).astype(model.code_type) for codes in stretches]


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
        log: [T, C] codes of a log, of which the first 2000 steps are taken, with their times where
            the model is told them.
    """
    told = log[:GOLDEN_LOG_STEPS].astype(np.int64)
    log = told[:, : len(model.channels)]
    limits = [_list_edges(c) for c in model.channels]
    guards = model.guards
    temperature = (guards.temperature_channel, guards.temperature_low, guards.temperature_high)
    for channel, low, high in (temperature, *guards.ranges):
        limits[channel] |= {*find_given(model, channel, (low - 1, low, high, high + 1), log[-1])}
    for channel, (low, high) in enumerate(zip(*limits_of(model), strict=True)):
        limits[channel] |= {low - 1, low, high, high + 1}
    rest = log[-1]
    rows = [rest]
    for k, own in enumerate(model.channels):
        within = sorted(x for x in limits[k] if own.raw_least <= x <= own.raw_most)
        for none in own.raw_lacks:
            within += [none, within[len(within) // 2 if own.conversion else 0], none]
        for code in within:
            rows += [np.where(np.arange(len(rest)) == k, code, rest)] * 2
    at = guards.temperature_channel  # the rate at, and just beyond, its limit, up and down
    now = int(model.convert(rest)[at])
    for change in (guards.rate_max, -guards.rate_max, guards.rate_max + 1, -guards.rate_max - 1):
        (moved,) = find_given(model, at, (now + change,), rest)
        rows += [rest, np.where(np.arange(len(rest)) == at, moved, rest), rest]
    least, most = _list_ends(model)
    rows += [least, most, least, least, most, most]
    share = np.linspace(0.0, 1.0, _RAMP_STEPS)[:, None]
    ramp = np.round(least + share * (most - least)).astype(np.int64)
    codes = tell_times(model, np.clip(np.concatenate([log, np.array(rows), ramp]), least, most))
    codes[: len(told), len(model.channels) :] = told[:, len(model.channels) :]
    return np.concatenate([codes, _search_lines(model, codes)]).astype(model.code_type)


def count_lines(model: IntegerModel, codes: CodeArray) -> Mask:
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
    least, most = _list_ends(model)
    misses = 0
    for _ in range(_LONGEST_SEARCH):
        shape = (_PIECES, _PIECE_STEPS, len(low))
        wild = rng.random((_PIECES, 1, 1)) < 0.5
        pieces = rng.integers(np.where(wild, least, low), np.where(wild, most, high) + 1, shape)
        pick = rng.random((_PIECES, 1, 1))
        ends = np.where(rng.random(shape) < 0.5, least, most)
        pieces = np.where(pick < 0.3, pieces[:, :1], np.where(pick < 0.5, ends, pieces))
        pieces = np.where((pick > 0.4) & (pick < 0.5), pieces[:, :1], pieces)
        if model.variable_step:
            times = np.full((*shape[:2], 1), model.period_us)
            pieces = np.concatenate([pieces, times], axis=2)
        read = np.zeros((_PIECES, NODES - 1), dtype=bool)

        def note(index: IntArray, read: Mask = read) -> None:
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
