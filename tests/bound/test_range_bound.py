"""Networks whose errors may grow: their answers differ by no more than the states' range allows."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from tests.bound.cases import Case
from tests.bound.lstms import Forgetful as Gated
from tests.bound.lstms import draw_lstm
from tests.bound.recurrent import Forgetful, draw_all_codes, draw_gru, draw_upper, make_case
from tests.effects_on_chip.random_graphs import LSBS
from zerodrift.export.error_bound import round_up
from zerodrift.export.float_network import FloatLayer, FloatNetwork
from zerodrift.operations.gru.cell import FloatGru
from zerodrift_proof.certificate.check import compare

KIND = Forgetful(hidden=4, upper=(3,), coupling=0.9)
HEAD = 0.1 * np.array([[1.0, -0.5, 0.3, 0.2], [0.0, 0.6, -0.7, 0.1]])


def _make_gru(reset: str = "after", window: int = 0) -> Case:
    gru = draw_gru(replace(KIND, reset=reset))
    return make_case(replace(gru, w_h=9.0 * gru.w_h), HEAD, window=window)


def _make_stack() -> Case:
    upper = tuple(replace(layer, w_h=9.0 * layer.w_h) for layer in draw_upper(KIND))
    return make_case(draw_gru(KIND), HEAD[:, :3], upper=upper)


def _make_lstm(layers: int = 1) -> Case:
    lstm = draw_lstm(Gated(hidden=4, coupling=0.8))
    lstm = replace(lstm, w_h=9.0 * lstm.w_h)
    case = make_case(lstm, HEAD)
    network = case.described.network
    assert isinstance(network, FloatNetwork)
    wide = replace(lstm, w_x=np.concatenate([lstm.w_x] * 2, axis=2))
    above = tuple(FloatLayer(wide, (k,)) for k in range(1, layers))
    network = replace(network, layers=network.layers + above, reads=(layers,))
    return Case.of(replace(case.described, network=network), case.calibration)


WILD: dict[str, Callable[[], Case]] = {
    "gru": _make_gru,
    "reset before": lambda: _make_gru("before"),
    "window": lambda: _make_gru(window=8),
    "stack": _make_stack,
    "lstm": _make_lstm,
    "stack of lstms": lambda: _make_lstm(2),
    "three lstms": lambda: _make_lstm(3),
}


@pytest.mark.spread(4, "name", WILD)
def test_what_lies_within_a_range_is_off_by_no_more(name: str) -> None:
    case = WILD[name]()
    network = case.described.network
    assert network is not None
    bound = case.bound()
    reach = 2.0 * np.abs(network.head).sum(axis=1)
    told = np.array([round_up(error.total) for error in bound.outputs])
    assert (told >= 0.999 * reach).all() and (told <= 1.001 * reach).all()
    assert all(error.range > 0.99 * error.total for error in bound.outputs)
    assert "no contraction is shown" in bound.why
    assert "between -1 and 1" in bound.holds
    codes = draw_all_codes(case.calibration.code_limits, np.random.default_rng(3), 104)
    assert (replace(case, codes=codes).measure() <= told).all()


@pytest.mark.spread(1, "name", WILD)
def test_the_check_derives_it_and_refuses_less(name: str) -> None:
    told, texts = WILD[name]().certify()
    assert not compare(told, texts).failures
    for claim in told["error_bound"]:
        claim["bound"] *= 1.0 - 1e-3
    assert len(compare(told, texts).failures) == len(told["error_bound"])


def test_chip_and_float_model_can_be_as_far_apart_as_that() -> None:
    """A state that leaves 0 to either side: a rounded weight decides for the chip, no other way."""
    weight, push = 0.758, -1e-7
    w_x, w_h, bias = np.zeros((3, 1, 2)), np.zeros((3, 1, 1)), np.zeros((4, 1))
    w_x[2, 0, 0], w_h[2], bias[0] = weight, 4.0, 6.0
    head = np.full((2, 1), 0.1)
    case = make_case(FloatGru(w_x, w_h, bias, "after"), head)
    low, high = np.array(case.calibration.code_limits).T
    codes = (low + high) // 2 + (high - low) // 5
    feature = np.array([codes[0] * LSBS[0] / 47.0, codes[1] * LSBS[1] / 9.0 + 0.13])
    feature = case.described.whitening @ (feature - case.described.tap_mean)
    bias[2] = push - weight * feature[0]
    case = make_case(FloatGru(w_x, w_h, bias, "after"), head)
    told = [round_up(error.total) for error in case.bound().outputs]
    found = replace(case, codes=np.tile(codes, (1, 200, 1))).measure().max(axis=(0, 1))
    assert (0.999 * np.array(told) <= found).all() and (found <= told).all()


def make_wide_gru() -> Case:
    """Return a model whose answer is limited before the range of its states says anything."""
    gru = draw_gru(KIND)
    return make_case(replace(gru, w_h=9.0 * gru.w_h), 20.0 * HEAD)


def test_where_the_limits_of_the_answer_say_as_much_nothing_is_told() -> None:
    bound = make_wide_gru().bound()
    assert bound.outputs == () and "no contraction is shown" in bound.why


CHANGES: dict[str, dict[str, Any]] = {
    "no layer": {"node": "x"},
    "the features": {"node": "features"},
    "another unit": {"index": 7},
    "another format": {"scale": 2.0**-31},
    "a shifted one": {"offset": 0.5},
    "numbers": {"numbers": [1.0]},
}


@pytest.mark.spread(1, "change", CHANGES)
def test_what_is_no_state_of_the_c_is_refused(change: str) -> None:
    told, texts = _make_gru().certify()
    line = next(line for line in told["float_model"] if line["operation"] == "state")
    line.update(CHANGES[change])
    assert compare(told, texts).failures
