"""Many steps of the reference at once: nodes without a state are computed for all of them together.

The arithmetic is that of the nodes themselves, and only the order of the loops differs: step by
step goes over all nodes at each step; here each node goes over all steps, and those that carry
something from one step to the next do so step by step. Every number is the same.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from zerodrift.export.integer_model import IntegerModel
from zerodrift.operations.arithmetic import IntArray
from zerodrift.operations.node import CODES, ELAPSED, IntegerNode, State
from zerodrift.operations.tables import is_watched

STRETCH_ROWS = 1 << 14
"""Steps times sequences of one stretch; more than that leaves the processor's cache."""


@dataclass(frozen=True)
class StretchResult:
    """The nodes' part of some steps of a batch."""

    nodes: dict[str, State]
    """After the last step."""
    unlimited: IntArray
    """[T, B, K] drift before it is limited."""
    drift: IntArray
    """[T, B, K]"""
    hidden: list[IntArray]
    """Per streaming recurrent layer [T, B, H] its output in Q1.30."""


def can_stretch(model: IntegerModel) -> bool:
    """Tell whether no step of a model needs more of the one before than states of its nodes.

    Not while someone is told which lines of a table are read: he is told so step by step.
    """
    return not (model.feeds_back or model.tare or model.variable_step or is_watched())


def hold_readings(codes: IntArray, missing: NDArray[np.bool_], last: IntArray) -> IntArray:
    """Return codes [T, B, C] with the last reading in the place of each that is none.

    Args:
        codes: of the steps.
        missing: [T, B, C] which of them are none.
        last: [B, C] the readings before the first step.
    """
    if not missing.any():
        return codes
    steps = np.arange(1, len(codes) + 1)[:, None, None]
    since = np.maximum.accumulate(np.where(missing, 0, steps), axis=0)
    return np.take_along_axis(np.concatenate([last[None], codes]), since, axis=0)


def run_stretch(
    model: IntegerModel, nodes_before: Mapping[str, State], codes: IntArray
) -> StretchResult:
    """Return what the nodes make of readings [T, B, C], from a state that is not new.

    Args:
        model: one that `can_stretch`.
        nodes_before: their states before the first step.
        codes: the channels' codes, none of them missing.
    """
    steps, batch, _ = codes.shape
    flat: dict[str, IntArray] = {
        CODES: codes.reshape(steps * batch, -1),
        ELAPSED: np.zeros(steps * batch, dtype=np.int64),
    }
    nodes: dict[str, State] = {}
    hidden: list[IntArray] = []
    streaming = {layer.name for layer in model.recurrents if layer.streams}
    for node in model.nodes[:-1]:
        before = nodes_before[node.name]
        if not before:
            nodes[node.name], flat[node.name] = node.step(before, flat)
            continue
        kept: list[IntArray] | None = [] if node.name in streaming else None
        nodes[node.name], flat[node.name] = _go_on(node, before, flat, batch, kept)
        if kept is not None:
            hidden.append(np.stack(kept))
    last = model.drift
    unlimited = last.sum(flat)
    drift = last.limit(unlimited)
    nodes[last.name] = {}
    shape = (steps, batch, -1)
    return StretchResult(nodes, unlimited.reshape(shape), drift.reshape(shape), hidden)


def _go_on(
    node: IntegerNode,
    state: State,
    flat: Mapping[str, IntArray],
    batch: int,
    kept: list[IntArray] | None,
) -> tuple[State, IntArray]:
    """Return a node's state after all steps and its output at each, [T B] or [T B, width].

    Args:
        node: that has a state.
        state: before the first step.
        flat: what it reads, as its output.
        batch: B.
        kept: takes a recurrent layer's output after each step.
    """
    given = {name: flat[name] for name in (*node.inputs, CODES, ELAPSED)}
    rows = len(given[CODES])
    outputs = []
    for first in range(0, rows, batch):
        now = {name: values[first : first + batch] for name, values in given.items()}
        state, output = node.step(state, now)
        outputs.append(output)
        if kept is not None:
            kept.append(state["h_q30"])
    return state, np.concatenate(outputs)
