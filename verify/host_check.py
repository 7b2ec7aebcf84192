"""Proves the host C equal to the reference, step by step, states included, at full speed.

A recurrent model cannot be run in parallel along time, but equality can be shown so: the C runs
the whole sequence in order and hands over its complete state every `chunk` steps. The reference
starts a batch of chunks from those states. If every chunk agrees at every step and ends in the
state from which the next one began, the two runs are equal by induction over the whole sequence.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from zerodrift.c_runtime.host import HostModel
from zerodrift.export.reference import ModelState, Reference
from zerodrift.operations.arithmetic import CodeArray, IntArray
from zerodrift.verify.mismatch import Mismatch, find_mismatch, label_columns

CHUNKS_AT_ONCE = 256
LONGEST_CHUNK = 512
"""Bounds the memory of one batch: every value of 256 x 512 steps is held to be compared."""


@dataclass(frozen=True)
class HostCheck:
    """The outcome of one comparison."""

    steps: int
    values_compared: int
    mismatch: Mismatch | None


Peer = Callable[[CodeArray, IntArray], tuple[IntArray, IntArray]]
"""Runs codes [B, T, C] from packed states [B, n]: all nodes, flags and drift [B, T, N], states."""


def check_host(
    host: HostModel,
    codes: CodeArray,
    *,
    settled: bool = True,
    chunk: int = 0,
    peer: Peer | None = None,
) -> HostCheck:
    """Compare drift, flags, every node and every state of a host build with the reference.

    Args:
        host: the compiled model.
        codes: [T, C] one sequence of raw inputs.
        settled: start from `settle` rather than `init`.
        chunk: steps per chunk; 0 chooses so that a few batches of 256 chunks cover T.
        peer: another back end to compare the host with, in place of the reference.
    """
    model, total = host.model, codes.shape[0]
    chunk = chunk or max(16, min(LONGEST_CHUNK, -(-total // CHUNKS_AT_ONCE)))
    reference = Reference(model)
    start = reference.start(codes[:1].astype(np.int64), settled=settled)
    whole, rest = divmod(total, chunk)
    states = [start.pack()[0]]
    rows: list[IntArray] = []
    for first in range(0, total, chunk):
        part = host.run(codes[first : first + chunk], settled=settled, restart=first == 0)
        states.append(host.pack(states[0].size))
        rows.append(np.column_stack([part.nodes, part.flags.astype(np.int64), part.drift]))
    labels = [*label_columns(model), "flags", *(f"drift[{k}]" for k in range(len(model.outputs)))]
    if not host.observes:
        labels = labels[len(label_columns(model)) :]
    compared = 0
    groups = [(i, min(i + CHUNKS_AT_ONCE, whole)) for i in range(0, whole, CHUNKS_AT_ONCE)]
    groups += [(whole, whole + 1)] if rest else []
    for begin, end in groups:
        length = chunk if begin < whole else rest
        batch = codes[begin * chunk : begin * chunk + (end - begin) * length]
        batch = batch.reshape(end - begin, length, -1)
        packed = np.stack(states[begin:end])
        if peer is not None:
            expected, after = peer(batch, packed)
        else:
            expected, after = _run_reference(
                reference, batch, start.unpack(packed), observe=host.observes
            )
        for i in range(begin, end):
            compared += expected[i - begin].size
            mismatch = find_mismatch(model, expected[i - begin], rows[i], labels, i * chunk)
            if mismatch is None:
                ends = after[i - begin][None]
                fields = [f"state[{n}]" for n in range(ends.shape[1])]
                last = i * chunk + length - 1
                mismatch = find_mismatch(model, ends, states[i + 1][None], fields, last)
            if mismatch is not None:
                return HostCheck(total, compared, mismatch)
    return HostCheck(total, compared, None)


def _run_reference(
    reference: Reference,
    codes: CodeArray,
    state: ModelState,
    *,
    observe: bool,
) -> tuple[IntArray, IntArray]:
    """Return the observed values [B, T, N] (nodes, flags, drift) and the states afterwards."""
    nodes: list[IntArray] = []

    def keep(_: int, values: dict[str, IntArray]) -> None:
        batch = codes.shape[0]
        nodes.append(
            np.concatenate(
                [values[n.name].reshape(batch, -1) for n in reference.model.nodes], axis=1
            )
        )

    trace = reference.run(codes, state=state, observe=keep if observe else None)
    columns = [trace.flags[:, :, None].astype(np.int64), trace.drift.astype(np.int64)]
    if observe:
        columns.insert(0, np.stack(nodes, axis=1))
    return np.concatenate(columns, axis=2), trace.state.pack()
