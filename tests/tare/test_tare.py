"""Drift counted from a moment on: the same in reference, ONNX, host and chip, and proven."""

import json
from dataclasses import replace
from datetime import date
from pathlib import Path

import numpy as np
import pytest

from tests.blocks.units import describe_unit
from tests.golden.vectors import load
from tests.projects import render_toml
from tests.prove.models import prove
from tests.variable_step.models import make_model
from tests.verify.conftest import Agreed, write_firmware
from zerodrift.base.config import load_config, parse_config
from zerodrift.blocks.block import BlockNotes
from zerodrift.blocks.design import make_design
from zerodrift.c_runtime.cores import find_cross_compilers
from zerodrift.c_runtime.host import HostModel, render_sources
from zerodrift.codegen.generate import generate, generate_design, generate_unit
from zerodrift.export.integer_model import FLAG_CLAMPED, FLAG_DAMAGED, FLAG_TARED, IntegerModel
from zerodrift.export.model_files import load_model
from zerodrift.export.quantize import quantize
from zerodrift.export.reference import Reference
from zerodrift.verify.certificate import certify, certify_design
from zerodrift.verify.firmware_check import check_onnx
from zerodrift.verify.folder_check import check_behaviour
from zerodrift.verify.host_check import check_host
from zerodrift.verify.onnx_model import OnnxModel
from zerodrift.verify.replay import replay
from zerodrift.verify.vectors import draw_sequences
from zerodrift_proof.certificate.check import compare
from zerodrift_proof.equality.build import OPEN, PROVEN

NAMES = ("no_reading", "no_reading, guarded", "effects", "variable step, guarded")


def make(name: str) -> IntegerModel:
    kind, *guarded = name.split(", ")
    model = make_model() if kind == "variable step" else load(kind).model
    return replace(model, tare=True, guarded=bool(guarded))


