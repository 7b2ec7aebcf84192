"""The reference's answers to a sequence, step by step, and where a back end differs."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from zerodrift.export.integer_model import IntegerModel
from zerodrift.export.reference import Reference
from zerodrift.operations.arithmetic import CodeArray, IntArray
from zerodrift.verify.mismatch import Mismatch, find_mismatch, label_columns


@dataclass(frozen=True)
class Expected:
    """The reference's answer to one sequence."""

    model: IntegerModel
    codes: CodeArray  # [T, C]
    settled: bool
    drift: NDArray[np.int32]  # [T, K]
    flags: NDArray[np.uint32]  # [T]
    hidden: NDArray[np.int32]
    """[T, H] state of a streaming GRU in Q1.30; H = 0 without one."""
    nodes: IntArray
    """[T, N] the values of all nodes."""
    states: IntArray
    """[T, n] the state after each step, as packed."""

    def compare(
        self,
        drift: NDArray[np.int32],
        flags: NDArray[np.uint32],
        nodes: IntArray | NDArray[np.int32] | None = None,
        states: IntArray | None = None,
    ) -> Mismatch | None:
        """Return the first difference of a back end's answer, or None."""
        given: list[
            tuple[NDArray[np.signedinteger] | None, NDArray[np.signedinteger], list[str]]
        ] = [
            (nodes, self.nodes, label_columns(self.model)),
            (states, self.states, [f"state[{k}]" for k in range(self.states.shape[1])]),
            (flags[:, None].astype(np.int64), self.flags[:, None].astype(np.int64), ["flags"]),
            (drift, self.drift, [f"drift[{k}]" for k in range(self.drift.shape[1])]),
        ]
        there = [(a.astype(np.int64), e.astype(np.int64), n) for a, e, n in given if a is not None]
        return find_mismatch(
            self.model,
            np.concatenate([expected for _, expected, _ in there], axis=1),
            np.concatenate([actual for actual, _, _ in there], axis=1),
            [name for _, _, names in there for name in names],
        )


def expect(model: IntegerModel, codes: CodeArray, *, settled: bool = True) -> Expected:
    """Return what the reference computes for codes [T, C]."""
    reference = Reference(model)
    wide = codes.astype(np.int64)
    state = reference.start(wide[:1], settled=settled)
    layers = [layer for layer in model.recurrents if layer.streams]
    drift, flags, hidden, nodes, states = [], [], [], [], []
    for row in wide:
        state, values, d, f = reference.step(state, row[None])
        drift.append(d[0])
        flags.append(f[0])
        nodes.append(np.concatenate([values[n.name].reshape(-1) for n in model.nodes]))
        states.append(state.pack()[0])
        if layers:
            hidden.append(np.concatenate([state.nodes[n.name]["h_q30"][0] for n in layers]))
    return Expected(
        model,
        codes,
        settled,
        np.array(drift, dtype=np.int32),
        np.array(flags, dtype=np.uint32),
        np.array(hidden, dtype=np.int32).reshape(len(codes), -1 if hidden else 0),
        np.array(nodes, dtype=np.int64),
        np.array(states, dtype=np.int64),
    )
