"""Logs from a simulator that shares nothing with zerodrift, judged through the command line."""

import json

import numpy as np
import pytest
from benchmarks.foreign import __main__ as runner
from benchmarks.foreign import case, effects, files, judge, world
from scipy.integrate import solve_ivp

pytestmark = pytest.mark.long


def diagnose(home, kind, hidden, seed):
    recipe = case.Recipe(kind, hidden, size=5, runs=8, seed=seed)
    row = {"hidden": hidden, "lookalikes": []}
    told = judge.command(row, files.write(case.draw(recipe), home), "diagnose")
    assert row["complaints"] == []
    return row | told


@pytest.mark.parametrize("effect", ["creep", "thermal_lag", "supply_sensitivity"])
def test_foreign_effect_is_named(tmp_path, effect):
    row = diagnose(tmp_path, "effect", (effect,), seed=1)
    assert judge.first(row), (row["verdict"], row["effect"], row["lookalikes"])
    truth = json.loads((tmp_path / "truth.json").read_text())["truth"][effect]
    named = next(c["parameters"] for c in row["candidates"] if c["effect"] == effect)
    for name, value in truth.items():
        assert named[name] == pytest.approx(value, rel=0.1)


def test_foreign_complete_model_is_complete(tmp_path):
    row = diagnose(tmp_path, "complete", (), seed=2)
    assert (row["verdict"], row["effect"]) == ("complete", None)


@pytest.mark.parametrize(
    ("kind", "hidden"), [("disturbance", "ripple_in_temperature"), ("missing_channel", "humidity")]
)
def test_foreign_disturbance_gets_no_name(tmp_path, kind, hidden):
    row = diagnose(tmp_path, kind, (hidden,), seed=3)
    assert (row["verdict"], row["effect"]) == ("unknown", None)
    assert row["nearest"] is not None


def test_low_pass_agrees_with_an_adaptive_integrator():
    time = np.arange(0, 200, 0.05)

    def course(t):
        return 20 + 10 * np.sin(t / 15) + np.minimum(t / 10, 8)

    solved = solve_ivp(
        lambda t, y: (course(t) - y) / 12.3, (0, 199.9), [course(0)], t_eval=time[:-2], rtol=1e-9
    )
    followed = world.low_pass(course(time), 12.3, 0.05)
    np.testing.assert_allclose(followed[:-2], solved.y[0], atol=1e-4)


def test_size_counts_only_what_a_refit_cannot_absorb():
    made = case.draw(case.Recipe("effect", ("dark_current",), 2, 4, seed=5))
    assert made.told == {name: made.told[name] for name in made.told if name != "dark_current"}
    assert made.sizes["dark_current"] >= 2
    plain = effects.columns(made.runs[0], made.truth, 0, made.full_scale[0])["dark_current"]
    gains = {name: np.ones(3) for name in made.truth}
    assert made.size("dark_current", 0, gains) < np.std(plain) / made.noise_rms[0]


def test_noise_has_unit_rms():
    rng = np.random.default_rng(0)
    for kind in ("white", "pink", "ar"):
        square = np.mean([np.mean(world.noise(rng, kind, 1000, 20) ** 2) for _ in range(600)])
        assert square == pytest.approx(1, rel=0.05)


def test_share_gives_wilson_intervals():
    # Newcombe, Statistics in Medicine 17 (1998), table I: 81 of 263 and 0 of 20.
    assert runner.share([True] * 81 + [False] * 182).endswith("[ 25.5%,  36.6%]")
    assert runner.share([False] * 20).endswith("[  0.0%,  16.1%]")
