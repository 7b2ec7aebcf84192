"""Compares a back end with the reference bit for bit and names the first difference."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from zerodrift.base.arrays import IntArray
from zerodrift.export.integer_model import IntegerModel
from zerodrift.export.reference import Reference
from zerodrift.operations.arithmetic import CodeArray


@dataclass(frozen=True)
class Mismatch:
    """The first place where a back end differs from the reference."""

    step: int
    where: str
    """Output, node or flag, with its index (a GRU's index is the unit)."""
    expected: int
    actual: int
    physical: str = ""
    """Both values in the physical unit, where there is one."""

    def __str__(self) -> str:
        return (
            f"step {self.step}, {self.where}: expected {self.expected}"
            f" (0x{self.expected & 0xFFFFFFFF:08X}), actual {self.actual}"
            f" (0x{self.actual & 0xFFFFFFFF:08X}){self.physical}"
        )


def label_columns(model: IntegerModel) -> list[str]:
    """Return the name of each observed value: nodes in order, vectors with their index."""
    return [
        f"{node.name}[{i}]" if node.width else node.name
        for node in model.nodes
        for i in range(max(node.width, 1))
    ]


def find_mismatch(
    model: IntegerModel,
    expected: IntArray,
    actual: IntArray,
    labels: list[str],
    first_step: int = 0,
) -> Mismatch | None:
    """Return the earliest difference of two arrays [T, N] of observed values, or None.

    Args:
        model: gives the outputs' units to the columns named drift[k].
        expected: from the reference.
        actual: from the back end.
        labels: [N] names of the columns.
        first_step: number of row 0, for the message.
    """
    differs = expected != actual
    if not differs.any():
        return None
    step = int(differs.any(axis=1).argmax())
    column = int(differs[step].argmax())
    want, got = int(expected[step, column]), int(actual[step, column])
    return Mismatch(
        step=first_step + step,
        where=labels[column],
        expected=want,
        actual=got,
        physical=_describe(model, labels[column], want, got),
    )


def _describe(model: IntegerModel, label: str, want: int, got: int) -> str:
    """Return the values in the output's unit; a hidden unit's as a number between -1 and 1."""
    if label.startswith("gru["):
        return f": state {want / 2**30:.9f} against {got / 2**30:.9f}"
    if not label.startswith("drift["):
        return ""
    output = model.outputs[int(label[6:-1])]
    lsb = output.lsb_per_unit
    return f": {output.name} {want / lsb:.6g} {output.unit} against {got / lsb:.6g} {output.unit}"


# The reference's answers to a sequence, step by step, and where a back end differs.


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
