"""Hysteresis as many play elements side by side (Prandtl-Ishlinskii), followed from turn to turn.

Between two turning points the input is monotone and every element has a closed form, so the loop
runs over turning points only and no step is approximated.
"""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

#: Half-widths of the elements over their mean: a spread that rounds the loop's corners.
ELEMENT_SPREAD: Array = np.exp(0.25 * np.linspace(-1.6, 1.6, 13))


def find_turns(signal: Array) -> NDArray[np.intp]:
    """Return the indices where the signal turns, with its first and last index.

    Movements below 1e-12 of the signal's span are rounding and turn nothing.
    """
    steps = np.diff(signal)
    steps[np.abs(steps) <= 1e-12 * max(float(np.ptp(signal)), 1e-30)] = 0.0
    moving = np.flatnonzero(steps)
    directions = np.sign(steps[moving])
    turns = moving[1:][directions[1:] != directions[:-1]]
    return np.concatenate([[0], turns, [signal.size - 1]]).astype(np.intp)


def _refine_turns(signal: Array, turns: NDArray[np.intp]) -> tuple[Array, Array]:
    """Return where the signal truly turns (in steps, [m]) and how far it gets [m].

    A peak between two grid points is where the parabola through three of them has its vertex; a
    plateau's end and the signal's ends stay as they are.
    """
    inner = turns[1:-1]
    before, at, after = signal[inner - 1], signal[inner], signal[inner + 1]
    sharp = ((before < at) & (at > after)) | ((before > at) & (at < after))
    bend = np.where(sharp, before - 2.0 * at + after, 1.0)
    shift = np.where(sharp, 0.5 * (before - after) / bend, 0.0)
    height = at - 0.25 * (before - after) * shift
    places = np.concatenate([turns[:1], inner + shift, turns[-1:]])
    heights = np.concatenate([signal[turns[:1]], height, signal[turns[-1:]]])
    return places, heights


def play(signal: Array, half_width: float, every: int = 1) -> Array:
    """Return the mean of the play elements around `half_width` driven by the signal [n].

    All elements begin centred, as after a long rest at signal[0]. Only every `every`-th instant is
    returned; the turns are those of the whole signal.

    Source: Brokate and Sprekels, Hysteresis and Phase Transitions (1996), chapter 2.
    """
    wanted = np.arange(0, signal.size, every)
    places, heights = _refine_turns(signal, find_turns(signal))
    place = np.concatenate([wanted.astype(np.float64), places])
    order = np.argsort(place, kind="stable")
    follow = _follow(np.concatenate([signal[wanted], heights])[order], half_width)
    mean = np.empty_like(follow)
    mean[order] = follow
    return mean[: wanted.size]


def _follow(signal: Array, half_width: float) -> Array:
    """Return the mean of the play elements for a signal [n] that turns at its own points only."""
    widths = half_width * ELEMENT_SPREAD / ELEMENT_SPREAD.mean()
    position = np.full(widths.size, signal[0])
    mean = np.empty_like(signal)
    mean[0] = signal[0]
    turns = find_turns(signal)
    for begin, end in zip(turns[:-1].tolist(), turns[1:].tolist(), strict=True):
        stretch = signal[begin + 1 : end + 1, None]
        if signal[end] >= signal[begin]:
            positions = np.maximum(position, stretch - widths)
        else:
            positions = np.minimum(position, stretch + widths)
        mean[begin + 1 : end + 1] = positions.mean(axis=1)
        if end > begin:
            position = positions[-1]
    return mean
