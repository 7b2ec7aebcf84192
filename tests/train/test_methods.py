"""Every method behind one interface: fits, predicts, tells its cost; networks as dense layers."""

import builtins
from pathlib import Path
from typing import Any

import numpy as np
import onnxruntime
import pytest
import torch

from zerodrift.base.config import EffectConfig, NetworkConfig, parse_config
from zerodrift.base.errors import InputError
from zerodrift.dataset.runs import Run
from zerodrift.operations.dense import FloatFeedForward
from zerodrift.operations.lowpass import lowpass
from zerodrift.train.front_end import Tap, compute_taps
from zerodrift.train.networks import (
    FeedForwardNetwork,
    GruNetwork,
    MlpNetwork,
    TcnNetwork,
    build_network,
)
from zerodrift.train.onnx_export import build_layers_onnx, read_onnx_layers
from zerodrift_lab.methods import METHODS, Options
from zerodrift_lab.methods.networks import make_gru
from zerodrift_lab.methods.projected import Projected, fit_whitening
from zerodrift_lab.methods.windows import fit_windows

NOISE = 0.02
WITHOUT_MEMORY = ("lsm_linear", "lsm_cubic", "mlp")


def make_run(seed: int, length: int = 900) -> Run:
    """Return a run of one output that follows the temperature with a lag of 40 s."""
    rng = np.random.default_rng(seed)
    knots = rng.uniform(5.0, 45.0, length // 100 + 2)
    temperature = np.interp(np.arange(length), np.arange(knots.size) * 100.0, knots)
    drift = 0.3 * (lowpass(temperature, 1.0, 40.0) - 25.0) + NOISE * rng.normal(size=length)
    return Run(
        name=f"run{seed}",
        group=f"run{seed}",
        part=0,
        source=Path(f"run{seed}.csv"),
        sample_period_s=1.0,
        time_s=np.arange(length, dtype=float),
        temperature_degC=temperature,
        measured=drift[:, None],
        reference=np.zeros((length, 1)),
    )


@pytest.mark.spread(4, "name", [n for n in METHODS if n not in ("gru_stream", "physics_network")])
def test_method_fits_predicts_and_tells_its_cost(name: str) -> None:
    if METHODS[name].family == "baseline":
        pytest.importorskip("sklearn", reason="the baselines need scikit-learn")
    options = Options(epochs=6, effects=(EffectConfig("zero_tempco"), EffectConfig("thermal_lag")))
    fitted = METHODS[name].fit([make_run(i) for i in range(3)], seed=1, options=options)
    judge = make_run(9)
    prediction = fitted.predict(judge)
    assert prediction.shape == judge.drift.shape
    error = np.sqrt(np.mean((judge.drift - prediction) ** 2)) / judge.drift.std()
    assert error < (0.8 if name in WITHOUT_MEMORY else 0.3)
    assert fitted.parameters > 0
    assert fitted.fit_cpu_s > 0.0
    assert fitted.exportable == (METHODS[name].family != "baseline" and "window" not in name)
    assert (fitted.macs_per_step > 0) == (METHODS[name].family != "baseline")


def test_lag_bank_is_at_the_noise() -> None:
    fitted = METHODS["lag_bank"].fit([make_run(i) for i in range(3)], seed=0)
    judge = make_run(9)
    assert (judge.drift - fitted.predict(judge)).std() < 1.1 * NOISE


def test_paper_s_gru_has_the_size_that_ratios_are_told_against() -> None:
    options = Options(epochs=1, spacing_s=1.0)
    fitted = METHODS["gru_window_pytorch"].fit([make_run(0, 300)], seed=0, options=options)
    assert fitted.parameters == 3 * 36 * (1 + 36) + 4 * 36 + 36 + 1
    assert fitted.macs_per_step == 10 * 3 * 36 * (1 + 36) + 36
    assert fitted.exportable


def test_epochs_are_reported_with_the_network_as_it_is() -> None:
    found: list[tuple[int, float, Any]] = []
    options = Options(
        epochs=4, report=lambda *told: found.append(told), report_epochs=(2, 4), schedule="recipe"
    )
    fitted = METHODS["mlp"].fit([make_run(0, 300)], seed=0, options=options)
    assert [epoch for epoch, _, _ in found] == [2, 4]
    assert 0.0 < found[0][1] < found[1][1]
    run = make_run(1, 300)
    assert np.array_equal(found[1][2].predict(run), fitted.predict(run))


def test_unknown_schedule_is_refused() -> None:
    with pytest.raises(InputError, match="no schedule 'slow'; expected one of recipe, quick"):
        METHODS["mlp"].fit([make_run(0)], options=Options(schedule="slow"))


def test_missing_scikit_learn_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    real = builtins.__import__

    def refuse(name: str, *rest: Any, **more: Any) -> Any:
        if name.startswith("sklearn"):
            raise ImportError("No module named 'sklearn'")
        return real(name, *rest, **more)

    monkeypatch.setattr(builtins, "__import__", refuse)
    with pytest.raises(InputError, match=r"needs scikit-learn.*pip install scikit-learn"):
        METHODS["svr"].fit([make_run(0)])


def draw_network(kind: str, window: int, channels: int) -> MlpNetwork | TcnNetwork:
    config = NetworkConfig(kind=kind, hidden=5, memory=window)
    network = build_network(config, window * channels, 2, torch.Generator().manual_seed(3))
    assert isinstance(network, MlpNetwork | TcnNetwork)
    with torch.no_grad():
        network.head.normal_(generator=torch.Generator().manual_seed(4))
    return network


@pytest.mark.parametrize(
    ("kind", "window"), [("mlp", 1), ("tcn", 2), ("tcn", 5), ("tcn", 10), ("tcn", 13)]
)
def test_dense_layers_and_their_onnx_are_the_network(kind: str, window: int) -> None:
    """The unrolled convolutions answer as PyTorch's own do."""
    network = draw_network(kind, window, 2)
    x = np.random.default_rng(0).normal(size=(40, 2 * window))
    with torch.no_grad():
        wanted = network.answer(torch.from_numpy(x.astype(np.float32))).numpy()
    head, bias = (p.detach().numpy().astype(float) for p in (network.head, network.head_bias))
    layers = FloatFeedForward(network.to_dense(), head, bias)
    np.testing.assert_allclose(layers.run(x), wanted, atol=2e-5)
    content = build_layers_onnx(layers, ["a", "b"])
    assert content == build_layers_onnx(layers, ["a", "b"])
    again = read_onnx_layers(content, "network.onnx")
    for one, other in zip(again.dense, layers.dense, strict=True):
        assert np.array_equal(one.weight, other.weight)
        assert np.array_equal(one.bias, other.bias)
    session = onnxruntime.InferenceSession(content, providers=["CPUExecutionProvider"])
    found = session.run(["drift"], {"features": x.astype(np.float32)})[0]
    np.testing.assert_allclose(found, wanted, atol=2e-5)


def test_taps_of_a_window_are_the_signal_as_it_was() -> None:
    run = make_run(2, 200)
    taps = [Tap("level", steps=age * 3, hops=max(age, 1)) for age in range(4)]
    seen = compute_taps(taps, run)
    for age in range(4):
        late = run.temperature_degC[np.maximum(np.arange(200) - 3 * age, 0)]
        assert np.array_equal(seen[:, age], late)


def test_window_is_refused_where_it_means_nothing(tmp_path: Path) -> None:
    text = """
[sensor]
name = "s"
time = "t"
temperature = "T"
sample_period_s = 1.0
[outputs.a]
measured = "a"
unit = "N"
full_scale = 10
[logs]
train = ["*.csv"]
[network]
kind = "lag_bank"
memory = 10
"""
    with pytest.raises(InputError, match=r"zerodrift.toml:15: .*'lag_bank' sees no past samples"):
        parse_config(text, tmp_path / "zerodrift.toml")


def test_feed_forward_networks_carry_no_state() -> None:
    network = draw_network("mlp", 1, 2)
    assert isinstance(network, FeedForwardNetwork)
    x = torch.randn(7, 2, 5, generator=torch.Generator().manual_seed(0))
    drift, states = network(x, network.cold(5))
    assert drift.shape == (7, 2, 5)
    assert states.shape == (7, 0, 5)
    alone, _ = network(x[3:4], network.cold(5))
    assert torch.allclose(drift[3], alone[0], atol=1e-6)


def test_projected_gradient_is_that_of_the_error() -> None:
    rng = np.random.default_rng(0)
    x = rng.normal(size=(5, 1, 400)).astype(np.float32)
    y = np.stack([x.sum(axis=(0, 1)), np.tanh(x[-1, 0])]).astype(np.float32)
    torch.manual_seed(0)
    network = make_gru("reset_before")(1, 2)
    assert isinstance(network, GruNetwork)
    problem = Projected(network, x, y, np.full(400, 3.0))
    start = problem.start
    direction = rng.normal(size=start.size) / np.sqrt(start.size)
    _, slope = problem.evaluate(start)
    step = 0.05
    ahead, behind = (problem.evaluate(start + sign * step * direction)[0] for sign in (1, -1))
    assert (ahead - behind) / (2 * step) == pytest.approx(slope @ direction, rel=0.02)


def test_whitened_taps_are_unlike_each_other_and_noise_stays_small() -> None:
    runs = [make_run(i) for i in range(3)]
    windows = fit_windows(runs, (), 10, 10.0)
    whitening = fit_whitening(windows, runs)
    taps = np.concatenate([whitening.apply(windows, run) for run in runs], axis=2)[:, 0]
    np.testing.assert_allclose(taps.mean(axis=1)[-1], 0.0, atol=1e-3)
    together = taps @ taps.T / taps.shape[1]
    np.testing.assert_allclose(together, np.diag(np.diag(together)), atol=1e-3)
    assert np.diag(together).max() < 1.001
    assert together[-1, -1] == pytest.approx(1.0, abs=1e-3)
    assert np.allclose(whitening.matrix, np.tril(whitening.matrix))
