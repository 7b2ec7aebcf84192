"""Two slots: the newest sound one; a cut of power leaves one that is sound."""

from pathlib import Path

import pytest

from tests.blocks.flash import count_operations, cut_everywhere
from tests.blocks.test_blocks import build, find_design, list_units, make_block
from zerodrift.c_runtime.host import HostModel


@pytest.fixture
def host(tmp_path: Path) -> HostModel:
    """Return the program, compiled for this host."""
    return build(True, tmp_path)


def list_blocks(*sequences: int) -> list[bytes]:
    """Return blocks of one unit, written one after the other."""
    design = find_design(network=True)
    model = design.fit(list_units(True)[0])
    return [make_block(design, model, sequence) for sequence in sequences]


def test_the_newest_sound_one_is_chosen(host: HostModel) -> None:
    old, new = list_blocks(1, 2)
    damaged = new[:100] + bytes([new[100] ^ 4]) + new[101:]
    empty = b"\xff" * len(old)
    assert host.choose_block(old, new) == 1 and host.choose_block(new, old) == 0
    assert host.choose_block(old, old) == 0
    assert host.choose_block(old, damaged) == 0 and host.choose_block(damaged, old) == 1
    assert host.choose_block(empty, old) == 1
    assert host.choose_block(empty, damaged) is None


def test_two_blocks_of_one_sequence_are_refused(host: HostModel) -> None:
    design = find_design(network=True)
    first, second = (make_block(design, design.fit(unit), 3) for unit in list_units(True)[:2])
    assert host.choose_block(first, second) is None and host.choose_block(second, first) is None
    assert host.choose_block(first, first) == 0


def test_a_cut_at_every_operation_leaves_a_sound_block(host: HostModel) -> None:
    old, new = list_blocks(1, 2)
    cuts = list(cut_everywhere(host, old, new, tears=2, seed=1))
    assert len(cuts) == 2 * 2 * 2 * (count_operations(new) + 1)
    assert all(chosen is not None and whole for chosen, whole in cuts)
    assert {chosen for chosen, _ in cuts} == {0, 1}
