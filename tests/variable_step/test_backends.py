"""A variable step on the host, in ONNX and on emulated cores: the reference's bits."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.golden.model_factory import draw_float_model
from tests.variable_step.models import SHAPE, make_lowpass, make_model
from zerodrift.c_runtime.cores import find_cross_compilers
from zerodrift.c_runtime.host import HostModel
from zerodrift.codegen.generate import generate
from zerodrift.export.integer_model import IntegerModel
from zerodrift.export.quantize import quantize
from zerodrift.export.reference import Reference
from zerodrift.verify.firmware_check import check_onnx
from zerodrift.verify.host_check import check_host
from zerodrift.verify.mismatch import expect
from zerodrift.verify.onnx_model import OnnxModel
from zerodrift.verify.vectors import draw_golden, draw_sequences, draw_starts

STEPS = 4000


@pytest.fixture(scope="module", params=[False, True], ids=["plain", "guarded"])
def model(request: pytest.FixtureRequest) -> IntegerModel:
    """A model with everything that a variable step can have."""
    return make_model(guarded=bool(request.param))


@pytest.fixture(scope="module")
def host(model: IntegerModel, tmp_path_factory: pytest.TempPathFactory) -> HostModel:
    """Its C on this machine."""
    return HostModel(model, generate(model), tmp_path_factory.mktemp("host"))


@pytest.mark.parametrize("settled", [True, False])
def test_host_equals_the_reference(host: HostModel, settled: bool) -> None:
    for codes in draw_sequences(host.model, STEPS).values():
        assert check_host(host, codes, settled=settled).mismatch is None
    for codes in draw_starts(host.model):
        assert check_host(host, codes, settled=settled).mismatch is None


def test_selftest_passes(host: HostModel) -> None:
    assert host.selftest() == 0


@pytest.mark.spread(1, "settled", [True, False])
def test_onnx_equals_the_host(host: HostModel, settled: bool) -> None:
    runtime = OnnxModel(host.model)
    for codes in draw_sequences(host.model, 1500).values():
        assert check_onnx(runtime, host, codes, settled=settled).mismatch is None


@pytest.mark.spread(1, "core", ["cortex-m0plus", "cortex-m4", "rv32imc"])
def test_emulated_core_equals_the_reference(model: IntegerModel, core: str, tmp_path: Path) -> None:
    if not find_cross_compilers(core):
        pytest.skip(f"no compiler for {core}")
    from zerodrift.c_runtime.emulator import EmulatedModel

    walk = draw_sequences(model, 400)["walk"]
    expected = expect(model, draw_golden(model, walk)[:600])
    chip = EmulatedModel(model, generate(model), core, tmp_path)
    drift, flags, states = chip.trace(expected.codes)
    assert expected.compare(drift, flags, states=states) is None
    assert chip.selftest() == 0


def test_golden_vectors_have_steps_of_all_lengths(model: IntegerModel) -> None:
    times = draw_golden(model, draw_sequences(model, 400)["walk"])[:, -1]
    assert {0, 1, model.period_us, 2**63 - 1, -1} <= {*times.tolist()}
    bits = {int(t).bit_length() for t in times if t > 0}
    assert bits >= set(range(1, 47))


@pytest.mark.parametrize("age_us", [0, 1, 3_600_000_000, 2**61, 2**64 - 1])
def test_state_goes_on_after_sleep(host: HostModel, age_us: int) -> None:
    codes = draw_sequences(host.model, 600)["walk"]
    host.run(codes[:30])
    saved = host.save()
    host.run(codes[:2], settled=False)
    assert host.restore_after(saved, age_us) == 0
    found = host.run(codes[30:60], restart=False)
    reference = Reference(host.model)
    state = reference.sleep(reference.run(codes[None, :30]).state, age_us)
    expected = reference.run(codes[None, 30:60], state=state)
    assert (found.drift == expected.drift[0]).all()
    assert (found.flags == expected.flags[0]).all()


def test_sleeping_twice_adds_up(host: HostModel) -> None:
    codes = draw_sequences(host.model, 600)["walk"]
    host.run(codes[:30])
    assert host.restore_after(host.save(), 5_000_000) == 0
    assert host.restore_after(host.save(), 7_000_000) == 0
    twice = host.run(codes[30:40], restart=False)
    host.run(codes[:30])
    assert host.restore_after(host.save(), 12_000_000) == 0
    once = host.run(codes[30:40], restart=False)
    assert (twice.drift == once.drift).all()


def test_new_state_sleeps_without_effect(host: HostModel) -> None:
    codes = draw_sequences(host.model, 600)["walk"]
    cold = host.run(codes[:10], settled=False)
    host.run(codes[:1], settled=False)
    host.overwrite(b"\0" * host.state_bytes)
    assert host.restore_after(host.save(), 10**9) == 1  # of zeros: never started
    found = host.run(codes[:10], restart=False)
    assert (found.drift == cold.drift).all()


def test_damaged_copy_is_refused(host: HostModel) -> None:
    codes = draw_sequences(host.model, 600)["walk"]
    host.run(codes[:30])
    saved = bytearray(host.save())
    for at in range(0, len(saved), 7):
        spoilt = saved.copy()
        spoilt[at] ^= 0x20
        assert host.restore_after(bytes(spoilt), 1000) == 1


@pytest.mark.parametrize("tau_s", [1e-3, 95.0, 3.2e7])
def test_kernel_equals_the_reference_over_random_steps(tau_s: float, tmp_path: Path) -> None:
    """dt/tau from 10^-6 to 10^3, log-uniform; the benchmark runs 10^6 steps of each."""
    model = make_lowpass((tau_s,))
    host = HostModel(model, generate(model), tmp_path)
    rng = np.random.default_rng(31)
    codes = np.empty((20_000, 2), dtype=np.int64)
    codes[:, 0] = rng.integers(-32768, 32768, len(codes))
    codes[:, 1] = np.maximum(10 ** rng.uniform(-6, 3, len(codes)) * tau_s * 1e6, 1)
    assert check_host(host, codes).mismatch is None


def test_bytes_of_a_fixed_step_know_nothing_of_it() -> None:

    fixed = quantize(*draw_float_model(replace(SHAPE, warm_up_steps=5), 1))
    code = generate(fixed)
    for word in ("elapsed_us", "slept", "span_us", "step_after", "restore_after"):
        assert word not in code.source + code.header + code.harness
    assert "variable_step" not in fixed.to_text()
