"""A GRU in a block: the same bits as the reference in every layout, and no sum beyond 32 bits."""

import hashlib
import json
import re
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from tests.blocks.draws import draw_admissible, list_inadmissible, read_design, write_block
from tests.blocks.test_blocks import make_block
from tests.blocks.units import describe_unit, draw_gru, make_unit
from zerodrift.base.errors import CheckError, InputError
from zerodrift.blocks.block import apply, decode
from zerodrift.blocks.design import BlockDesign, load_design, make_design
from zerodrift.blocks.gru import put_stream, read_stream
from zerodrift.c_runtime.compilers import RUNTIME_FILES
from zerodrift.c_runtime.host import HostModel
from zerodrift.codegen.generate import GeneratedCode, generate_design
from zerodrift.export.float_network import FloatNetwork
from zerodrift.export.integer_model import IntegerModel
from zerodrift.export.quantize import quantize
from zerodrift.operations.lstm.cell import FloatLstm
from zerodrift.verify.certificate import certify_design
from zerodrift.verify.host_check import check_host
from zerodrift.verify.vectors import draw_sequences
from zerodrift.verify.ways import list_host_ways
from zerodrift_proof.certificate.check import CertificateOutcome, compare

HIDDEN = 5
"""Odd, so that rows are filled up, and their words as well."""
SEEDS = range(300, 304)


def list_units() -> tuple[IntegerModel, ...]:
    """Return simulated units with a GRU each."""
    return tuple(make_unit(seed, outputs=2, hidden=HIDDEN) for seed in SEEDS)


@cache
def find_design() -> BlockDesign:
    """Return the design of those units."""
    return make_design(list_units())


@cache
def find_code() -> GeneratedCode:
    """Return its C."""
    return generate_design(find_design())


def require_bits(host: HostModel, model: IntegerModel, steps: int) -> None:
    """Hold the C with the block that it has against the reference."""
    host.model = model
    for settled, codes in enumerate(draw_sequences(model, steps).values()):
        check = check_host(host, codes, settled=settled % 2 == 0)
        assert check.mismatch is None, check.mismatch


@pytest.mark.long
def test_one_program_computes_what_each_units_reference_does(tmp_path: Path) -> None:
    design = find_design()
    host = HostModel(design.model, find_code(), tmp_path)
    shifts = {unit.recurrent.gru.shift for unit in list_units()}
    assert len(shifts) > 1  # they have something to be aligned
    for unit in list_units():
        model = design.fit(unit)
        assert model.recurrent.gru.shift == design.model.recurrent.gru.shift
        assert host.use_block(make_block(design, model)) == 0
        assert host.selftest() == 0
        require_bits(host, model, 500)


@pytest.mark.long
def test_every_layout_gives_the_same_bits(tmp_path: Path) -> None:
    design = find_design()
    model = design.fit(list_units()[1])
    block = make_block(design, model)
    flags = [way.flags for way in list_host_ways(model) if way.needs != "avx2"]
    for number, given in enumerate(flags):
        host = HostModel(design.model, find_code(), tmp_path / str(number), flags=("-O1", *given))
        assert host.use_block(block) == 0 and host.selftest() == 0
        require_bits(host, model, 200)


def test_a_window_takes_the_block_too(tmp_path: Path) -> None:
    units = []
    for seed in SEEDS[:2]:
        described, calibration = describe_unit(seed, outputs=2, hidden=HIDDEN)
        units.append(quantize(replace(described, window=6), calibration))
    design = make_design(units)
    host = HostModel(design.model, generate_design(design), tmp_path)
    model = design.fit(units[0])
    assert host.use_block(make_block(design, model)) == 0
    require_bits(host, model, 200)


@pytest.mark.long
def test_any_admissible_block_computes_what_the_reference_does(tmp_path: Path) -> None:
    design = find_design()
    host = HostModel(design.model, find_code(), tmp_path)
    told = read_design(design.to_text())
    for seed in range(120):
        content = write_block(told, draw_admissible(told, seed))
        assert host.use_block(content) == 0
        model = apply(design, decode(design, content, "drawn"))
        model.prove()
        host.model = model
        codes = draw_sequences(model, 60)["jumps" if seed % 2 else "rails"]
        assert check_host(host, codes, settled=True).mismatch is None


def test_no_inadmissible_block_is_accepted(tmp_path: Path) -> None:
    design = find_design()
    host = HostModel(design.model, find_code(), tmp_path)
    told, sums = read_design(design.to_text()), 0
    for seed in range(4):
        for what, content in list_inadmissible(told, seed):
            assert host.use_block(content) != 0, what
            with pytest.raises(InputError) as refusal:
                decode(design, content, "drawn")
            sums += "could reach" in str(refusal.value)
    assert sums == 16


def test_the_design_comes_back_from_its_file(tmp_path: Path) -> None:
    path = tmp_path / "design.json"
    path.write_text(find_design().to_text(), encoding="utf-8")
    assert generate_design(load_design(path)).source == find_code().source


