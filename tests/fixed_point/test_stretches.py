"""Many steps at once give what one step after the other gives, states and flags included."""

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from tests.fixed_point.strategies import shapes
from tests.golden.model_factory import Shape, draw_model

from zerodrift.export import reference as module
from zerodrift.export.integer_model import IntegerModel
from zerodrift.export.reference import Reference
from zerodrift.operations.arithmetic import CodeArray
from zerodrift.verify.vectors import draw_sequences

RELAXED = [HealthCheck.too_slow, HealthCheck.data_too_large, HealthCheck.large_base_example]


def compare(model: IntegerModel, codes: CodeArray, *, settled: bool) -> None:
    """Run codes [B, T, C] at once, and again by single steps."""
    reference = Reference(model)
    trace = reference.run(codes, settled=settled)
    now = reference.start(codes[:, 0].astype(np.int64), settled=settled)
    for t in range(codes.shape[1]):
        now, _, drift, flags = reference.step(now, codes[:, t])
        assert np.array_equal(trace.drift[:, t], drift), t
        assert np.array_equal(trace.flags[:, t], flags), t
        hidden = [now.nodes[n.name]["h_q30"] for n in model.recurrents if n.streams]
        assert np.array_equal(trace.hidden[:, t], np.concatenate([codes[:, t, :0], *hidden], 1)), t
    assert np.array_equal(trace.state.pack(), now.pack())


@settings(max_examples=30, deadline=None, derandomize=True, suppress_health_check=RELAXED)
@given(shape=shapes(), seed=st.integers(0, 2**31), settled=st.booleans())
def test_random_model_gives_at_once_what_it_gives_step_by_step(
    shape: Shape, seed: int, settled: bool
) -> None:
    model = draw_model(shape, seed)
    sequences = draw_sequences(model, 200)
    compare(model, np.stack(list(sequences.values())), settled=settled)


@pytest.mark.parametrize("rows", [1, 35, 1 << 14])
def test_stretches_of_any_length_go_on_from_each_other(
    rows: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Readings that lack at the beginning and at the joints keep the last one before them."""
    monkeypatch.setattr(module, "STRETCH_ROWS", rows)
    model = draw_model(Shape(no_reading=(-32768,) * 4), 3)
    codes = np.stack(list(draw_sequences(model, 300).values()))
    lacks = np.random.default_rng(4).random(codes.shape) < 0.3
    lacks[:, :2] = True
    codes[lacks] = -32768
    for settled in (True, False):
        compare(model, codes, settled=settled)
