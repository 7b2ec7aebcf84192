"""Runs as training sees them, and which are held out while epochs are chosen."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from zerodrift.dataset.runs import Run

# Which training runs are held out while the number of epochs is chosen.

RUNS_PER_HELD_OUT = 5
"""One run in about this many is held out, and at least one."""
LAST_SHARE = 0.25
"""Of a single run this share, its end, is held out."""


@dataclass(frozen=True)
class Split:
    """Training runs in two parts."""

    fit: tuple[Run, ...]
    held_out: tuple[Run, ...]
    """Whole runs; for a single run the stretches that its end lies in."""
    skip: Mapping[str, int]
    """Held-out run's name -> samples at its start that belong to `fit`."""
    explanation: str
    """What was held out, for reports."""


def split_runs(runs: Sequence[Run]) -> Split:
    """Hold out whole runs, those that the others cover best; of a single run, its end.

    A run at the edge of the temperatures is worth more in training: its error, outside of all other
    runs, says little about when to stop.
    """
    groups = list(dict.fromkeys(run.group for run in runs))
    if len(groups) == 1:
        return _split_end(runs)
    count = max(1, round(len(groups) / RUNS_PER_HELD_OUT))
    held = _rank_by_coverage(runs, groups)[:count]
    return Split(
        fit=tuple(run for run in runs if run.group not in held),
        held_out=tuple(run for run in runs if run.group in held),
        skip={},
        explanation="runs held out of training: " + ", ".join(g for g in groups if g in held),
    )


def _rank_by_coverage(runs: Sequence[Run], groups: Sequence[str]) -> list[str]:
    """Return the groups, first those whose leaving out shrinks the others' range the least."""

    def measure_loss(group: str) -> float:
        own = np.concatenate([r.temperature_degC for r in runs if r.group == group])
        others = np.concatenate([r.temperature_degC for r in runs if r.group != group])
        beyond = max(0.0, others.min() - own.min()) + max(0.0, own.max() - others.max())
        # Among runs that lose nothing, the one with the widest range is the best judge.
        return float(beyond if beyond > 0.0 else -np.ptp(own))

    return sorted(groups, key=measure_loss)


def _split_end(runs: Sequence[Run]) -> Split:
    total = sum(len(run) for run in runs)
    left = total - round(LAST_SHARE * total)
    fit: list[Run] = []
    held_out: list[Run] = []
    skip: dict[str, int] = {}
    for run in runs:
        own = min(left, len(run))
        left -= own
        if own:
            fit.append(run.take(slice(own)))
        if own < len(run):
            held_out.append(run)
            skip[run.name] = own
    return Split(
        fit=tuple(fit),
        held_out=tuple(held_out),
        skip=skip,
        explanation=f"there is one run only, so its last {100 * LAST_SHARE:.0f} % were held out of "
        "training; another run may differ more",
    )


# Runs as training sees them.

Array32 = NDArray[np.float32]


@dataclass(frozen=True)
class Sequence32:
    """One stretch of one run: what the network sees, and what it has to learn."""

    group: str
    features: Array32
    """[n, I]."""
    target: Array32
    """[n, K] residual of the physical model, in multiples of each output's scale."""
    skip: int = 0
    """Samples at the start that a held-out sequence only passes through, without being judged."""

    def __len__(self) -> int:
        """Return the number of samples."""
        return int(self.features.shape[0])
