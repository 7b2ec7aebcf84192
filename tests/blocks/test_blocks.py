"""One program, many blocks: the same bits as the reference; nothing beyond the set is accepted."""

from dataclasses import replace
from datetime import date
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from tests.blocks.draws import draw_admissible, list_inadmissible, read_design, write_block
from tests.blocks.units import describe_unit, make_unit
from zerodrift.base.errors import CheckError, InputError
from zerodrift.blocks.block import BlockNotes, apply, decode, encode, find_size
from zerodrift.blocks.design import BlockDesign, load_design, make_design
from zerodrift.c_runtime.host import HostModel
from zerodrift.codegen.generate import GeneratedCode, generate_design, widen
from zerodrift.codegen.selftest import compute_selftest
from zerodrift.export.integer_model import FLAG_DAMAGED, IntegerModel
from zerodrift.export.quantize import quantize
from zerodrift.export.reference import Reference
from zerodrift.verify.host_check import check_host
from zerodrift.verify.vectors import draw_sequences

SEEDS = range(20)
DAY = date(2026, 3, 1)


@cache
def list_units(network: bool) -> tuple[IntegerModel, ...]:
    """Return simulated units of one design."""
    return tuple(make_unit(seed, network=network) for seed in SEEDS)


@cache
def find_design(network: bool) -> BlockDesign:
    """Return the design of those units."""
    return make_design(list_units(network))


@cache
def find_code(network: bool) -> GeneratedCode:
    """Return its C."""
    return generate_design(find_design(network))


def make_block(
    design: BlockDesign, model: IntegerModel, sequence: int = 1, serial: str = "SN1"
) -> bytes:
    """Return a unit's block."""
    answers = compute_selftest(model, widen(design))
    return encode(design, model, BlockNotes(serial, DAY, sequence), answers)


def build(network: bool, folder: Path) -> HostModel:
    """Return the program, compiled for this host."""
    return HostModel(find_design(network).model, find_code(network), folder)


@pytest.mark.parametrize("network", [False, True])
def test_one_program_computes_what_each_units_reference_does(network: bool, tmp_path: Path) -> None:
    design, host = find_design(network), build(network, tmp_path)
    for unit in list_units(network)[::5]:
        model = design.fit(unit)
        assert host.use_block(make_block(design, model)) == 0
        assert host.selftest() == 0
        host.model = model
        for settled, codes in enumerate(draw_sequences(model, 1000).values()):
            check = check_host(host, codes, settled=settled % 2 == 0)
            assert check.mismatch is None, check.mismatch


def test_the_loop_over_outputs_gives_the_same_bits(tmp_path: Path) -> None:
    design, code = find_design(network=True), find_code(network=True)
    assert "#if defined(ZD_SMALL)" in code.source
    host = HostModel(design.model, code, tmp_path, flags=("-Os", "-DZD_SMALL"))
    model = design.fit(list_units(True)[3])
    assert host.use_block(make_block(design, model)) == 0
    host.model = model
    for settled, codes in enumerate(draw_sequences(model, 1000).values()):
        assert check_host(host, codes, settled=settled % 2 == 0).mismatch is None


@pytest.mark.long
def test_the_common_format_costs_next_to_nothing(tmp_path: Path) -> None:
    design = find_design(network=True)
    for seed in SEEDS:
        described, calibration = describe_unit(seed)
        own = quantize(described, calibration)
        codes = draw_sequences(own, 2000)["walk"][None]
        drifts = [Reference(m).run(codes).drift[0] for m in (own, design.fit(own))]
        assert np.abs(drifts[0].astype(np.int64) - drifts[1]).max() <= 3  # 3e-4 N of 200 N


@pytest.mark.long
def test_any_admissible_block_computes_what_the_reference_does(tmp_path: Path) -> None:
    design, host = find_design(network=True), build(True, tmp_path)
    told = read_design(design.to_text())
    for seed in range(200):
        content = write_block(told, draw_admissible(told, seed))
        assert host.use_block(content) == 0
        host.model = apply(design, decode(design, content, "drawn"))
        codes = draw_sequences(host.model, 60)["jumps" if seed % 2 else "rails"]
        assert check_host(host, codes, settled=True).mismatch is None


def test_no_inadmissible_block_is_accepted(tmp_path: Path) -> None:
    design, host = find_design(network=True), build(True, tmp_path)
    told = read_design(design.to_text())
    count = 0
    for seed in range(3):
        for what, content in list_inadmissible(told, seed):
            assert host.use_block(content) != 0, what
            with pytest.raises(InputError):
                decode(design, content, "drawn")
            count += 1
    assert count > 120


def test_without_a_block_raw_values_pass(tmp_path: Path) -> None:
    host = build(True, tmp_path)
    assert host.use_block(b"\xff" * find_size(find_design(True))) != 0
    trace = host.run(np.full((3, 1), 2500, dtype=np.int16))
    assert not trace.drift.any() and (trace.flags == FLAG_DAMAGED).all()
    assert host.selftest() != 0


def test_a_state_belongs_to_one_block(tmp_path: Path) -> None:
    design, host = find_design(network=True), build(True, tmp_path)
    blocks = [make_block(design, design.fit(u)) for u in list_units(True)[:2]]
    codes = np.full((3, 1), 2500, dtype=np.int16)
    host.use_block(blocks[0])
    assert not host.run(codes).flags.any()
    host.use_block(blocks[1])
    after = host.run(codes, restart=False)
    assert after.flags.tolist() == [FLAG_DAMAGED, 0, 0] and not after.drift[0].any()


def test_the_design_comes_back_from_its_file(tmp_path: Path) -> None:
    design = find_design(network=True)
    path = tmp_path / "design.json"
    path.write_text(design.to_text(), encoding="utf-8")
    assert load_design(path).identity == design.identity
    assert generate_design(load_design(path)).source == find_code(True).source
    path.write_text(design.to_text().replace('"high":', '"high": 1', 1), encoding="utf-8")
    with pytest.raises(InputError, match=r"no design|does not belong"):
        load_design(path)


def test_units_of_another_design_are_refused_with_the_reason() -> None:
    design = find_design(network=True)
    with pytest.raises(CheckError, match="same outputs"):
        design.fit(make_unit(0, outputs=2))
    with pytest.raises(CheckError, match="same operations"):
        design.fit(make_unit(0, network=False))
    with pytest.raises(CheckError, match="same sample period"):
        make_design([make_unit(0), replace(make_unit(1), sample_period_s=2.0)])
    described, calibration = describe_unit(3)
    strong = quantize(replace(described, coefficients=described.coefficients * 1e3), calibration)
    with pytest.raises(CheckError, match=r"does not fit|do not fit|needs a coarser"):
        design.fit(strong)


def test_blocks_of_another_kind_are_told_apart() -> None:
    design = find_design(network=True)
    content = make_block(design, design.fit(list_units(True)[0]))
    words = np.frombuffer(content, dtype="<u4")
    for changed, told in (
        (words.astype(">u4").tobytes(), "highest byte first"),
        (content[:-1], "was cut"),
        (content[:20], "no block"),
        (b"\0" + content[1:], "begins with"),
        (content[:70] + bytes([content[70] ^ 1]) + content[71:], "CRC"),
        (content[:4] + b"\0\0\0\0" + content[8:], "older format"),
    ):
        with pytest.raises(InputError, match=told):
            decode(design, changed, "SN1.bin")
    other = make_design([make_unit(0)])
    with pytest.raises(InputError, match="of design"):
        decode(other, content, "SN1.bin")
    with pytest.raises(InputError, match="24"):
        make_block(design, design.fit(list_units(True)[0]), serial="x" * 25)
