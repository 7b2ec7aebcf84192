"""Random models of every shape: the C of a host compiler equals the reference at 0 LSB."""

import tempfile
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from tests.fixed_point.strategies import shapes
from tests.golden.model_factory import Shape, draw_model

from zerodrift.c_runtime.compilers import find_compilers
from zerodrift.c_runtime.host import HostModel
from zerodrift.codegen.generate import generate
from zerodrift.verify.host_check import check_host
from zerodrift.verify.vectors import draw_sequences

pytestmark = pytest.mark.long

KERNELS = [(), ("-DZD_KERNEL=0",), ("-DZD_KERNEL=1",), ("-DZD_SMALL",), ("-DZD_LANES=2u",)]
KERNELS += [("-DZD_SMALL", "-DZD_KERNEL=1"), ("-DZD_KERNEL=0", "-DZD_LANES=2u")]
if "avx2" in (Path("/proc/cpuinfo").read_text() if Path("/proc/cpuinfo").exists() else ""):
    KERNELS += [("-mavx2",)]
"""Flags for every kernel that the host can run, as targets choose them and as they do not."""
RELAXED = [HealthCheck.too_slow, HealthCheck.data_too_large, HealthCheck.large_base_example]


def compare(shape: Shape, seed: int, steps: int, flags: tuple[str, ...], compiler: int = 0) -> None:
    """Generate, compile and compare one model over noise, rails, jumps, a walk and a dwell."""
    model = draw_model(shape, seed)
    code = generate(model)
    compilers = find_compilers()
    with tempfile.TemporaryDirectory() as scratch:
        host = HostModel(
            model, code, Path(scratch), compilers[compiler % len(compilers)], flags=flags
        )
        assert host.selftest() == 0
        for settled, (name, codes) in enumerate(draw_sequences(model, steps).items()):
            check = check_host(host, codes, settled=bool(settled % 2))
            assert check.mismatch is None, f"{name}: {check.mismatch}"
            assert check.values_compared >= check.steps * (1 + len(model.outputs))


@settings(max_examples=25, deadline=None, derandomize=True, suppress_health_check=RELAXED)
@given(shape=shapes(), seed=st.integers(0, 2**31))
def test_random_model_equals_host_c(shape: Shape, seed: int) -> None:
    compare(shape, seed, steps=600, flags=("-O1",))


@pytest.mark.parametrize("kernel", KERNELS[1:], ids=" ".join)
@settings(max_examples=4, deadline=None, derandomize=True, suppress_health_check=RELAXED)
@given(shape=shapes(), seed=st.integers(0, 2**31))
def test_random_model_equals_every_kernel(kernel: tuple[str, ...], shape: Shape, seed: int) -> None:
    """Reset after the product and 16-bit weights: the models that kernels are chosen for."""
    fast = replace(shape, weights="int16", reset="after")
    compare(fast, seed, steps=300, flags=("-O1", *kernel))


@pytest.mark.slow
@settings(max_examples=300, deadline=None, suppress_health_check=RELAXED)
@given(
    shape=shapes(),
    seed=st.integers(0, 2**31),
    optimise=st.sampled_from(("-O0", "-O1", "-O2", "-O3", "-Os")),
    kernel=st.sampled_from(KERNELS),
    compiler=st.integers(0, 1),
)
def test_many_random_models_equal_host_c(
    shape: Shape, seed: int, optimise: str, kernel: tuple[str, ...], compiler: int
) -> None:
    compare(shape, seed, steps=3000, flags=(optimise, *kernel), compiler=compiler)
