"""One training engine: what it gives is what each network gives alone, whatever the company."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from tests.train.one_at_a_time import answer, rest, train_alone

from zerodrift.base.config import NetworkConfig
from zerodrift.base.errors import InputError
from zerodrift.train import engine
from zerodrift.train.attempts import Problem
from zerodrift.train.engine import EpochProgress, Result, train_networks
from zerodrift.train.networks import GruNetwork, build_network
from zerodrift.train.sequences import Sequence32
from zerodrift.train.settings import Settings

SETTINGS = Settings(epochs=4, starts=(0, 1), chunk=8, batch=6, evaluations=4)
STORED = Path(__file__).parent / "stored"


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


def pose(
    seed,
    lengths,
    features=2,
    *,
    kind="gru",
    memory="stream",
    form="reset_after",
    tared=False,
    hold=True,
    **changes,
):
    """Return a sensor's problem; changes are of the settings."""
    rng = np.random.default_rng(seed)
    *sequences, last = draw_sequences(rng, (*lengths, 37), features, tare=0.5 if tared else 0.0)
    config = NetworkConfig(kind=kind, hidden=5, memory=memory, options={"form": form})
    held_out = [replace(last, skip=5)] if hold else []
    return Problem(
        lambda generator: build_network(config, features, 2, generator),
        sequences,
        held_out,
        replace(SETTINGS, memory=memory if kind == "gru" else "stream", **changes),
        tared,
    )


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


KINDS = [
    ("gru", "stream", "reset_after", False),
    ("gru", "stream", "reset_before", True),
    ("gru", 5, "reset_after", True),
    ("gru", 5, "reset_before", False),
    ("mlp", "stream", "reset_after", True),
]


@pytest.mark.spread(1, ("kind", "memory", "form", "tared"), KINDS)
def test_sensors_trained_at_once_are_those_trained_one_at_a_time(kind, memory, form, tared):
    """Against a loop that shares no code with the engine: autograd, PyTorch's AdamW."""
    # Sensors differ in the number, the lengths and the features of their runs.
    shapes = (((50, 7), 2), ((64,), 3), ((20, 33, 11), 1))
    problems = [
        pose(seed, lengths, features, kind=kind, memory=memory, form=form, tared=tared)
        for seed, (lengths, features) in enumerate(shapes)
    ]
    alone = [train_alone(problem) for problem in problems]
    assert any(result.epoch > 0 for result in alone)  # else first weights would be compared
    for one, together in zip(alone, train_networks(problems), strict=True):
        assert_equal(one, together)


def test_convolutions_trained_at_once_are_those_trained_one_at_a_time():
    problems = [
        pose(seed, lengths, 10, kind="tcn", memory=5)
        for seed, lengths in enumerate(((50, 31), (64,)))
    ]
    for problem, together in zip(problems, train_networks(problems), strict=True):
        assert_equal(train_alone(problem), together)


def test_without_held_out_runs_the_last_weights_are_kept():
    problems = [
        pose(seed, (50, 31), hold=False, starts=(1,), epochs=epochs)
        for seed, epochs in ((0, 2), (1, 5))
    ]
    for problem, together in zip(problems, train_networks(problems), strict=True):
        alone = train_alone(problem)
        assert alone.epoch == problem.settings.epochs
        assert_equal(alone, together)


def test_result_does_not_depend_on_the_company(monkeypatch):
    problems = [pose(seed, (50 + 9 * seed, 31)) for seed in range(5)]
    whole = train_networks(problems)
    monkeypatch.setattr(engine, "BLOCK", 3)
    monkeypatch.setattr(engine, "AT_ONCE", 4)
    for one, other in zip(whole, train_networks(problems), strict=True):
        assert isinstance(one, Result)
        assert_equal(one, other)
    (alone,) = train_networks(problems[:1])
    assert isinstance(alone, Result)
    assert_equal(alone, whole[0])


def test_diverging_sensor_leaves_the_others_alone():
    good = [pose(seed, (50, 31)) for seed in range(3)]
    bad = pose(9, (50, 31))
    target = bad.sequences[0].target.copy()
    target[20] = np.inf
    bad = replace(bad, sequences=[replace(bad.sequences[0], target=target), *bad.sequences[1:]])
    found = train_networks([good[0], bad, *good[1:]])
    assert isinstance(found[1], InputError)
    assert "diverged in epoch 1;" in str(found[1])
    for problem, together in zip(good, (found[0], *found[2:]), strict=True):
        assert_equal(train_alone(problem), together)


class Stopped(Exception):
    """Stands for Ctrl-C in the middle of a training."""


def stop_after(epochs: int):
    """Return a report that stops the training."""
    seen: list[EpochProgress] = []

    def report(progress: EpochProgress) -> None:
        seen.append(progress)
        if len(seen) == epochs:
            raise Stopped

    return report


