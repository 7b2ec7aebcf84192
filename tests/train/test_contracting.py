"""A GRU that is trained so that it forgets: its weights, its bound on the chip, what it costs."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from click.testing import CliRunner
from tests.onnx.test_firmware_onnx import TOML
from tests.train.test_engine import SETTINGS, draw_sequences
from tests.train.test_lstm import write_lagging_logs

from zerodrift.base.config import NetworkConfig, parse_config
from zerodrift.base.errors import InputError
from zerodrift.cli.main import cli
from zerodrift.export.quantize_layers import quantize_lstm
from zerodrift.operations.lstm.cell import FloatLstm
from zerodrift.train.attempts import Problem, mark_problems
from zerodrift.train.contraction import (
    FINE_GRID,
    GRID,
    GROWTH,
    HELD,
    RATIO,
    SLOWEST,
    SPREAD,
    contract,
    contract_lstm,
    limit_head,
    measure_reach,
    measure_swing,
    trim_weights,
)
from zerodrift.train.engine import Result, train_networks
from zerodrift.train.networks import build_network

NETWORK = '\n[network]\nkind = "gru"\nhidden = 4\nepochs = 60\nstarts = 1\ncontracting = true\n'


def assert_forgets(w_x, w_h, bias, reset, reach):
    """Hold one layer against the conditions, in plain sums."""
    hidden = w_h.shape[1]
    sums = np.abs(w_h).sum(axis=2)
    for i in range(hidden):
        if reset == "after":
            gate = (sums[2, i] + abs(bias[3, i])) / 4.0 * sums[0, i]
        else:
            gate = sums[2, i] * sums[0].max() / 4.0
        assert sums[2, i] + gate + sums[1, i] <= GROWTH * (1.0 + 1e-5)
        lowest = bias[1, i] - np.abs(w_x[1, i]) @ reach - sums[1, i]
        assert lowest >= -SLOWEST * (1.0 + 1e-5)


@pytest.mark.spread(0, "reset", ["after", "before"])
def test_weights_of_any_size_are_brought_to_the_conditions_and_then_stay(reset):
    generator = torch.Generator().manual_seed(3)
    shapes = ((6, 3, 5, 2), (6, 3, 5, 5), (6, 4, 5))
    w_x, w_h, bias = (3.0 * torch.randn(shape, generator=generator) for shape in shapes)
    w_h[0] *= 1e-3  # small enough already
    bias[1] -= 20.0
    if reset == "before":
        bias[:, 3] = 0.0
    reach = torch.tensor([2.0, 4.0]).expand(6, 2)
    before = w_h.clone()
    contract(w_x, w_h, bias, reset, reach)
    for k in range(6):
        arrays = (a[k].double().numpy() for a in (w_x, w_h, bias))
        assert_forgets(*arrays, reset, np.array([2.0, 4.0]))
    assert torch.equal(w_h[0, 0], before[0, 0]) and torch.equal(w_h[0, 2], before[0, 2])
    again = [a.clone() for a in (w_x, w_h, bias)]
    contract(*again, reset, reach)
    for a, b in zip(again, (w_x, w_h, bias), strict=True):
        torch.testing.assert_close(a, b)


def assert_lstm_forgets(w_x, w_h, bias, reach):
    """Hold one LSTM against its conditions, in plain sums; gates i, f, g, o."""
    moved, sums = np.abs(w_x) @ reach, np.abs(w_h).sum(axis=2)
    most = bias + moved + sums
    ratio = (1.0 + np.exp(most[1])) / (1.0 + np.exp(-most[0]))
    assert moved[:2].max() <= SPREAD * (1.0 + 1e-5)
    assert ratio.max() <= RATIO * (1.0 + 1e-4)
    through_cell = ratio * (sums[2] + sums[0] / 4.0 + sums[1])
    assert through_cell.max() <= 0.25 * GROWTH * (1.0 + 1e-4)
    assert sums[3].max() <= GROWTH * (1.0 + 1e-5)
    assert (np.abs(w_x[2:]) * reach).max() <= HELD * (1.0 + 1e-5)
    assert (np.abs(bias) + moved + sums)[2:].max() <= 2.0 * HELD * (1.0 + 1e-5)


def test_weights_of_an_lstm_are_brought_to_the_conditions_and_then_stay():
    generator = torch.Generator().manual_seed(4)
    shapes = ((6, 4, 5, 2), (6, 4, 5, 5), (6, 4, 5))
    arrays = [3.0 * torch.randn(shape, generator=generator) for shape in shapes]
    arrays[1][0] *= 1e-4  # small enough already
    reach = torch.tensor([2.0, 4.0]).expand(6, 2)
    output_gate = arrays[1][0, 3].clone()
    for k in (1, 2):
        with pytest.raises(AssertionError):
            assert_lstm_forgets(*(a[k].double().numpy() for a in arrays), np.array([2.0, 4.0]))
    contract_lstm(*arrays, reach)
    for k in range(6):
        assert_lstm_forgets(*(a[k].double().numpy() for a in arrays), np.array([2.0, 4.0]))
    assert torch.equal(arrays[1][0, 3], output_gate)
    again = [a.clone() for a in arrays]
    contract_lstm(*again, reach)
    for a, b in zip(again, arrays, strict=True):
        torch.testing.assert_close(a, b)


def test_the_chip_holds_the_recurrent_weights_of_an_lstm_as_they_leave_the_training():
    generator = torch.Generator().manual_seed(5)
    shapes = ((20, 4, 5, 2), (20, 4, 5, 5), (20, 4, 5))
    arrays = [5.0 * torch.randn(shape, generator=generator) for shape in shapes]
    reach = np.array([2.0, 4.0])
    contract_lstm(*arrays, torch.tensor(reach, dtype=torch.float32).expand(20, 2))
    exponents = 15 - np.log2(reach).astype(np.int64)
    for w_x, w_h, bias in zip(*(a.double().numpy() for a in arrays), strict=True):
        lstm = FloatLstm(w_x, trim_weights(w_h), bias)
        whole = quantize_lstm(lstm, exponents, "int16")
        for g in (2, 3):  # the arguments of the others move little
            counts = 2.0 ** (whole.shift[g] + (16 if g == 2 else 15) - 15)
            np.testing.assert_array_equal(whole.w_h[g] / counts, lstm.w_h[g])


def test_recurrent_weights_of_an_lstm_are_rounded_towards_nothing():
    config = NetworkConfig(kind="lstm", hidden=5, options={"contracting": True})
    network = build_network(config, 2, 2, torch.Generator().manual_seed(1))
    trained, left = network.w_h.detach().double().numpy(), network.to_float().w_h
    assert (left == np.round(left / FINE_GRID) * FINE_GRID).all()
    assert (np.abs(left) <= np.abs(trained)).all()
    assert 0.0 < np.abs(left - trained).max() < FINE_GRID


def pose(options, seed=5, kind="gru"):
    sequences = draw_sequences(np.random.default_rng(seed), (80, 60), 2)
    config = NetworkConfig(kind=kind, hidden=5, options=options)
    settings = replace(SETTINGS, epochs=30)
    return Problem(lambda g: build_network(config, 2, 2, g), sequences, sequences[:1], settings)


@pytest.mark.spread(1, "form", ["reset_after", "reset_before"])
def test_training_ends_within_the_conditions_and_a_free_one_does_not(form):
    reset = form.removeprefix("reset_")
    ends = {}
    for contracting in (True, False):
        problem = pose({"form": form, "contracting": contracting})
        (found,) = train_networks([problem])
        assert isinstance(found, Result)
        assert found.rmse < found.rmse_without
        weights = [found.weights[name].astype(np.float64) for name in ("w_x", "w_h", "bias")]
        ends[contracting] = (*weights, reset, np.array(measure_reach(problem.sequences)))
    assert_forgets(*ends[True])
    with pytest.raises(AssertionError):
        assert_forgets(*ends[False])


@pytest.mark.parametrize("contracting", [True, False])
def test_recurrent_weights_leave_the_training_as_the_chip_can_hold_them(contracting):
    options = {"contracting": contracting}
    network = build_network(
        NetworkConfig(kind="gru", hidden=5, options=options), 2, 2, torch.Generator()
    )
    trained, left = network.w_h.detach().double().numpy(), network.to_float()
    assert (left.w_h == np.round(left.w_h / GRID) * GRID).all() == contracting
    assert np.abs(left.w_h - trained).max() <= (0.5 * GRID if contracting else 0.0)
    np.testing.assert_array_equal(left.w_x, network.w_x.detach().double().numpy())


def test_a_checkpoint_of_a_free_training_is_not_taken_up():
    marks = {mark_problems([pose(options)]) for options in ({}, {"contracting": True})}
    assert len(marks) == 2
    assert mark_problems([pose({"contracting": False})]) in marks


def test_only_a_gru_or_lstm_takes_it():
    text = TOML + NETWORK.replace('"gru"', '"mlp"')
    with pytest.raises(InputError, match="only a GRU or LSTM"):
        parse_config(text, Path("/project/zerodrift.toml"))
    text = TOML + NETWORK.replace('"gru"', '"lstm"')
    config = parse_config(text, Path("/project/zerodrift.toml"))
    assert config.network.options["contracting"] is True
    config = parse_config(TOML + NETWORK, Path("/project/zerodrift.toml"))
    assert config.network.options["contracting"] is True
    without = NETWORK.replace("contracting = true\n", "")
    for text in (without, without + "contracting = false\n"):
        config = parse_config(TOML + text, Path("/project/zerodrift.toml"))
        assert "contracting" not in config.network.options


@pytest.mark.long
@pytest.mark.parametrize(
    ("kind", "weights"), [("gru", "int16"), ("gru", "int8"), ("lstm", "int16")]
)
def test_the_firmware_of_one_has_a_bound_and_training_says_what_it_costs(kind, weights, tmp_path):
    write_lagging_logs(tmp_path / "logs")
    network = NETWORK.replace("gru", kind) + f'\n[quantization]\nweights = "{weights}"\n'
    (tmp_path / "zerodrift.toml").write_text(TOML + network)
    result = CliRunner().invoke(cli, ["train", "-C", str(tmp_path), "--json"])
    assert result.exit_code == 0, result.output
    told = json.loads(result.stdout)
    assert told["network"]
    cost = told["contracting"]
    assert cost["ratio"] == pytest.approx(cost["rmse"] / cost["rmse_free"])
    assert 0.2 < cost["ratio"] < 5.0 and cost["left_out"]
    assert any("contracting = true: on the runs left out" in note for note in told["notes"])
    result = CliRunner().invoke(cli, ["firmware", "-C", str(tmp_path), "--json", "--force"])
    assert result.exit_code == 0, result.output
    for name, full_scale in (("Fz", 10.0), ("Mx", 5.0)):
        bound = json.loads(result.stdout)["error_bound"][name]
        assert 0.0 < bound["value"] < 0.005 * full_scale
    assert CliRunner().invoke(cli, ["verify", "-C", str(tmp_path)]).exit_code == 0


def test_a_head_is_shrunk_row_by_row_where_it_reaches_too_far():
    head = torch.randn(4, 3, 6, generator=torch.Generator().manual_seed(5))
    swing = torch.full((4, 3), 1.5)
    swing[0, 0] = 100.0
    before = head.clone()
    limit_head(head, swing)
    reach = head.abs().sum(dim=2)
    assert (reach <= swing * (1.0 + 1e-6)).all()
    small = before.abs().sum(dim=2) <= swing
    assert torch.equal(head[small], before[small])
    ratio = (head / before)[~small]
    assert torch.allclose(ratio, ratio[:, :1].expand_as(ratio))


@pytest.mark.spread(1, "kind", ["gru", "lstm"])
def test_a_limited_network_answers_no_further_than_it_learnt(kind):
    """And a free one, trained on the same, does."""
    reach = {}
    for limited in (False, True):
        problem = pose({"limited": limited}, kind=kind)
        (found,) = train_networks([problem])
        assert isinstance(found, Result)
        assert found.rmse < found.rmse_without
        reach[limited] = np.abs(found.weights["head"]).sum(axis=1)
    swing = np.array(measure_swing(problem.sequences))
    assert (reach[True] <= swing * (1.0 + 1e-5)).all()
    assert (reach[False] > swing).any()


def test_only_recurrent_networks_are_limited():
    text = TOML + NETWORK.replace('"gru"', '"mlp"').replace("contracting", "limited")
    with pytest.raises(InputError, match="its answer has limits"):
        parse_config(text, Path("/project/zerodrift.toml"))


def test_a_limited_training_is_another_one():
    assert mark_problems([pose({})]) != mark_problems([pose({"limited": True})])
