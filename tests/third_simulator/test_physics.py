"""The third simulator's physics against closed forms, other integrators and what defines them."""

import numpy as np
import pytest
from benchmarks.third_simulator.heat import Network, build_chain, creep, recur, relax
from benchmarks.third_simulator.memory import stick_and_slip, superpose_plays
from benchmarks.third_simulator.noise import KINDS, draw_flicker, draw_noise, draw_walk


def test_recursion_in_blocks_is_the_recursion() -> None:
    rng = np.random.default_rng(1)
    driven, state, wanted = rng.standard_normal(1000), 0.7, []
    for value in driven:
        state = 0.97 * state + value
        wanted.append(state)
    assert np.allclose(recur(0.97, driven, 0.7), wanted, rtol=0, atol=1e-11)


def test_relaxation_follows_step_and_ramp_as_by_hand() -> None:
    time = np.arange(2000) * 0.5
    step = relax(np.ones(2000), 60.0, 0.5, 0.0)
    assert np.allclose(step, 1.0 - np.exp(-time / 60.0), rtol=0, atol=1e-12)
    ramp = relax(0.02 * time, 60.0, 0.5)
    wanted = 0.02 * (time - 60.0 * (1.0 - np.exp(-time / 60.0)))
    assert np.allclose(ramp, wanted, rtol=0, atol=1e-9)


@pytest.fixture
def network() -> Network:
    return Network(
        np.array([4.0, 30.0, 200.0]),
        np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.8], [0.0, 0.8, 0.0]]),
        np.array([0.0, 0.05, 1.0]),
    )


def test_network_at_rest_has_the_temperature_around_it(network) -> None:
    assert np.allclose(network.respond(np.full(50, 37.0)), 37.0)
    after_a_step = network.respond(np.r_[0.0, np.ones(20_000)])
    assert np.allclose(after_a_step[:, -1], 1.0)


def test_network_carries_its_power_off(network) -> None:
    nodes = network.respond(np.zeros(20_000), np.full(20_000, 2.0), 0)[:, -1]
    assert nodes @ network.outside == pytest.approx(2.0)
    assert nodes[0] - nodes[1] == pytest.approx(2.0)


def test_network_equals_a_runge_kutta_of_its_equations(network) -> None:
    laplacian = np.diag(network.joined.sum(axis=1) + network.outside) - network.joined
    around = 10.0 * np.sin(np.arange(400) / 30.0)
    grid = np.arange(400.0)

    def slope(time: float, nodes: np.ndarray) -> np.ndarray:
        air = np.interp(time, grid, around)
        return (network.outside * air - laplacian @ nodes) / network.capacity

    nodes, found, step = np.zeros(3), [np.zeros(3)], 0.05
    for second in range(399):
        for part in range(20):
            at = second + part * step
            k1 = slope(at, nodes)
            k2 = slope(at + step / 2, nodes + step / 2 * k1)
            k3 = slope(at + step / 2, nodes + step / 2 * k2)
            k4 = slope(at + step, nodes + step * k3)
            nodes = nodes + step / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        found.append(nodes)
    assert np.allclose(network.respond(around), np.array(found).T, rtol=0, atol=1e-6)


def test_chain_has_the_time_constant_asked_for() -> None:
    rates = build_chain(6, 300.0, 2.0).modes[0]
    assert 1.0 / rates.min() == pytest.approx(300.0)


def test_chain_takes_up_water_as_cranks_sheet_does() -> None:
    """A sheet that is open on one side: the mean content, Crank's series of odd modes."""
    time = np.arange(0.0, 3000.0, 5.0)
    odd = 2.0 * np.arange(200) + 1.0
    terms = 8.0 / (np.pi * odd) ** 2 * np.exp(-np.outer(time[1:] - 5.0, odd**2) / 1000.0)
    mean = build_chain(12, 1000.0).respond(np.r_[0.0, np.ones(time.size - 1)], step_s=5.0)
    wanted = 1.0 - terms.sum(axis=1)
    assert np.abs(mean.mean(axis=0)[1:] - wanted)[10:].max() < 0.01


