"""Logs of plain numbers: what is told at once is what is found field by field."""

import random
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.ndimage import median_filter

from zerodrift.base.errors import InputError
from zerodrift.dataset import oddities, text_format
from zerodrift.dataset.outliers import NEIGHBOURS, take_medians
from zerodrift.dataset.resolution import measure_step
from zerodrift.dataset.runs import Run
from zerodrift.dataset.text_format import TextFormat, sniff_text

FIELDS = ("1", "-2.50", "0.0", "12345.678", "-0")
ODD = ("", "-", ".5", "5.", "1.2.3", "--1", "1-2", "1e5", "nan", "+3", " 4", "x", "2024-01-02", ".")
HEADERS = ("time_s,T,F", "t,T", "1,2,3", "t;s,T,F", "t s,T,F", '"t",T,F', "t,t,F", ",T,F", "t,T,-5")


def sniff(text: str, *, is_whole: bool) -> TextFormat | str:
    try:
        return sniff_text(text.encode(), "log.csv", is_whole)
    except InputError as error:
        return str(error)


def draw(rng: random.Random) -> str:
    """Return a log, plain but for what is odd in some of them."""
    rows = [",".join(rng.choices(FIELDS, k=3)) for _ in range(rng.choice((3, 60, 405, 500)))]
    for _ in range(rng.choice((0, 0, 1, 3))):
        place = rng.randrange(len(rows))
        fields = rows[place].split(",")
        fields[rng.randrange(len(fields))] = rng.choice((*ODD, "1,2"))
        rows[place] = rng.choice((",".join(fields), "", "# " + rows[place]))
    end = "\r\n" if rng.random() < 0.1 else "\n"
    return end.join(["time_s,T,F" if rng.random() < 0.7 else rng.choice(HEADERS), *rows, ""])


def test_plain_numbers_are_described_as_field_by_field(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = random.Random(20261126)
    plain = 0
    for number in range(600):
        text, is_whole = draw(rng), bool(number % 2)
        found = sniff(text, is_whole=is_whole)
        with monkeypatch.context() as slow:
            slow.setattr(text_format, "find_plain_header", lambda _: None)
            expected = sniff(text, is_whole=is_whole)
        if isinstance(found, TextFormat):
            plain += found.is_plain_numbers
            found = replace(found, is_plain_numbers=False)
        assert found == expected, text[:300]
    assert 50 < plain < 500


def test_a_median_of_nine_is_that_of_a_filter() -> None:
    rng = np.random.default_rng(3)
    for size in (*range(1, 30), 500):
        for x in (rng.normal(size=size), np.round(rng.normal(size=size), 1)):
            assert np.array_equal(take_medians(x), median_filter(x, NEIGHBOURS, mode="mirror"))


@pytest.mark.parametrize(("digits", "step"), [(0, 1.0), (3, 1e-3)])
def test_a_step_is_found_whatever_the_first_values_are(digits: int, step: float) -> None:
    values = np.round(np.random.default_rng(4).normal(0.0, 40.0, 256), digits)
    assert measure_step(values) == pytest.approx(step)
    assert measure_step(np.append(np.arange(4.0), 0.5)) == 0.5  # the first four are whole


def test_a_drift_spike_is_found_beside_a_wide_range() -> None:
    rng = np.random.default_rng(5)
    drift = rng.normal(0.0, 1.0, (400, 1))
    drift[200] = 90.0
    time_s = np.arange(400.0)
    run = Run("a", "a", 0, Path("a.csv"), 1.0, time_s, time_s, drift, np.zeros((400, 1)))
    assert oddities._find_drift_spikes(run, 0) == [200]
    drift[200] = 20.0  # of fewer usual steps than count
    assert oddities._find_drift_spikes(run, 0) == []
