"""The golden files: what the reference says today, and what every host compiler makes of them."""

from pathlib import Path

import numpy as np
import pytest
from tests.golden.models import C_CASE, CASES, make
from tests.golden.vectors import FOLDER, crc_of, load, run_host, run_reference

from zerodrift.c_runtime.compilers import Compiler, find_compilers
from zerodrift.c_runtime.host import HostModel
from zerodrift.codegen.generate import generate
from zerodrift.operations.recurrent import H_LIMIT_Q30

REMEDY = "`make golden` writes it again; read the diff"


@pytest.mark.parametrize("name", CASES)
def test_golden_files_are_made_again_byte_for_byte(name: str, tmp_path: Path) -> None:
    golden = make(name)
    golden.model.save(tmp_path / "model.json")
    assert (tmp_path / "model.json").read_bytes() == (FOLDER / f"{name}.model.json").read_bytes()
    assert golden.to_text() == (FOLDER / f"{name}.vectors.json").read_text(), REMEDY


def test_golden_c_is_generated_again_byte_for_byte() -> None:
    code = generate(load(C_CASE).model)
    assert code.header == (FOLDER / code.header_name).read_text(encoding="utf-8"), REMEDY
    assert code.source == (FOLDER / code.source_name).read_text(encoding="utf-8"), REMEDY


@pytest.mark.parametrize("name", CASES)
def test_reference_replays_golden_vectors(name: str) -> None:
    golden = load(name)
    rows = run_reference(golden.model, golden.codes, golden.settled)
    np.testing.assert_array_equal(rows[golden.every - 1 :: golden.every], golden.rows)
    assert crc_of(rows) == golden.crc


@pytest.mark.spread(1, "compiler", find_compilers(), ids=lambda compiler: compiler.name)
@pytest.mark.parametrize("name", CASES)
def test_host_c_replays_golden_vectors(name: str, compiler: Compiler, tmp_path: Path) -> None:
    golden = load(name)
    host = HostModel(golden.model, generate(golden.model), tmp_path, compiler)
    rows = run_host(host, golden.codes, golden.settled)
    np.testing.assert_array_equal(rows[golden.every - 1 :: golden.every], golden.rows)
    assert crc_of(rows) == golden.crc
    assert host.selftest() == 0


def test_golden_models_reach_what_they_are_named_for() -> None:
    """Guards the set itself: a saturation case that does not saturate would prove nothing."""
    clamped = 8
    saturation, ordinary = load("saturation"), load("ordinary")
    flags = saturation.rows[:, len(saturation.model.outputs)]
    assert (flags & clamped).any() and not (flags & clamped).all()
    hidden = saturation.rows[:, len(saturation.model.outputs) + 1 :]
    assert np.abs(hidden).max() >= H_LIMIT_Q30 - 2
    assert not ordinary.rows[:, len(ordinary.model.outputs)].any()
    assert {-32768, 32767} == set(np.unique(load("rails").codes).tolist())
    dwell = load("long_dwell")
    answers = dwell.rows[-2:, : len(dwell.model.outputs)]  # a hundred steps apart
    assert (answers == answers[-1]).all(), "the outputs are at rest at last"
    assert (dwell.rows[0] != dwell.rows[-1]).any(), "and not from the start"
    assert load("odd_hidden").model.recurrent.gru.hidden % 4 != 0
