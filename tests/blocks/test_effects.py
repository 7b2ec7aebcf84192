"""Powers of two, plays, delays and loads in a block: numbers that differ from unit to unit."""

import hashlib
import importlib.util
import json
import re
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from tests.blocks.draws import draw_admissible, list_inadmissible, read_design, write_block
from tests.blocks.test_blocks import make_block
from tests.blocks.units import describe_effects
from zerodrift.base.errors import CheckError, InputError
from zerodrift.blocks.block import apply, decode
from zerodrift.blocks.design import BlockDesign, make_design
from zerodrift.blocks.proof import prove_set
from zerodrift.c_runtime.compilers import RUNTIME_FILES
from zerodrift.c_runtime.host import HostModel
from zerodrift.codegen.generate import GeneratedCode, generate_design
from zerodrift.export.integer_model import IntegerModel
from zerodrift.export.quantize import quantize
from zerodrift.export.reference import Reference
from zerodrift.verify.certificate import certify_design
from zerodrift.verify.host_check import check_host
from zerodrift.verify.vectors import draw_sequences
from zerodrift_proof.certificate.check import CertificateOutcome, compare

SEEDS = range(8)


@cache
def list_units() -> tuple[IntegerModel, ...]:
    """Return simulated units with every such effect."""
    return tuple(quantize(*describe_effects(seed)) for seed in SEEDS)


@cache
def find_design() -> BlockDesign:
    """Return the design of those units."""
    return make_design(list_units())


@cache
def find_code() -> GeneratedCode:
    """Return its C."""
    return generate_design(find_design())


def test_the_blocks_hold_what_differs() -> None:
    held = {(f.place.node.split("_")[0], f.place.attribute) for f in find_design().fields}
    for wanted in (("exp2", "coefficient"), ("exp2", "high"), ("play", "half_width")):
        assert wanted in held
    assert ("delay", "newer_q31") in held and ("load", "low") in held
    tops = [{n.top for n in u.nodes if n.kind == "exp2"} for u in list_units()]
    assert any(top != tops[0] for top in tops)  # results of other scales


def test_one_program_computes_what_each_units_reference_does(tmp_path: Path) -> None:
    design = find_design()
    host = HostModel(design.model, find_code(), tmp_path)
    for unit in list_units():
        model = design.fit(unit)
        assert host.use_block(make_block(design, model)) == 0
        assert host.selftest() == 0
        host.model = model
        for settled, codes in enumerate(draw_sequences(model, 500).values()):
            check = check_host(host, codes, settled=settled % 2 == 0)
            assert check.mismatch is None, check.mismatch


@pytest.mark.long
def test_the_common_format_costs_next_to_nothing() -> None:
    design = find_design()
    for own in list_units():
        codes = draw_sequences(own, 2000)["walk"][None]
        drifts = [Reference(m).run(codes).drift[0] for m in (own, design.fit(own))]
        assert np.abs(drifts[0].astype(np.int64) - drifts[1]).max() <= 3  # 3e-4 N of 200 N


@pytest.mark.spread(0, "core", ["cortex-m0plus", "cortex-m4", "rv32imc"])
def test_cores_give_the_references_bits(core: str, tmp_path: Path) -> None:
    if any(importlib.util.find_spec(name) is None for name in ("unicorn", "ziglang")):
        pytest.skip("emulation needs the unicorn and ziglang wheels")
    from zerodrift.c_runtime.emulator import EmulatedModel

    design = find_design()
    model = design.fit(list_units()[2])
    code = generate_design(design, make_block(design, model))
    chip = EmulatedModel(model, code, core, tmp_path)
    assert chip.selftest() == 0
    for codes in draw_sequences(model, 250).values():
        drift, flags = chip.run(codes)
        expected = Reference(model).run(codes[None])
        assert np.array_equal(drift, expected.drift[0])
        assert np.array_equal(flags, expected.flags[0])


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
    told, count = read_design(design.to_text()), 0
    for seed in range(2):
        for what, content in list_inadmissible(told, seed):
            assert host.use_block(content) != 0, what
            with pytest.raises(InputError):
                decode(design, content, "drawn")
            count += 1
    assert count > 90


def test_delays_of_other_steps_are_refused() -> None:
    unit = list_units()[0]
    later = replace(
        unit,
        nodes=tuple(replace(n, steps=n.steps + 1) if n.kind == "delay" else n for n in unit.nodes),
    )
    with pytest.raises(CheckError, match="different steps"):
        make_design([unit, later])
    with pytest.raises(CheckError, match="different steps"):
        make_design([unit]).fit(later)


def test_a_set_that_is_too_wide_is_not_proven() -> None:
    design = find_design()
    names = {f.place.attribute: f.place.name for f in design.fields}
    for name, low, high in (
        (names["half_width"], -1, 5),
        (names["half_width"], 0, 2**31 - 1),
        (names["newer_q31"], -1, 5),
        (names["coefficient"], -(2**62), 2**62),
        ("exp2_1_high", -(2**31), 2**31 - 1),
        ("load_1_low", -(2**31), 2**31 - 1),
    ):
        assert name in {f.place.name for f in design.fields}
        fields = [type(f)(f.place, low, high) if f.place.name == name else f for f in design.fields]
        with pytest.raises(CheckError):
            prove_set(design.model, fields)


def derive_again(pattern: str = "", to: str = "") -> CertificateOutcome:
    """Return what becomes of the claims about a C that was changed, its hash told anew."""
    code = find_code()
    source = re.sub(pattern, to, code.source, count=1) if pattern else code.source
    assert not pattern or source != code.source
    told = json.loads(certify_design(find_design(), code))
    texts = {code.header_name: code.header, code.source_name: source}
    texts |= {path.name: path.read_text(encoding="utf-8") for path in RUNTIME_FILES}
    told["files"] = {
        name: hashlib.sha256(text.encode()).hexdigest() for name, text in texts.items()
    }
    return compare(told, texts)


@pytest.mark.long
def test_the_certificate_holds_of_every_block() -> None:
    outcome = derive_again()
    assert outcome.understood and not outcome.failures


@pytest.mark.spread(
    2,
    ("pattern", "to"),
    [
        (r"(within_i32\(&b->play_\d+_half_width, 1u, )\d+", r"\g<1>-1"),
        (r"    within &= cell_within_i32\(&b->delay_\d+_newer_q31.*\n", ""),
        (r"(within_i32\(&b->exp2_1_high, 1u, -?\d+, )\d+", r"\g<1>2147483647"),
        (r"(within_i32\(&b->load_1_high, 1u, -?\d+, )\d+", r"\g<1>2147483647"),
        (r"    within &= cell_within_i32\(&b->exp2_1_coefficient.*\n", ""),
        (r"\(s->drift\[0\] < -?\d+\)", "(s->drift[0] < 0)"),
    ],
)
def test_a_c_that_lets_more_through_is_refused(pattern: str, to: str) -> None:
    assert derive_again(pattern, to).failures
