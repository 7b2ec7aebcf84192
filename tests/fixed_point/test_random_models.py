"""Random models of every shape: the C of a host compiler equals the reference at 0 LSB."""

import tempfile
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


@pytest.mark.slow
@settings(max_examples=300, deadline=None, suppress_health_check=RELAXED)
@given(
    shape=shapes(),
    seed=st.integers(0, 2**31),
    optimise=st.sampled_from(("-O0", "-O1", "-O2", "-O3", "-Os")),
    lanes=st.sampled_from(((), ("-DZD_LANES=2u",))),
    compiler=st.integers(0, 1),
)
def test_many_random_models_equal_host_c(
    shape: Shape, seed: int, optimise: str, lanes: tuple[str, ...], compiler: int
) -> None:
    compare(shape, seed, steps=3000, flags=(optimise, *lanes), compiler=compiler)