def test_chain_is_no_first_order_lag() -> None:
    step = np.r_[0.0, np.ones(999)]
    last = build_chain(4, 100.0, 2.0).respond(step)[-1]
    best = min(
        np.sqrt(np.mean((last - relax(step, tau, 1.0)) ** 2)) for tau in np.linspace(40, 200, 81)
    )
    assert best > 0.005


def test_creep_ends_at_its_shares_and_runs_faster_when_warm() -> None:
    terms = [(0.2, 20.0), (0.3, 300.0)]
    load = np.r_[0.0, np.full(8000, 5.0)]
    cold = creep(load, np.ones(8001), terms, 1.0)
    assert cold[-1] == pytest.approx(5.0 * 0.5, rel=1e-6)
    t = np.arange(8000) + 0.5
    wanted = 5.0 * (0.2 * -np.expm1(-t / 20.0) + 0.3 * -np.expm1(-t / 300.0))
    assert np.abs(cold[1:] - wanted).max() < 0.06
    warm = creep(load, np.full(8001, 2.0), terms, 1.0)
    assert np.abs(warm[500:1500] - cold[1000:3000:2]).max() < 0.01


@pytest.fixture
def plays():
    radii, weights = np.linspace(1.0, 5.0, 8), np.full(8, 0.125)

    def answer(driven: np.ndarray, bend: float = 0.0) -> np.ndarray:
        return superpose_plays(driven, radii, weights, 0.0, bend)

    return answer


def test_hysteresis_does_not_know_how_fast_it_went(plays) -> None:
    path = np.interp(np.arange(400), [0, 100, 250, 399], [0.0, 20.0, -15.0, 10.0])
    slow = np.interp(np.arange(0, 399.001, 0.25), np.arange(400), path)
    assert np.allclose(plays(slow, 0.1)[::4], plays(path, 0.1), rtol=0, atol=1e-12)


def test_hysteresis_forgets_a_small_loop_within_a_large_one(plays) -> None:
    large = np.linspace(0.0, 20.0, 201)
    small = np.r_[np.linspace(0.0, 12.0, 121), np.linspace(12.0, 9.0, 31)]
    after = plays(np.r_[small, np.linspace(9.0, 20.0, 111)])
    assert after[-1] == pytest.approx(plays(large)[-1])


def test_hysteresis_takes_another_way_down(plays) -> None:
    up, down = np.linspace(-20.0, 20.0, 401), np.linspace(20.0, -20.0, 401)
    loop = plays(np.r_[up, down, up])
    width = loop[401:802][::-1] - loop[802:]
    assert width[150:250].min() > 4.0
    assert width[150:250].max() < 10.0


def test_what_sticks_stays_until_it_slips() -> None:
    pull = np.linspace(0.0, 3.0, 3001)
    behind = stick_and_slip(pull, np.random.default_rng(2), 0.2)
    place = behind + pull
    slips = np.flatnonzero(np.abs(np.diff(place)) > 1e-9)
    assert 5 < slips.size < 60
    assert np.abs(behind).max() < 0.2 * 1.8 + 0.01


def slope_of(draw) -> float:
    """Return the slope of the power spectrum on a log-log plot, mean of 60 draws."""
    power = np.zeros(2048)
    for seed in range(60):
        drawn = draw(np.random.default_rng(seed), 4096) * np.hanning(4096)
        power += np.abs(np.fft.rfft(drawn)[1:]) ** 2
    index = np.arange(1, 2049)
    band = (index > 8) & (index < 400)
    return float(np.polyfit(np.log(index[band]), np.log(power[band]), 1)[0])


@pytest.mark.parametrize(
    ("draw", "slope"),
    [(lambda r, n: r.standard_normal(n), 0.0), (draw_flicker, -1.0), (draw_walk, -2.0)],
    ids=["white", "flicker", "walk"],
)
def test_spectra_fall_as_they_are_called(draw, slope) -> None:
    assert slope_of(draw) == pytest.approx(slope, abs=0.1)


@pytest.mark.parametrize("kind", KINDS)
def test_noise_has_the_rms_asked_for(kind) -> None:
    power = [np.mean(draw_noise(np.random.default_rng(s), 3000, kind) ** 2) for s in range(200)]
    assert np.sqrt(np.mean(power)) == pytest.approx(1.0, abs=0.05)
