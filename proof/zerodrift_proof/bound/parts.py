"""The parts of what an LSTM's features can be, over each of which its error is bounded by itself.

docs/reference/error-bound.md states which part is halved next; the bound holds whatever they are,
as long as they cover all. Shares no code with what derived the bound first and needs the standard
library only.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import exp, tanh

Part = list[tuple[int, int]]
"""The first and last integer of every feature."""

CUTS = 48
FAR = 40.0


@dataclass(frozen=True)
class GateLine:
    """What a gate's argument is of, in floating point."""

    bias: float
    slopes: list[float]
    """Of each feature's integers, in real arithmetic."""
    around: float
    """What the states move it by at most, to either side."""
    wrong: float
    """By how much the chip's bias is larger."""
    wrongs: list[float]
    """By how much its slopes are."""
    apart: float
    """What else the two are apart by."""


@dataclass(frozen=True)
class Badness:
    """Of a part: what its steps lead to, roughly."""

    size: float
    added: float
    per_size: float
    top: float
    of_top: float


def list_parts(lines: Sequence[GateLine], whole: Part) -> list[Part]:
    """Return parts that together are the whole.

    Args:
        lines: of the gates i, f, g, o.
        whole: what the features can be.
    """
    found: list[tuple[Part, Badness]] = [(whole, _rate(lines, whole))]
    for cut in range(CUTS):
        turn = cut % 6
        size = max(bad.size for _, bad in found)
        if turn == 0:
            rated = [bad.size for _, bad in found]
        else:
            rated = [bad.added + bad.per_size * size for _, bad in found]
        if turn == 3:
            highest = max(rated)
            rated = [bad.top * highest + bad.of_top for _, bad in found]
        place = rated.index(max(rated))
        part, _ = found.pop(place)
        moving = lines[3:] if turn == 3 else lines[:3]
        for half in reversed(_halve(moving, part)):
            found.insert(place, (half, _rate(lines, half)))
    return [part for part, _ in found]


def _halve(lines: Sequence[GateLine], part: Part) -> list[Part]:
    """Return both halves by the feature that the arguments differ most by."""
    widths = [
        (last - first) * sum(abs(line.slopes[k]) for line in lines)
        for k, (first, last) in enumerate(part)
    ]
    k = widths.index(max(widths))
    first, last = part[k]
    if first == last:
        return [part]
    lower, upper = list(part), list(part)
    lower[k], upper[k] = (first, (first + last) // 2), ((first + last) // 2 + 1, last)
    return [lower, upper]


def _rate(lines: Sequence[GateLine], part: Part) -> Badness:
    ends, offs = [], []
    for line in lines:
        products = [sorted((w * a, w * b)) for w, (a, b) in zip(line.slopes, part, strict=True)]
        low, high = line.bias - line.around, line.bias + line.around
        ends.append((low + sum(p[0] for p in products), high + sum(p[1] for p in products)))
        gaps = [sorted((w * a, w * b)) for w, (a, b) in zip(line.wrongs, part, strict=True)]
        down, up = (line.wrong + sum(gap[k] for gap in gaps) for k in (0, 1))
        offs.append(max(abs(down), abs(up)) + line.apart)
    through = 1.0 + exp(min(ends[1][1], FAR))
    input_top, candidate_top = _sigmoid(ends[0][1]), max(abs(tanh(end)) for end in ends[2])
    input_off = _steepest(ends[0], 0.5) / 4.0 * offs[0] + 2.0**-15
    candidate_off = _steepest(ends[2], 1.0) * offs[2] + 2.0**-14
    return Badness(
        through * input_top * candidate_top,
        through * (input_top * candidate_off + candidate_top * input_off),
        offs[1] + 2.0**-14,
        _sigmoid(ends[3][1]),
        _steepest(ends[3], 0.5) / 4.0 * offs[3],
    )


def _sigmoid(x: float) -> float:
    return 1.0 / (1.0 + exp(min(-x, FAR)))


def _steepest(ends: tuple[float, float], share: float) -> float:
    nearest = max(ends[0] * share, -ends[1] * share, 0.0)
    return 1.0 - tanh(nearest) ** 2
