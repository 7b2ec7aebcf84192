"""The noise floor: from a dwell, or estimated as what is fast."""

from dataclasses import replace

import numpy as np
import pytest

from zerodrift.dataset.runs import Dataset
from zerodrift.diagnosis.floor import DWELL, ESTIMATED, estimate_fast_noise, measure_floor

NAMES = (("Fz", "Mx"), ("N", "Nm"), (2000.0, 20.0))


def make_noise(seed, length, rms):
    return rms * np.random.default_rng(seed).standard_normal((length, 2))


def test_floor_of_a_dwell_is_its_noise(make_run):
    dwell = make_run(0, noise=0.2)
    floor = measure_floor(Dataset((make_run(1),), (), (dwell,), *NAMES))
    assert floor.source == DWELL
    assert floor.rms == pytest.approx([0.2, 0.2], rel=0.05)
    assert "dwell logs" in floor.explain()


def test_floor_without_a_dwell_is_estimated_and_says_so(make_run):
    runs = tuple(make_run(i) for i in range(3))
    floor = measure_floor(Dataset(runs, (), (), *NAMES))
    assert floor.source == ESTIMATED
    assert "estimated" in floor.explain()
    assert floor.rms == pytest.approx([0.05, 0.05], rel=0.08)


@pytest.mark.parametrize("period", [400.0, 2000.0])
def test_slow_errors_do_not_raise_the_estimate(period):
    time = np.arange(6000)[:, None]
    residual = make_noise(1, 6000, 0.1) + np.sin(2.0 * np.pi * time / period)
    assert estimate_fast_noise([residual], 6000) == pytest.approx([0.1, 0.1], rel=0.25)


def test_steps_of_the_load_do_not_raise_the_estimate():
    residual = make_noise(2, 6000, 0.1)
    residual[1000:] += 5.0
    residual[4000:4100] -= 7.0
    assert estimate_fast_noise([residual], 6000) == pytest.approx([0.1, 0.1], rel=0.08)


def test_estimate_of_coloured_noise_holds_more_than_its_fastest_part():
    from scipy.signal import lfilter

    kicks = np.random.default_rng(3).standard_normal((20000, 2))
    coloured = lfilter([1.0], [1.0, -0.8], kicks, axis=0)
    rms = np.std(coloured, axis=0)
    estimate = estimate_fast_noise([coloured], 20000)
    # One step ahead it is predictable to 1; the estimate must see more, but never invent noise.
    assert np.all((estimate > 1.2) & (estimate < 1.05 * rms))


def test_estimate_of_ten_rows_is_finite():
    assert np.isfinite(estimate_fast_noise([make_noise(4, 10, 0.1)], 10)).all()


def test_channel_of_zeros_has_no_noise():
    assert estimate_fast_noise([np.zeros((500, 2))], 500) == pytest.approx([0.0, 0.0], abs=1e-12)


def test_what_follows_signals_is_no_noise_and_the_model_does_not_matter(make_run):
    runs = tuple(make_run(i) for i in range(3))
    quiet = measure_floor(Dataset(runs, (), (), *NAMES)).rms

    def disturb(run):
        late = np.asarray(run.temperature_degC) ** 2 * 0.02
        return replace(run, measured=run.measured + late[:, None])

    loud = measure_floor(Dataset(tuple(map(disturb, runs)), (), (), *NAMES)).rms
    assert loud == pytest.approx(quiet, rel=0.02)


def test_a_short_log_keeps_its_noise(make_run):
    runs = tuple(make_run(i).take(slice(0, 240)) for i in range(30))
    one = [measure_floor(Dataset((run,), (), (), *NAMES)).rms for run in runs]
    assert np.median(one, axis=0) == pytest.approx([0.05, 0.05], rel=0.1)


@pytest.mark.parametrize("at", [0.0, 0.25, 0.5])
def test_floor_of_a_coarse_converter_is_not_that_of_one_place_between_two_steps(make_run, at):
    """At rest the steps show all of themselves or nothing; going through many, always the same."""
    step, sigma = 0.2, 0.05

    def convert(run, shift=0.0):
        rng = np.random.default_rng(len(run.name) + int(1e3 * shift))
        fine = rng.normal(size=run.measured.shape) * sigma + run.measured + shift
        return replace(run, measured=step * np.round(fine / step))

    slow = np.linspace(0.0, 3.0, 6000)[:, None] * np.ones(2)
    runs = []
    for i in range(3):
        run = make_run(i, noise=0.0)
        moved = (
            run.measured
            + np.interp(run.time_s, np.linspace(*run.time_s[[0, -1]], 6000), slow[:, 0])[:, None]
        )
        runs.append(convert(replace(run, measured=moved, name=f"run{i}" * (i + 1))))
    still = make_run(9, noise=0.0)
    rest = replace(still, measured=np.zeros_like(still.measured), reference=0 * still.reference)
    dwell = convert(rest, at * step)
    floor = measure_floor(Dataset(tuple(runs), (), (dwell,), *NAMES))
    truth = np.sqrt(sigma**2 + step**2 / 12)
    most = 0.5 * step if at == 0.5 else 1.1 * truth  # half of the samples at either step
    assert (0.9 * truth < floor.rms).all() and (floor.rms <= most).all()