def test_the_stream_comes_back() -> None:
    for hidden in (1, 2, 3, 4, 7):
        gru = make_unit(7, hidden=hidden).recurrent.gru
        again = put_stream(gru, read_stream(gru))
        for name in ("w_x", "w_h", "bias"):
            assert np.array_equal(getattr(again, name), getattr(gru, name))


def swap_reset(model):
    """Return a model whose reset gate acts before the recurrent product."""
    (gru,) = model.network.grus
    return replace(model, network=model.network.replace_grus([replace(gru, reset="before")]))


def stack_up(model):
    """Return a model with a second layer on the first."""
    network, upper = model.network, draw_gru(1, 2, 2)
    cells = (*network.grus, *upper.grus)
    return replace(model, network=FloatNetwork.stack(cells, network.head, network.head_bias))


@pytest.mark.parametrize(
    ("change", "why"), [(stack_up, "several layers"), (swap_reset, "reset before")]
)
def test_what_no_block_holds_is_refused(change: Callable[..., object], why: str) -> None:
    described, calibration = describe_unit(3, outputs=2, hidden=2)
    with pytest.raises(CheckError, match=why):
        make_design([quantize(change(described), calibration)])


def test_a_gru_with_weights_of_8_bits_is_refused_by_name() -> None:
    with pytest.raises(CheckError, match=r"'gru' .*8 bits cannot stand in a block.*int16"):
        make_design([quantize(*describe_unit(3, outputs=2, hidden=2), "int8")])


def test_an_lstm_is_refused_by_name() -> None:
    described, calibration = describe_unit(3, outputs=2, hidden=2)
    rng = np.random.default_rng(4)
    cell = FloatLstm(*(rng.uniform(-0.5, 0.5, (4, 2, n)) for n in (2, 2)), np.zeros((4, 2)))
    network = FloatNetwork.stack((cell,), rng.normal(size=(2, 2)), np.zeros(2))
    with pytest.raises(CheckError, match=r"lstm.*cannot stand in a block.*lag_bank"):
        make_design([quantize(replace(described, network=network), calibration)])


def test_units_that_do_not_fit_are_refused_with_the_reason() -> None:
    described, calibration = describe_unit(3, outputs=2, hidden=HIDDEN)
    with pytest.raises(CheckError, match="8 bits"):
        make_design([quantize(described, calibration, "int8")])
    design = find_design()
    with pytest.raises(CheckError, match="one size"):
        design.fit(make_unit(300, outputs=2, hidden=HIDDEN + 1))
    (gru,) = described.network.grus
    network = described.network.replace_grus([replace(gru, w_h=gru.w_h * 30)])
    strong = replace(described, network=network)
    with pytest.raises(CheckError, match="coarser format"):
        design.fit(quantize(strong, calibration))


# --- the certificate


def derive_again(change: Callable[[str], str] = lambda text: text) -> CertificateOutcome:
    """Return what becomes of the claims about a C that was changed, its hash told anew."""
    code = find_code()
    told = json.loads(certify_design(find_design(), code))
    texts = {code.header_name: code.header, code.source_name: change(code.source)}
    texts |= {path.name: path.read_text(encoding="utf-8") for path in RUNTIME_FILES}
    told["files"] = {
        name: hashlib.sha256(text.encode()).hexdigest() for name, text in texts.items()
    }
    return compare(told, texts)


def test_the_certificate_holds_of_every_block() -> None:
    outcome = derive_again()
    assert outcome.understood and not outcome.failures
    assert outcome.holds > 4 * HIDDEN + len(find_design().fields)


@pytest.mark.spread(
    3,
    ("pattern", "to"),
    [
        (r"    within &= cell_gru_within.*\n", ""),
        (r"(cell_gru_within\(b->gru_stream, )5u", r"\g<1>4u"),
        (r"(cell_gru_within\(b->gru_stream, 5u, )1u, 3u", r"\g<1>2u, 2u"),
        (r"norm <= \(", "norm < ("),
        (r"\(UINT32_C\(2147483647\) - most\)", "UINT32_C(2147483647)"),
        (r"norms\[g\] \+= cell_size\(zd_asr32\(both, 16u\)\);", ""),
        (r"within &= cell_sum_fits\(inside, of_h\[2\]\);", ""),
        (r"of_h\[2\]\)\) / 2u\)", "of_h[2])) / 4u)"),
        (r"words = 4u \+", "words = 3u +"),
        (r"gru = \{b->gru_stream, \{\d+", "gru = {b->gru_stream, {32"),
        (r"gru = \{b->gru_stream, \{\d+", "gru = {b->gru_stream, {1"),
        (r"gru_step\(b, features", "gru_step(NULL, features"),
        (r"gru_assembly\(gru.stream", "gru_assembly(&gru.stream[1]"),
    ],
)
def test_a_c_that_lets_more_through_is_refused(pattern: str, to: str) -> None:
    def change(text: str) -> str:
        changed = re.sub(pattern, to, text, count=1)
        assert changed != text
        return changed

    assert derive_again(change).failures
