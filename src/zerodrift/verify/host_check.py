"""Proves the host C equal to the reference, step by step, states included, at full speed.

A recurrent model cannot be run in parallel along time, but equality can be shown so: the C runs
the whole sequence in order and hands over its complete state every `chunk` steps. The reference
starts a batch of chunks from those states. If every chunk agrees at every step and ends in the
state from which the next one began, the two runs are equal by induction over the whole sequence.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from zerodrift.base.arrays import IntArray
from zerodrift.c_runtime.host import HostModel, HostTrace
from zerodrift.export.integer_model import IntegerModel
from zerodrift.export.reference import ModelState, Reference
from zerodrift.operations.arithmetic import CodeArray
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


class Runner(Protocol):
    """The C of a model, wherever it runs: a host build, or WebAssembly in a browser."""

    @property
    def model(self) -> IntegerModel:
        """The integer model."""
        ...

    @property
    def observes(self) -> bool:
        """Whether a step records every node's value."""
        ...

    def run_chunks(
        self, codes: CodeArray, chunk: int, width: int, *, settled: bool = True
    ) -> tuple[HostTrace, IntArray]:
        """Run over codes [T, C]; return also the states [chunks, width] after each chunk."""
        ...


def check_host(
    host: Runner,
    codes: CodeArray,
    *,
    settled: bool = True,
    chunk: int = 0,
    peer: Peer | None = None,
) -> HostCheck:
    """Compare drift, flags, every node and every state of a host build with the reference.

    Args:
        host: the compiled model, which goes on from call to call.
        codes: [T, C] one sequence of raw inputs.
        settled: start from `settle` rather than `init`.
        chunk: steps per chunk; 0 chooses so that a few batches of 256 chunks cover T.
        peer: another back end to compare the host with, in place of the reference.
    """
    model, total = host.model, codes.shape[0]
    chunk = chunk or choose_chunk(total)
    reference = Reference(model)
    start = reference.start(codes[:1].astype(np.int64), settled=settled)
    whole, rest = divmod(total, chunk)
    packed = start.pack()
    trace, ends = host.run_chunks(codes, chunk, packed.shape[1], settled=settled)
    states = np.concatenate([packed, ends])
    rows = _lay_rows(trace)
    labels = _label(host)
    compared = 0
    groups = [(i, min(i + CHUNKS_AT_ONCE, whole)) for i in range(0, whole, CHUNKS_AT_ONCE)]
    groups += [(whole, whole + 1)] if rest else []
    for begin, end in groups:
        length = chunk if begin < whole else rest
        part = slice(begin * chunk, begin * chunk + (end - begin) * length)
        batch = codes[part].reshape(end - begin, length, -1)
        if peer is not None:
            expected, after = peer(batch, states[begin:end])
        else:
            expected, after = _run_reference(
                reference, batch, start.unpack(states[begin:end]), observe=host.observes
            )
        found = rows[part].reshape(end - begin, length, -1)
        next_states = states[begin + 1 : end + 1]
        if np.array_equal(expected, found) and np.array_equal(after, next_states):
            compared += expected.size
            continue
        for i in range(end - begin):
            compared += expected[i].size
            first = (begin + i) * chunk
            mismatch = find_mismatch(model, expected[i], found[i], labels, first)
            if mismatch is None:
                fields = [f"state[{n}]" for n in range(packed.shape[1])]
                last = first + length - 1
                mismatch = find_mismatch(model, after[i][None], next_states[i][None], fields, last)
            if mismatch is not None:
                return HostCheck(total, compared, mismatch)
    return HostCheck(total, compared, None)


def _lay_rows(trace: HostTrace) -> IntArray:
    """Return what is compared at each step [T, N]: nodes, flags, drift."""
    return np.column_stack([trace.nodes, trace.flags.astype(np.int64), trace.drift])


def choose_chunk(total: int) -> int:
    """Return the steps of a chunk: few batches, and a short last chunk, since it runs alone."""
    least = max(16, min(LONGEST_CHUNK, -(-total // CHUNKS_AT_ONCE)))
    return min(range(least, least + least // 4 + 1), key=lambda chunk: chunk + total % chunk)


def check_starts(
    host: HostModel, sequences: Mapping[str, CodeArray], steps: int, *, settled: bool
) -> HostCheck:
    """Compare a host build with the reference over the first steps of many sequences.

    Args:
        host: the compiled model.
        sequences: raw inputs [T, C] by name.
        steps: how many of each; no more than the shortest has.
        settled: start from `settle` rather than `init`.
    """
    steps = min(steps, *map(len, sequences.values()))
    codes = np.stack([whole[:steps] for whole in sequences.values()])
    reference = Reference(host.model)
    start = reference.start(codes[:, 0].astype(np.int64), settled=settled)
    width = start.pack().shape[1]
    expected, after = _run_reference(reference, codes, start, observe=host.observes)
    labels = _label(host)
    for name, own, values, end in zip(sequences, codes, expected, after, strict=True):
        part = host.run(own, settled=settled)
        rows = _lay_rows(part)
        found = np.concatenate([rows[-1], host.pack(width)])[None]
        mismatch = find_mismatch(host.model, values, rows, labels) or find_mismatch(
            host.model,
            np.concatenate([values[-1], end])[None],
            found,
            [*labels, *(f"state[{n}]" for n in range(width))],
            len(own) - 1,
        )
        if mismatch is not None:
            mismatch = replace(mismatch, where=f"{mismatch.where} in the start of '{name}'")
            return HostCheck(len(codes) * steps, expected.size, mismatch)
    return HostCheck(len(codes) * steps, expected.size, None)


def _label(host: Runner) -> list[str]:
    """Return the names of what is compared at each step."""
    outputs = [f"drift[{k}]" for k in range(len(host.model.outputs))]
    nodes = label_columns(host.model) if host.observes else []
    return [*nodes, "flags", *outputs]


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
