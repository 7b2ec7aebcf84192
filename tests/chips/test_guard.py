"""`[firmware] guard`: every single bit that flips in a live state is noticed."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from benchmarks.bench_builds import load, measure_cost
from tests.golden.model_factory import Draw, Shape, draw_model

from zerodrift.c_runtime.compilers import Compiler
from zerodrift.c_runtime.cores import find_cross_compilers
from zerodrift.c_runtime.host import HostModel
from zerodrift.codegen import generate as generate_module
from zerodrift.codegen.generate import generate
from zerodrift.export.integer_model import FLAG_DAMAGED, IntegerModel
from zerodrift.export.model_files import load_model
from zerodrift.verify.certificate import FILE_NAME, certify
from zerodrift.verify.host_check import check_host
from zerodrift_proof.certificate.check import check_certificate

SHAPES = {
    "stream": Shape(front_end=("lowpass", "delay"), hidden=6, inputs=2, outputs=2),
    "window": Shape(window=3, hidden=4, inputs=3, outputs=1),
    "loops": Shape(front_end=("delay",), window=3, hidden=4, inputs=3, outputs=1),
    "stack": Shape(inputs=2, hidden=4, outputs=2, upper=(3,)),
    "fed back": Shape(hidden=0, inputs=2, outputs=2, front_end=("lowpass",), measured=(0, 1)),
}


@pytest.fixture(autouse=True)
def shorten_fields(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Sum the shape "loops" up as a model with longer fields is."""
    if "loops" in request.node.name:
        monkeypatch.setattr(generate_module, "MOST_WRITTEN_OUT", 1)


def draw_guarded(name: str, seed: int = 31) -> IntegerModel:
    return replace(draw_model(SHAPES[name], seed), guarded=True)


@pytest.mark.parametrize("name", SHAPES)
def test_every_bit_that_flips_is_flagged_or_counts_for_nothing(name: str, tmp_path: Path) -> None:
    """What is not flagged lies after the last number: it changes no bit of any later answer."""
    model = draw_guarded(name)
    host = HostModel(model, generate(model), tmp_path, flags=("-O1",), observe=False)
    codes = Draw(3).codes(-9000, 9000, 40, len(model.channels))
    whole = host.run(codes)
    host.run(codes[:30])
    kept = host._state.raw
    silent = 0
    for bit in range(8 * host.state_bytes):
        flipped = bytearray(kept)
        flipped[bit // 8] ^= 1 << bit % 8
        host._state.raw = bytes(flipped)
        after = host.run(codes[30:], restart=False)
        if after.flags[0] & FLAG_DAMAGED:
            assert not after.drift[0].any() and not (after.flags[1:] & FLAG_DAMAGED).any()
        else:
            silent += 1
            np.testing.assert_array_equal(after.drift, whole.drift[30:])
            np.testing.assert_array_equal(after.flags, whole.flags[30:])
    assert silent % 8 == 0 and silent <= 8 * 7  # whole bytes at the struct's end


def test_without_the_guard_flips_go_unnoticed(tmp_path: Path) -> None:
    """Or the test above would show nothing."""
    model = replace(draw_guarded("stream"), guarded=False)
    host = HostModel(model, generate(model), tmp_path, flags=("-O1",), observe=False)
    codes = Draw(3).codes(-9000, 9000, 40, len(model.channels))
    whole = host.run(codes)
    host.run(codes[:30])
    kept = host._state.raw
    wrong = 0
    for bit in range(8 * host.state_bytes):
        flipped = bytearray(kept)
        flipped[bit // 8] ^= 1 << bit % 8
        host._state.raw = bytes(flipped)
        after = host.run(codes[30:31], restart=False)
        wrong += bool((after.drift != whole.drift[30]).any() and after.flags[0] == whole.flags[30])
    assert wrong > 50


@pytest.mark.spread(1, "name", SHAPES)
def test_guarded_code_is_bit_exact_certified_and_saves(name: str, tmp_path: Path) -> None:
    model = draw_guarded(name)
    code = generate(model)
    host = HostModel(model, code, tmp_path)
    assert host.selftest() == 0
    codes = Draw(5).codes(-32768, 32767, 300, len(model.channels))
    for settled in (True, False):
        assert check_host(host, codes, settled=settled).mismatch is None
    host.run(codes[:100])
    saved = host.save()
    after = host.run(codes[100:], restart=False)
    assert host.restore(saved) == 0
    np.testing.assert_array_equal(host.run(codes[100:], restart=False).drift, after.drift)
    (tmp_path / FILE_NAME).write_text(certify(model, code))
    assert check_certificate(tmp_path).failures == ()


@pytest.mark.parametrize("compiler", find_cross_compilers("cortex-m4"), ids=lambda c: c.name)
@pytest.mark.spread(1, "name", ["effects", "windowed"])
def test_a_word_of_state_costs_four_instructions(name: str, compiler: Compiler) -> None:
    """Compiled for size, where compilers keep loops and calls."""
    pytest.importorskip("unicorn", reason="emulation needs the unicorn wheel")
    cost, words = measure_cost(load(name), compiler, "-Os")
    assert cost <= 4 * words + 60


def test_default_leaves_model_and_code_as_they_are(tmp_path: Path) -> None:
    plain = draw_model(SHAPES["stream"], 31)
    guarded = replace(plain, guarded=True)
    assert "uint32_t check;" not in generate(plain).header and guarded.hash != plain.hash
    assert "guarded" not in plain.to_text() and "prefix" not in plain.to_text()
    for model in (plain, replace(guarded, prefix="left arm")):
        model.save(tmp_path / "model.json")
        loaded = load_model(tmp_path / "model.json")
        assert loaded.to_text() == model.to_text() and loaded.hash == model.hash
        assert generate(loaded) == generate(model)
