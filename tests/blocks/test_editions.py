"""Date and sequence of a block: the unit's own, and others only where its numbers are."""

from dataclasses import replace
from datetime import date

import pytest

from tests.field.conftest import make_bare_block
from zerodrift.base.errors import InputError
from zerodrift.base.fleet_config import BlockConfig
from zerodrift.blocks.block import decode_header
from zerodrift.blocks.editions import (
    FILE_NAME,
    LARGEST,
    Edition,
    load_units,
    number_block,
    read_edition,
    render_units,
)
from zerodrift.field.registry import FILE_NAME as REGISTRY
from zerodrift.field.registry import find_editions, open_registry

MARCH, APRIL = (BlockConfig("block", calibrated=date(2026, m, 1)) for m in (3, 4))
NONE = BlockConfig("block")


def make(number: int, known: tuple[Edition, ...], asked: BlockConfig = NONE) -> bytes:
    return number_block(make_bare_block("SN1", 77, number=number), known, asked)


def tell(block: bytes) -> tuple[int, date]:
    notes = decode_header(block, "block").notes
    return notes.sequence, notes.calibrated


def edition(block: bytes) -> Edition:
    return read_edition(block, "block")[1]


def test_other_numbers_are_newer_and_the_same_stay_what_they_are() -> None:
    first = make(1, ())
    assert tell(first) == (1, date(1970, 1, 1))
    second = make(2, (edition(first),))
    assert tell(second) == (2, date(1970, 1, 1))
    known = (edition(first), edition(second))
    assert make(2, known, APRIL) == second  # another date in zerodrift.toml dates nothing anew
    back = make(1, known, APRIL)  # the chip has the second: the first must be newer than that
    assert tell(back)[0] > 2 and tell(back)[1] == APRIL.calibrated
    assert make(1, known, APRIL) == back  # the same history gives the same bytes


def test_a_sequence_is_at_least_the_date_as_days() -> None:
    first = make(1, (), MARCH)
    assert tell(first) == (20_513, MARCH.calibrated)
    assert tell(make(2, (edition(first),), MARCH)) == (20_514, MARCH.calibrated)
    assert tell(make(2, (edition(first),), APRIL)) == (20_544, APRIL.calibrated)


def test_two_that_claim_one_sequence_are_both_old() -> None:
    claims = (edition(make(1, ())), edition(make(2, ())))
    assert [tell(make(number, claims))[0] for number in (1, 2)] == [2, 2]


def test_a_stated_sequence_that_was_given_is_refused() -> None:
    stated = replace(NONE, sequence=5)
    first = make(1, (), stated)
    assert tell(first)[0] == 5
    assert make(1, (edition(first),), stated) == first
    with pytest.raises(InputError, match="State 6 or more, or leave the key out"):
        make(2, (edition(first),), stated)
    last = replace(edition(first), sequence=LARGEST)
    with pytest.raises(InputError, match="another serial number"):
        make(2, (last,))


def test_units_json_keeps_the_newest_of_each_unit(tmp_path) -> None:
    first, other = make(1, (), MARCH), make_bare_block("SN2", 4)
    (tmp_path / FILE_NAME).write_bytes(render_units(tmp_path, (first, other)))
    second = make(2, (edition(first),), APRIL)
    content = render_units(tmp_path, (second,))
    (tmp_path / FILE_NAME).write_bytes(content)
    assert render_units(tmp_path, (second,)) == content
    assert load_units(tmp_path) == {"SN1": edition(second), "SN2": edition(other)}
    assert len(content.splitlines()) == 6  # a unit a line, as version control merges lines


@pytest.mark.parametrize(
    "text",
    [
        "{",
        "[]",
        '{"format": 2, "units": {}}',
        '{"format": 1, "units": {"A": {"sequence": 0, "calibrated": "2026-01-01", "content": ""}}}',
        '{"format": 1, "units": {"SN1": {"sequence": 1, "calibrated": "May", "content": ""}}}',
        '{"format": 1, "units": {"SN1": {"sequence": 1}}}',
    ],
)
def test_a_damaged_units_json_is_refused(tmp_path, text: str) -> None:
    (tmp_path / FILE_NAME).write_text(text)
    with pytest.raises(InputError, match=r"units\.json: is no list .* version control"):
        load_units(tmp_path)


def test_registry_and_blocks_that_lie_there_count(tmp_path) -> None:
    blocks = [make_bare_block("SN1", k, number=k) for k in (1, 2, 3)]
    (tmp_path / FILE_NAME).write_bytes(render_units(tmp_path, blocks[:1]))
    with open_registry(tmp_path / REGISTRY, make=True) as registry:
        registry.add_unit("SN1", "cell")
        registry.add_block("SN1", blocks[1])
        with pytest.raises(InputError, match="another block of sequence 2"):
            registry.add_block("SN1", make_bare_block("SN1", 2, number=9))
    (tmp_path / "block.bin").write_bytes(blocks[2])
    (tmp_path / "cut.bin").write_bytes(blocks[2][:-1])
    files = [tmp_path / name for name in ("block.bin", "cut.bin", "missing.bin")]
    found = find_editions(tmp_path, files)
    assert sorted(e.sequence for e in found["SN1"]) == [1, 2, 3]
    assert tell(make(4, found["SN1"]))[0] == 4


def test_an_older_block_that_is_loaded_is_told(tmp_path) -> None:
    old, new = (make_bare_block("SN1", k, number=k) for k in (1, 2))
    with open_registry(tmp_path / REGISTRY, make=True) as registry:
        registry.add_unit("SN1", "cell")
        first, second = (registry.add_block("SN1", block) for block in (old, new))
        registry.load_block("SN1", first)
        assert registry.find_newer("SN1", first) is None
        registry.load_block("SN1", second)
        assert registry.find_newer("SN1", second) is None
        registry.load_block("SN1", first)
        assert registry.find_newer("SN1", first) == second