@pytest.fixture(
    scope="module",
    params=[NAMES[0], *(pytest.param(name, marks=pytest.mark.long) for name in NAMES[1:])],
)
def host(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> HostModel:
    """A model with a tare on this machine."""
    model = make(request.param)
    return HostModel(model, generate(model), tmp_path_factory.mktemp("host"))


def test_steps_before_a_tare_are_as_without(host: HostModel) -> None:
    plain = Reference(replace(host.model, tare=False))
    for codes in draw_sequences(host.model, 1000).values():
        expected = plain.run(codes[None])
        found = host.run(codes)
        assert (found.drift == expected.drift[0]).all()
        assert (found.flags == expected.flags[0]).all()
        assert check_host(host, codes).mismatch is None


def test_drift_counts_from_the_last_answer(host: HostModel) -> None:
    codes = draw_sequences(host.model, 1500)["walk"]
    plain = host.run(codes[:120]).drift.astype(np.int64)
    host.run(codes[:60])
    host.tare()
    found = host.run(codes[60:120], restart=False)
    wide = plain[60:] - plain[59]
    assert (found.drift == np.clip(wide, -(2**31), 2**31 - 1)).all()
    assert ((found.flags & FLAG_TARED) > 0).all()
    host.untare()
    again = host.run(codes[:30], restart=False)
    assert not (again.flags & FLAG_TARED).any()


def test_reference_and_onnx_equal_the_host_after_a_tare(host: HostModel) -> None:
    codes = draw_sequences(host.model, 1000)["noise"]
    reference, runtime = Reference(host.model), OnnxModel(host.model)
    assert check_onnx(runtime, host, codes).mismatch is None
    state = reference.take_tare(reference.run(codes[None, :40]).state)
    expected = reference.run(codes[None, 40:], state=state)
    host.run(codes[:40])
    host.tare()
    found = host.run(codes[40:], restart=False)
    told = runtime.run(codes[None, 40:], state=state.pack())
    for drift, flags in ((found.drift, found.flags), (told.drift[0], told.flags[0])):
        assert (drift == expected.drift[0]).all()
        assert (flags == expected.flags[0]).all()
    assert (host.pack(state.pack().size) == expected.state.pack()[0]).all()
    assert (told.state == expected.state.pack()).all()


def test_verify_tries_it(host: HostModel) -> None:
    codes = draw_sequences(host.model, 1000)["walk"]
    assert check_behaviour(host, codes) == ()


def test_before_the_first_answer_nothing_happens(host: HostModel) -> None:
    codes = draw_sequences(host.model, 1000)["walk"]
    expected = host.run(codes[:20])
    host.run(codes[:1])
    host.run(codes[:0])  # settled again
    host.tare()
    found = host.run(codes[:20], restart=False)
    assert not (found.flags & FLAG_TARED).any()
    assert (found.drift == expected.drift).all()


def test_damage_ends_it(host: HostModel) -> None:
    codes = draw_sequences(host.model, 1000)["walk"]
    host.run(codes[:20])
    host.tare()
    host.overwrite(b"\xff" * 4)
    host.tare()
    found = host.run(codes[20:30], restart=False)
    assert found.flags[0] == FLAG_DAMAGED
    assert not (found.flags[1:] & FLAG_TARED).any()


@pytest.mark.spread(1, "tare", [-(2**31), 2**31 - 1])
def test_a_difference_that_does_not_fit_is_limited_and_flagged(tare: int, tmp_path: Path) -> None:
    """Answers of this model are far from 2^31: what is taken off is written into the state."""
    model = make("no_reading")
    count = len(model.outputs)
    host = HostModel(model, generate(model), tmp_path)
    codes = draw_sequences(model, 2000)["rails"]
    host.run(codes[:20])
    host.tare()
    state = host.save()[12 : 12 + host.state_bytes]
    reference = Reference(model)
    own = reference.take_tare(reference.run(codes[None, :20]).state)
    answers = own.tare[0, :count].astype("<i4").tobytes()
    at = state.index(2 * answers) + len(answers)
    taken_off = np.full(count, tare, dtype="<i4").tobytes()
    host.overwrite(state[:at] + taken_off + state[at + len(answers) :])
    own.tare[0, count:-1] = tare
    given = codes[20:60]
    expected = reference.run(given[None], state=own)
    told = OnnxModel(model).run(given[None], state=own.pack())
    found = host.run(given, restart=False)
    for drift, flags in ((found.drift, found.flags), (told.drift[0], told.flags[0])):
        assert (drift == expected.drift[0]).all()
        assert (flags == expected.flags[0]).all()
    limited = (expected.drift[0] == (2**31 - 1 if tare < 0 else -(2**31))).any(axis=1)
    assert limited.any()
    assert ((expected.flags[0] & FLAG_CLAMPED) > 0)[limited].all()


@pytest.mark.parametrize("core", ["cortex-m0plus", "cortex-m4", "rv32imc"])
def test_an_emulated_core_does_the_same(core: str, tmp_path: Path) -> None:
    if not find_cross_compilers(core):
        pytest.skip(f"no compiler for {core}")
    from zerodrift.c_runtime.emulator import EmulatedModel

    model = make("no_reading, guarded")
    chip = EmulatedModel(model, generate(model), core, tmp_path)
    codes = draw_sequences(model, 500)["walk"][:80]
    chip.run(codes[:40])
    chip.tare()
    drift, flags = chip.run(codes[40:], restart=False)
    reference = Reference(model)
    state = reference.take_tare(reference.run(codes[None, :40]).state)
    expected = reference.run(codes[None, 40:], state=state)
    assert (drift == expected.drift[0]).all()
    assert (flags == expected.flags[0]).all()


@pytest.mark.spread(0, "name", NAMES)
def test_certificate_holds_and_the_c_is_proven(name: str) -> None:
    model = make(name)
    code = generate(model)
    outcome = compare(json.loads(certify(model, code)), render_sources(code))
    assert outcome.understood
    assert not outcome.failures
    shown = {one.what: one.verdict for one in prove(model, render_sources(code))}
    assert OPEN not in shown.values()
    assert shown["tare"] == shown["untare"] == shown["step"] == PROVEN


CHANGES = {
    "tare": ("s->tare[k] = s->answered[k];", "s->tare[k] = s->answered[0];"),
    "untare": ("    s->tared = 1;\n", "    s->tared = 0;\n"),
    "step": ("s->answered, &s->tared, s->tare,", "s->tare, &s->tared, s->answered,"),
    "state_is_sound": ("(s->tared > 2)", "(s->tared > 3)"),
}


@pytest.mark.spread(0, "what", sorted(CHANGES))
def test_changed_c_is_not_proven(what: str) -> None:
    model = make("no_reading")
    code = generate(model)
    before, after = CHANGES[what]
    assert before in code.source
    texts = {**render_sources(code), code.source_name: code.source.replace(before, after, 1)}
    found = {one.what for one in prove(model, texts) if one.verdict == OPEN}
    assert what in found


def test_a_changed_tare_is_noticed_by_verify(tmp_path: Path) -> None:
    model = make("no_reading")
    code = generate(model)
    changed = code.source.replace("s->tare[k] = s->answered[k];", "s->tare[k] = 0;")
    host = HostModel(model, replace(code, source=changed), tmp_path)
    found = check_behaviour(host, draw_sequences(model, 1000)["walk"])
    assert any("after tare" in text for text in found)


def test_a_block_has_it_too(tmp_path: Path) -> None:
    units = [replace(quantize(*describe_unit(seed)), tare=True) for seed in (1, 2)]
    design = make_design(units)
    unit = design.fit(units[0])
    code = generate_unit(design, unit, BlockNotes("SN1", date(2026, 1, 1), 1))
    host = HostModel(unit, code, tmp_path)
    codes = draw_sequences(unit, 1000)["walk"]
    assert check_behaviour(host, codes) == ()
    program = generate_design(design)
    outcome = compare(json.loads(certify_design(design, program)), render_sources(program))
    assert outcome.understood
    assert not outcome.failures


@pytest.mark.long
def test_a_firmware_folder_is_verified(tmp_path: Path) -> None:
    directory = write_firmware(tmp_path / "project", make("no_reading"))
    assert load_model(directory / "build" / "model.json").tare
    assert not replay(load_config(directory), consent=Agreed()).problems


def test_it_is_off_unless_asked_for() -> None:
    rest = '[logs]\ntrain = ["a.csv"]\n[firmware]\n'
    assert not parse_config(render_toml(rest), Path("zerodrift.toml")).firmware_tare
    assert parse_config(render_toml(rest + "tare = true\n"), Path("zerodrift.toml")).firmware_tare
    model = load("no_reading").model
    code = generate(model)
    for word in ("tare", "TARED", "answered"):
        assert word not in code.source + code.header + code.harness
    assert "tare" not in model.to_text()
