"""Outputs without information: those whose reading or drift never moves."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from zerodrift.base.arrays import Array, Mask
from zerodrift.base.errors import InputError
from zerodrift.dataset.runs import Dataset, Run

ROUND_OFF = 1e-12
"""Share of the largest reading below which a difference is no movement."""


def find_live(runs: Sequence[Run]) -> Mask:
    """Return [K] which outputs move in some run, both in their reading and in their drift."""
    moves = [_moves(run.measured) & _moves(run.drift, run.measured) for run in runs]
    return np.asarray(np.any(moves, axis=0))


def _moves(x: Array, scale: Array | None = None) -> Mask:
    """Return [K] which columns of [n, K] are not constant but for round-off."""
    largest = np.abs(x if scale is None else scale).max(axis=0)
    return np.asarray(np.ptp(x, axis=0) > ROUND_OFF * largest)


def leave_out_still(dataset: Dataset) -> tuple[Dataset, tuple[str, ...]]:
    """Return the data without outputs that never move, and a note for each change.

    The dwell is left out too where an output that moves in the runs is constant in it: it then does
    not show the noise.

    Raises:
        InputError: no output moves at all.
    """
    live = find_live(dataset.train)
    if not live.any():
        names = ", ".join(dataset.outputs)
        raise InputError(
            f"no output moves in the train logs ({names}); expected readings that differ from "
            "their references by more than a constant. Check the columns in [outputs]."
        )
    notes = tuple(
        f"output {name} never moves in the train logs and is left out of the diagnosis"
        for name, moves in zip(dataset.outputs, live, strict=True)
        if not moves
    )
    if not live.all():
        dataset = _keep_outputs(dataset, np.flatnonzero(live))
    if dataset.dwell:
        still = ~find_live(dataset.dwell)
        if still.any():
            names = ", ".join(np.array(dataset.outputs)[still].tolist())
            notes += (f"{names} never moves in the dwell, which is therefore left aside",)
            dataset = replace(dataset, dwell=())
    return dataset, notes


def _keep_outputs(dataset: Dataset, kept: NDArray[np.intp]) -> Dataset:
    """Return the data with these outputs alone."""

    def narrow(runs: tuple[Run, ...]) -> tuple[Run, ...]:
        return tuple(narrow_one(run) for run in runs)

    def narrow_one(run: Run) -> Run:
        return replace(
            run,
            measured=run.measured[:, kept],
            reference=run.reference[:, kept],
            before=None if run.before is None else narrow_one(run.before),
        )

    return replace(
        dataset,
        train=narrow(dataset.train),
        test=narrow(dataset.test),
        dwell=narrow(dataset.dwell),
        outputs=tuple(dataset.outputs[k] for k in kept),
        units=tuple(dataset.units[k] for k in kept),
        full_scale=tuple(dataset.full_scale[k] for k in kept),
    )
