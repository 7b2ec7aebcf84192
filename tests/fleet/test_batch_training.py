"""One sensor is a batch of one: networks trained at once are those trained one at a time."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from zerodrift.base.config import NetworkConfig
from zerodrift.base.errors import InputError
from zerodrift.train import batch
from zerodrift.train.batch import Problem, train_batch
from zerodrift.train.batch_recurrence import BatchWeights, run_backward, run_forward, settle
from zerodrift.train.networks import build_network
from zerodrift.train.optimise import Result, Settings, Trainer
from zerodrift.train.recurrence import GruWeights, run_gru
from zerodrift.train.sequences import Sequence32

SETTINGS = Settings(epochs=4, starts=(0, 1), chunk=8, batch=6, evaluations=4)


def draw_sequences(rng, lengths, features, outputs=2, tare=0.0):
    """Return runs whose target is a slow function of the features, each with its own offset."""
    runs = []
    mix = rng.normal(size=(1, outputs))
    for j, n in enumerate(lengths):
        x = np.cumsum(rng.normal(size=(n, features)), axis=0) / 5.0
        slow = np.cumsum(x, axis=0)[:, :1] / np.arange(1, n + 1)[:, None]
        target = np.tanh(slow @ mix) + tare * rng.normal(size=outputs)
        runs.append(Sequence32(f"run{j}", x.astype(np.float32), target.astype(np.float32)))
    return runs


def pose(seed, lengths, features=2, form="reset_after", tared=False, hold=True, **changes):
    rng = np.random.default_rng(seed)
    *sequences, last = draw_sequences(rng, (*lengths, 37), features, tare=0.5 if tared else 0.0)
    config = NetworkConfig(kind="gru", hidden=5, options={"form": form})
    held_out = [replace(last, skip=5)] if hold else []
    return Problem(
        lambda generator: build_network(config, features, 2, generator),
        sequences,
        held_out,
        replace(SETTINGS, **changes),
        tared,
    )


def train_alone(problem: Problem) -> Result:
    return Trainer(
        problem.build,
        problem.sequences,
        problem.held_out,
        problem.settings,
        tared=problem.tared,
    ).run()


def assert_equal(alone: Result, together: Result | InputError) -> None:
    assert isinstance(together, Result)
    assert (alone.start, alone.epoch) == (together.start, together.epoch)
    assert together.rmse == pytest.approx(alone.rmse, rel=1e-5)
    assert together.last_rmse == pytest.approx(alone.last_rmse, rel=1e-5)
    assert together.rmse_without == pytest.approx(alone.rmse_without, rel=1e-5)
    assert set(alone.weights) == set(together.weights)
    for name, value in alone.weights.items():
        assert together.weights[name].shape == value.shape
        np.testing.assert_allclose(together.weights[name], value, rtol=2e-4, atol=2e-5)


@pytest.mark.parametrize("form", ["reset_after", "reset_before"])
@pytest.mark.parametrize("tared", [False, True])
def test_batch_trains_what_trainer_trains_alone(form, tared):
    # Sensors differ in the number, the lengths and the features of their runs.
    shapes = (((50, 31), 2), ((64,), 3), ((20, 45, 33), 2), ((90, 7), 1))
    problems = [
        pose(seed, lengths, features, form, tared)
        for seed, (lengths, features) in enumerate(shapes)
    ]
    alone = [train_alone(problem) for problem in problems]
    assert sum(result.epoch > 0 for result in alone) >= 3  # else first weights would be compared
    for one, together in zip(alone, train_batch(problems), strict=True):
        assert_equal(one, together)


def test_batch_without_held_out_runs_keeps_the_last_weights():
    problems = [
        pose(seed, (50, 31), hold=False, starts=(1,), epochs=epochs)
        for seed, epochs in ((0, 2), (1, 5))
    ]
    for problem, together in zip(problems, train_batch(problems), strict=True):
        alone = train_alone(problem)
        assert alone.epoch == problem.settings.epochs
        assert_equal(alone, together)


def test_result_does_not_depend_on_the_company(monkeypatch):
    problems = [pose(seed, (50 + 9 * seed, 31)) for seed in range(5)]
    whole = train_batch(problems)
    monkeypatch.setattr(batch, "BLOCK", 3)
    monkeypatch.setattr(batch, "AT_ONCE", 4)
    for one, other in zip(whole, train_batch(problems), strict=True):
        assert isinstance(one, Result)
        assert_equal(one, other)


def test_diverging_sensor_leaves_the_others_alone():
    good = [pose(seed, (50, 31)) for seed in range(3)]
    bad = pose(9, (50, 31))
    target = bad.sequences[0].target.copy()
    target[20] = np.inf
    bad = replace(bad, sequences=[replace(bad.sequences[0], target=target), *bad.sequences[1:]])
    found = train_batch([good[0], bad, *good[1:]])
    assert isinstance(found[1], InputError)
    assert "diverged" in str(found[1])
    for problem, together in zip(good, (found[0], *found[2:]), strict=True):
        assert_equal(train_alone(problem), together)


@pytest.mark.parametrize("reset", ["after", "before"])
def test_recurrence_and_gradients_are_those_of_each_network_alone(reset):
    generator = torch.Generator().manual_seed(3)

    def draw(*shape):
        return torch.randn(*shape, generator=generator) * 0.7

    sensors, hidden, features, steps, count = 3, 4, 2, 9, 5
    w_x, w_h = draw(sensors, 3, hidden, features), draw(sensors, 3, hidden, hidden)
    bias, x = draw(sensors, 4, hidden), draw(steps, sensors, features, count)
    h0, d_states = draw(sensors, hidden, count), draw(steps, sensors, hidden, count)
    weights = BatchWeights(
        w_x.flatten(1, 2),
        w_h.flatten(1, 2),
        bias,
        draw(sensors, 1, hidden),
        draw(sensors, 1),
        reset,
    )
    trace = run_forward(x, h0, weights)
    d_w_x, d_w_h, d_bias = run_backward(d_states, x, trace, weights)
    for s in range(sensors):
        own = [p[s].clone().requires_grad_() for p in (w_x, w_h, bias)]
        states = run_gru(x[:, s].contiguous(), h0[s], GruWeights(*own), reset)
        torch.testing.assert_close(trace.states[1:, s], states, rtol=1e-5, atol=1e-6)
        (states * d_states[:, s]).sum().backward()
        for mine, theirs in zip((d_w_x, d_w_h, d_bias), own, strict=True):
            assert theirs.grad is not None
            torch.testing.assert_close(
                mine[s].reshape(theirs.shape), theirs.grad, rtol=1e-4, atol=1e-5
            )


@pytest.mark.parametrize("form", ["reset_after", "reset_before"])
def test_rest_is_that_of_each_network_alone(form):
    config = NetworkConfig(kind="gru", hidden=4, options={"form": form})
    networks = [
        build_network(config, 2, 1, torch.Generator().manual_seed(seed)) for seed in range(3)
    ]
    x = torch.randn(3, 2, 6, generator=torch.Generator().manual_seed(1))
    weights = BatchWeights(
        *(torch.stack([getattr(n, name).detach().flatten(0, 1) for n in networks])
          for name in ("w_x", "w_h")),
        torch.stack([n.bias.detach() for n in networks]),
        *(torch.stack([getattr(n, name).detach() for n in networks])
          for name in ("head", "head_bias")),
        networks[0].reset,
    )  # fmt: skip
    for s, network in enumerate(networks):
        torch.testing.assert_close(settle(x, weights)[s], network.rest(x[s]), rtol=1e-5, atol=1e-6)
