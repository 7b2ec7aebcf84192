"""The uncertainty's parts add up to what runs left out show, and cover what comes later."""

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import t as student

from zerodrift.base.records import from_json
from zerodrift.base.sealed import read_sealed
from zerodrift.verify.uncertainty import COVERAGE, OutputUncertainty, Uncertainty, count_degrees


def make(**changes: float) -> OutputUncertainty:
    values = {"noise": 3.0, "parameters": 0.0, "left_out": 4.0, "rounding": 0.0, "span": 10.0}
    return OutputUncertainty(unit="N", degrees_of_freedom=1e6, **(values | changes))


def test_parts_add_as_squares() -> None:
    assert make().standard == 5.0
    assert make(parameters=12.0).standard == 13.0


def test_inside_it_is_twice_the_standard_uncertainty() -> None:
    assert make().expand(np.zeros(2)) == pytest.approx([10.0, 10.0], rel=1e-4)


def test_beyond_the_range_a_rectangle_is_added() -> None:
    (expanded,) = make(noise=0.0, left_out=0.0).expand(np.array([0.3]))
    assert expanded == pytest.approx(2.0 * 10.0 * 0.3 / np.sqrt(3.0))


def test_few_degrees_of_freedom_widen_it() -> None:
    narrow, wide = make(), OutputUncertainty("N", 3.0, 0.0, 4.0, 0.0, 10.0, 4.0)
    assert narrow.widening == pytest.approx(1.0, abs=1e-3)
    assert wide.widening == pytest.approx(student.ppf((1 + COVERAGE) / 2, 4) / 2)


def test_degrees_are_those_of_a_known_spread() -> None:
    """Mean squares of chi-square numbers with 6 degrees each: 10 runs have 60."""
    rng = np.random.default_rng(5)
    found = [count_degrees(rng.chisquare(6, size=10) / 6, np.full(10, 0.1)) for _ in range(400)]
    assert np.median(found) == pytest.approx(60.0, rel=0.25)
    assert count_degrees(np.ones(1), np.ones(1)) == 2.0


def test_what_firmware_keeps_is_the_error_left_out(built: Path) -> None:
    kept = from_json(Uncertainty, read_sealed((built / "build/uncertainty.json").read_bytes()))
    assert kept.method == "leave one run out"
    assert kept.outputs["y"].standard == pytest.approx(0.02, rel=0.1), "the simulated noise"
    told = json.loads((built / "build/firmware.json").read_text())
    assert kept.model_hash == told["model_hash"]
