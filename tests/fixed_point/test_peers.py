"""The benchmark that runs other libraries' layers beside zerodrift's."""

from pathlib import Path

import numpy as np
import pytest
from benchmarks.peers.__main__ import PEERS, has_kind, try_peer
from benchmarks.peers.c_text import split_scale
from benchmarks.peers.chip import CORE, measure
from benchmarks.peers.layers import Task, draw_task
from benchmarks.peers.nnom import order_weights
from benchmarks.peers.ours import write_ours

from zerodrift.c_runtime.cores import find_cross_compilers

HAS_GCC = any(c.name == "gcc" for c in find_cross_compilers(CORE))


@pytest.mark.skipif(not HAS_GCC, reason="no arm-none-eabi-gcc")
@pytest.mark.parametrize("kind", ["gru", "lstm"])
def test_own_layer_is_measured_and_the_same_on_both(kind: str, tmp_path: Path) -> None:
    task = draw_task(kind, 0)
    task = Task(kind, task.cell, task.x[:200])
    found = measure(task, write_ours(task, "int16", tmp_path), tmp_path)
    assert (found.different, found.numbers) == (0, 200 * 16)
    assert found.error_pct < 0.2  # a wrong format would be far off
    macs = {"gru": 3, "lstm": 4}[kind] * 16 * (16 + 4)
    assert macs < found.instructions < 1.5 * macs
    assert found.ram_bytes == {"gru": 64, "lstm": 128}[kind]
    assert found.flash_bytes > 2 * macs


@pytest.mark.parametrize("scale", [1.0, 2.0**-15, 0.75, 1.0 - 2.0**-40, 3.3e-5])
def test_scale_is_split_as_the_kernels_read_it(scale: float) -> None:
    multiplier, shift = split_scale(scale)
    assert 2**30 <= multiplier < 2**31
    assert multiplier * 2.0 ** (shift - 31) == pytest.approx(scale, rel=2.0**-30)


def test_weights_are_read_by_the_kernel_as_rows() -> None:
    """The kernel takes two columns of four rows at a time: 1, 2 of column 1, of column 2, 3, 4."""
    rows = np.arange(8 * 6, dtype=np.int8).reshape(8, 6)
    order, found = iter(order_weights(rows).tolist()), np.zeros_like(rows)
    for first in range(0, 8, 4):
        for column in range(0, 6, 2):
            for pair in (first, first + 2):
                for c in (column, column + 1):
                    found[pair, c], found[pair + 1, c] = next(order), next(order)
    assert (found == rows).all()


def test_library_without_the_layer_or_without_sources_is_said_to_be(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    peer = next(p for p in PEERS if p.name == "CMSIS-NN")
    tasks = [draw_task("gru", 0)]
    try_peer(peer, None, tasks)
    assert "left out: no --cmsis-nn" in capsys.readouterr().out
    try_peer(peer, tmp_path, tasks)
    assert f"left out: {tmp_path} is no checkout of it" in capsys.readouterr().out
    (tmp_path / peer.needed).parent.mkdir(parents=True)
    (tmp_path / peer.needed).write_text("")
    try_peer(peer, tmp_path, tasks)
    assert "has none (of no known version)" in capsys.readouterr().out
    assert has_kind(peer, tmp_path, "lstm")
