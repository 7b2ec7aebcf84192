"""Weights in a coarser format, rounded together: nearer to the unit's own than one by one."""

from dataclasses import replace

import numpy as np
import pytest

from tests.blocks.units import LSB_K, describe_unit, make_unit
from zerodrift.blocks.design import make_design
from zerodrift.blocks.gru import (
    RUNS,
    STEPS,
    align_layers,
    draw_codes,
    find_overflow,
    read_stream,
    refine,
    round_rows,
    visit,
)
from zerodrift.export.integer_model import IntegerModel
from zerodrift.export.quantize import quantize
from zerodrift.export.reference import Reference


def draw_wave(seed: int) -> np.ndarray:
    """Return codes [1, n, 1] that are not among those for which weights are rounded."""
    rng = np.random.default_rng(seed)
    t, (slow, quick) = np.arange(1500), rng.uniform(0, 2 * np.pi, 2)
    wave = 20 + 20 * np.sin(t * 2 * np.pi / 1500 + slow) + np.sin(t * 2 * np.pi / 400 + quick)
    return np.round(wave / LSB_K).astype(np.int16)[None, :, None]


def measure(model: IntegerModel, own: IntegerModel, codes: np.ndarray) -> float:
    """Return how far the states of two models are apart, root mean square."""
    states = [Reference(m).run(codes).hidden.astype(float) for m in (model, own)]
    return float(np.sqrt(np.mean((states[0] - states[1]) ** 2)))


@pytest.mark.long
def test_a_design_keeps_states_nearer_than_rounding_each_weight_does() -> None:
    units = [make_unit(seed, outputs=2, hidden=8) for seed in range(40, 46)]
    design = make_design(units)
    coarser = 0
    for seed, own in enumerate(units):
        fitted, layer = design.fit(own), own.recurrent
        if fitted.recurrent.gru.shift == layer.gru.shift:
            continue
        coarser += 1
        (plain,) = align_layers([layer.gru], "gru", design.model.recurrent.gru, 0.0)
        one_by_one = replace(
            fitted,
            nodes=tuple(replace(n, gru=plain) if n.kind == "gru" else n for n in fitted.nodes),
        )
        errors = [measure(m, own, draw_wave(seed)) for m in (fitted, one_by_one)]
        assert errors[0] < errors[1]
    assert coarser >= 3


def test_what_is_in_the_format_already_stays() -> None:
    units = [make_unit(seed, outputs=2, hidden=3) for seed in (50, 51)]
    design = make_design(units)
    once = design.fit(units[0])
    again = design.fit(once)
    assert np.array_equal(read_stream(once.recurrent.gru), read_stream(again.recurrent.gru))


def test_rows_are_rounded_for_the_inputs_they_meet() -> None:
    rng = np.random.default_rng(3)
    rows = rng.normal(0, 50, (20, 6))
    alone = rng.integers(-20_000, 20_000, (4000, 6))
    together = np.round(alone[:, :2] @ rng.normal(0, 1, (2, 6))).astype(np.int64)
    for inputs, most in ((alone, 1.3), (together, 0.5)):
        found, bias = round_rows(rows, inputs)
        assert np.abs(found - rows).max() < 20
        wanted = inputs @ rows.T
        errors = [
            np.sqrt(np.mean((wanted - inputs @ some.T - change) ** 2))
            for some, change in ((found, bias), (np.round(rows), 0))
        ]
        assert errors[0] < most * errors[1]


def test_inputs_that_never_move_are_rounded_too() -> None:
    found, bias = round_rows(np.array([[1.4, 2.6]]), np.full((10, 2), 100))
    assert np.abs(found - [1.4, 2.6]).max() <= 1 and abs(bias[0] - (400 - found.sum() * 100)) <= 1


def test_rounding_together_never_leaves_the_set() -> None:
    unit = make_unit(60, outputs=2, hidden=4)
    own, seen = unit.recurrent.gru, visit(unit, unit.recurrent)
    coarser = replace(own, shift=tuple(shift - 1 for shift in own.shift))
    (aligned,) = align_layers([own], "gru", coarser, 0.0)
    assert not np.array_equal(refine(own, aligned, seen).w_h, aligned.w_h)
    norms = np.abs(aligned.w_x[:2].astype(int)).sum(2) + np.abs(aligned.w_h[:2].astype(int)).sum(2)
    bias = aligned.bias.astype(np.int64)
    bias[:2] = 2**31 - 1 - 2**15 * norms  # the sums of r and u reach the end
    full = replace(aligned, bias=bias.astype(np.int32))
    assert not find_overflow(read_stream(full), (1, 2))
    bias[0, 0] += 1
    assert find_overflow(read_stream(replace(aligned, bias=bias)), (1, 2))
    assert refine(own, full, seen) is full


def test_inputs_are_drawn_within_what_was_calibrated() -> None:
    model = make_unit(70, outputs=1, hidden=2)
    codes = draw_codes(model, STEPS)
    guards = model.guards
    assert codes.shape == (RUNS, STEPS, 1)
    assert codes.min() >= guards.temperature_low and codes.max() <= guards.temperature_high
    assert codes.max() - codes.min() > 0.9 * (guards.temperature_high - guards.temperature_low)
    assert np.abs(np.diff(codes, axis=1)).max() <= 2 * guards.rate_max + 1
    assert np.array_equal(codes, draw_codes(model, STEPS))


def test_a_window_is_visited_from_its_beginning() -> None:
    described, calibration = describe_unit(80, outputs=1, hidden=3)
    model = quantize(replace(described, window=7), calibration)
    seen = visit(model, model.recurrent)
    assert len(seen.x) == len(seen.h) and not seen.h.reshape(-1, 7, 3)[:, 0].any()