@pytest.mark.parametrize(("kind", "memory"), [("gru", "stream"), ("gru", 5), ("mlp", "stream")])
@pytest.mark.spread(1, "epochs", [3, 9])
def test_interrupted_training_of_many_goes_on_to_the_same_bits(
    kind, memory, epochs, tmp_path, monkeypatch
):
    """Also where some of the sensors are complete, and others have not begun."""
    monkeypatch.setattr(engine, "AT_ONCE", 4)
    problems = [pose(s, (50 + s, 31), kind=kind, memory=memory, epochs=4 + s) for s in range(3)]
    whole = train_networks(problems)
    file = tmp_path / "checkpoint.npz"
    with pytest.raises(Stopped):
        train_networks(problems, checkpoint=file, report=stop_after(epochs))
    told: list[EpochProgress] = []
    resumed = train_networks(problems, checkpoint=file, report=told.append)
    assert len(told) < 11 - epochs + 2  # epochs in two parts: 5 and 6
    assert told[-1].done == 1.0
    for one, other in zip(whole, resumed, strict=True):
        assert isinstance(one, Result) and isinstance(other, Result)
        assert (one.start, one.epoch, one.rmse) == (other.start, other.epoch, other.rmse)
        assert (one.last_rmse, one.rmse_without) == (other.last_rmse, other.rmse_without)
        for name, value in one.weights.items():
            assert np.array_equal(value, other.weights[name]), name


def test_checkpoint_of_other_inputs_is_not_taken_up(tmp_path):
    file = tmp_path / "checkpoint.npz"
    with pytest.raises(Stopped):
        train_networks([pose(0, (50, 31))], checkpoint=file, report=stop_after(3))
    for other in (pose(1, (50, 31)), pose(0, (50, 31), batch=5), pose(0, (50, 31), tared=True)):
        told: list[EpochProgress] = []
        train_networks([other], checkpoint=file, report=told.append)
        assert len(told) == SETTINGS.epochs
    told = []
    train_networks([pose(0, (50, 31))], checkpoint=file, resume=False, report=told.append)
    assert len(told) == SETTINGS.epochs


@pytest.mark.parametrize(("kind", "memory"), [("gru", "stream"), ("gru", 5), ("mlp", "stream")])
def test_checkpoint_from_when_starts_were_trained_in_turn_is_taken_up(
    kind, memory, tmp_path, monkeypatch
):
    """The stored files were written in the second start's fourth epoch of eight, by PyTorch 2.13.0
    and NumPy 2.4.6, which are part of the mark."""
    monkeypatch.setattr(torch, "__version__", "2.13.0+cpu")
    monkeypatch.setattr(np, "__version__", "2.4.6")
    rng = np.random.default_rng(5)
    *sequences, last = draw_sequences(rng, (50, 31, 37), 2, tare=0.5)
    config = NetworkConfig(kind=kind, hidden=3, memory=memory)
    settings = replace(SETTINGS, memory=memory, epochs=8)
    problem = Problem(
        lambda generator: build_network(config, 2, 2, generator), sequences, [last], settings, True
    )
    file = tmp_path / "checkpoint.npz"
    file.write_bytes((STORED / f"checkpoint_1_{kind}_{memory}.npz").read_bytes())
    told: list[EpochProgress] = []
    (resumed,) = train_networks([problem], checkpoint=file, report=told.append)
    assert len(told) == 4
    (whole,) = train_networks([problem])
    assert isinstance(whole, Result) and whole.start == 1
    assert_equal(whole, resumed)


@pytest.mark.spread(1, "form", ["reset_after", "reset_before"])
def test_recurrence_and_gradients_are_those_of_autograd_on_each_network(form):
    generator = torch.Generator().manual_seed(3)
    sensors, features, steps, count = 3, 2, 9, 5
    config = NetworkConfig(kind="gru", hidden=4, options={"form": form})
    networks = [build_network(config, features, 2, generator) for _ in range(sensors)]
    for network in networks:
        for p in network.parameters():
            torch.nn.init.normal_(p, std=0.7, generator=generator)
    x, h0, d_states, d_drift = (
        torch.randn(*shape, generator=generator)
        for shape in (
            (steps, sensors, features, count),
            (sensors, 4, count),
            (steps, sensors, 4, count),
            (steps, sensors, 2, count),
        )
    )
    names = [name for name, _ in networks[0].named_parameters()]
    stacked = {
        name: torch.stack([dict(n.named_parameters())[name].detach() for n in networks])
        for name in names
    }
    for p in stacked.values():
        p.requires_grad_()
    drift, states = networks[0].run_many(stacked, x, h0)
    ((drift * d_drift).sum() + (states * d_states).sum()).backward()
    at_rest = networks[0].rest_many(stacked, x[0])
    for s, network in enumerate(networks):
        assert isinstance(network, GruNetwork)
        mine, walked = answer(network, x[:, s].transpose(1, 2), h0[s].T)
        torch.testing.assert_close(drift[:, s], mine.transpose(1, 2), rtol=1e-5, atol=1e-5)
        torch.testing.assert_close(states[:, s], walked.transpose(1, 2), rtol=1e-5, atol=1e-6)
        wanted = rest(network, x[0, s].T).T
        torch.testing.assert_close(at_rest[s], wanted, rtol=1e-5, atol=1e-5)
        loss = (mine.transpose(1, 2) * d_drift[:, s]).sum()
        (loss + (walked.transpose(1, 2) * d_states[:, s]).sum()).backward()
        for name, p in network.named_parameters():
            gradient = stacked[name].grad
            assert gradient is not None and p.grad is not None
            torch.testing.assert_close(gradient[s], p.grad, rtol=1e-4, atol=1e-4)
