"""The error bound of LSTMs: no input exceeds it, unsound rules are found, the check derives it."""

import json
from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest

from tests.bound.lstms import (
    REACH,
    Forgetful,
    draw_lstm,
    make_lstm,
    make_lstm_probe,
    measure_lstm,
    measure_lstm_probe,
)
from tests.bound.planted_lstm import FOUND, RULES
from tests.bound.recurrent import make_case
from zerodrift.export.error_bound import round_up
from zerodrift.export.float_network import FloatLayer, FloatNetwork
from zerodrift.operations.errors import Known
from zerodrift.operations.gate_sums import RealUnit
from zerodrift.operations.lstm import IntegerLstmLayer, error
from zerodrift.operations.lstm.error import HALVINGS, FloatGate, StepRules, halve
from zerodrift_proof.bound import recurrent as bound_lstm
from zerodrift_proof.bound.recurrent import GateLine, list_parts
from zerodrift_proof.certificate.check import compare

KINDS = (
    Forgetful(),
    Forgetful(hidden=4, forget=1.0),
    Forgetful(hidden=4, forget=3.0, window=10),
    Forgetful(hidden=8, coupling=0.5, forget=-1.0, seed=5),
    Forgetful(hidden=8, forget=2.0, weights="int8"),
    Forgetful(hidden=5, weights="int8", window=6, seed=2),
    Forgetful(hidden=6, forget=4.5, of_gates=0.05, seed=4),
    Forgetful(hidden=3, coupling=0.0, of_gates=0.4, seed=6),
)
MANY = tuple(
    replace(kind, seed=seed, forget=forget, of_gates=0.05 if forget > 2.0 else kind.of_gates)
    for kind in KINDS
    for seed in (21, 22, 23)
    for forget in (-2.0, 1.0, 4.0)
)


def _hold(kinds: tuple[Forgetful, ...]) -> None:
    for kind in kinds:
        bound = make_lstm(kind).bound()
        assert bound.outputs, (kind, bound.why)
        largest = [round_up(error.total) for error in bound.outputs]
        assert (np.array(measure_lstm(kind)) <= largest).all(), kind
        assert (10.0**3 * np.array(measure_lstm(kind)) > largest).all(), kind


@pytest.mark.long
def test_no_drawn_input_exceeds_the_bound_of_an_lstm() -> None:
    _hold(KINDS)


@pytest.mark.slow
def test_no_drawn_input_exceeds_the_bound_of_many_lstms() -> None:
    _hold(MANY)


@pytest.mark.spread(
    1,
    ("of_states", "of_forget", "said"),
    [
        (16.0, 0.0, "no contraction is shown"),
        (1.0, 7.5, "cell state may go beyond"),
        (1.0, 14.0, "forget gate comes so near to 1"),
    ],
)
def test_an_lstm_that_does_not_forget_has_no_bound_and_it_is_said_why(
    of_states: float, of_forget: float, said: str
) -> None:
    lstm = draw_lstm(Forgetful(hidden=4, coupling=0.8))
    bias = lstm.bias + np.array([0.0, of_forget, 0.0, 0.0])[:, None]
    case = make_case(replace(lstm, w_h=of_states * lstm.w_h, bias=bias), np.ones((2, 4)))
    bound = case.bound()
    assert bound.outputs == ()
    assert said in bound.why and "no contraction" in bound.why and "contracting = true" in bound.why


@pytest.mark.long
def test_the_rule_is_tight_where_the_candidate_is_most_of_it() -> None:
    bound = make_lstm_probe().bound()
    for of_output, found in zip(bound.outputs, measure_lstm_probe(), strict=True):
        assert found <= round_up(of_output.total) <= 1.25 * found


@pytest.mark.spread(0, "lacks", FOUND)
def test_an_unsound_rule_is_found(lacks: str, monkeypatch: pytest.MonkeyPatch) -> None:
    RULES[lacks](monkeypatch)
    claimed = make_lstm_probe().bound().outputs
    largest = measure_lstm_probe()
    assert any(x > of_output.total for x, of_output in zip(largest, claimed, strict=True))


@pytest.mark.spread(2, "lacks", RULES)
def test_what_an_unsound_rule_claims_is_refused_by_the_check(
    lacks: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    case = make_lstm(Forgetful(coupling=0.0, of_gates=0.3, forget=-2.0, seed=3))
    RULES[lacks](monkeypatch)
    told, texts = case.certify()
    monkeypatch.undo()
    assert len(compare(told, texts).failures) == len(told["error_bound"])


@pytest.mark.long
def test_a_check_that_leaves_parts_out_would_confirm_what_an_input_exceeds(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    told, texts = make_lstm_probe().certify()
    for claim, found in zip(told["error_bound"], measure_lstm_probe(), strict=True):
        claim["bound"] = 0.9 * found
    assert len(compare(told, texts).failures) == len(told["error_bound"])

    def leave_out(
        lines: list[GateLine], whole: list[tuple[int, int]]
    ) -> list[list[tuple[int, int]]]:
        return [part for part in list_parts(lines, whole) if part[0][0] <= sum(whole[0]) // 2]

    monkeypatch.setattr(bound_lstm, "list_parts", leave_out)
    assert not compare(told, texts).failures


@pytest.mark.parametrize("inputs", [1, 2, 5])
def test_parts_cover_what_features_can_be_once_and_are_the_same_in_both_derivations(
    inputs: int,
) -> None:
    rng = np.random.default_rng(inputs)
    gates, lines = list[FloatGate](), list[GateLine]()
    for _ in range(4):
        weights, gaps = (1e-4 * rng.normal(size=inputs)).tolist(), rng.normal(size=inputs).tolist()
        gaps = [1e-9 * gap for gap in gaps]
        gates.append(FloatGate(0.3, tuple(weights), 0.2, 1e-6, tuple(gaps), 1e-5))
        lines.append(GateLine(0.3, weights, 0.2, 1e-6, gaps, 1e-5))
    box = ((-32768, 32767), (-300, 20000), (7, 7), (0, 1), (-5, 9000))[:inputs]
    parts = halve(gates, box)
    assert HALVINGS // 2 < len(parts) <= HALVINGS + 1  # a part that is a point stays
    assert [tuple(part) for part in list_parts(lines, list(box))] == parts
    sizes = [np.prod([last - first + 1.0 for first, last in part]) for part in parts]
    assert sum(sizes) == np.prod([last - first + 1.0 for first, last in box])
    for x in rng.integers([a for a, _ in box], [b + 1 for _, b in box], size=(2000, inputs)):
        inside = [all(a <= q <= b for q, (a, b) in zip(x, part, strict=True)) for part in parts]
        assert sum(inside) == 1


def test_a_point_has_one_part() -> None:
    gate = FloatGate(0.0, (1.0,), 0.0, 0.0, (0.0,), 0.0)
    assert halve([gate] * 4, ((3, 3),)) == [((3, 3),)]
    line = GateLine(0.0, [1.0], 0.0, 0.0, [0.0], 0.0)
    assert list_parts([line] * 4, [(3, 3)]) == [[(3, 3)]]


def test_of_lstms_on_top_of_each_other_only_the_range_is_claimed() -> None:
    case = make_lstm(KINDS[1])
    network = case.described.network
    assert isinstance(network, FloatNetwork)
    upper = replace(draw_lstm(KINDS[1]), w_x=np.zeros((4, 4, 4)))
    layers = (*network.layers, FloatLayer(upper, (1,)))
    described = replace(case.described, network=replace(network, layers=layers, reads=(2,)))
    bound = type(case).of(described, case.calibration).bound()
    assert all(error.range > 0.99 * error.total for error in bound.outputs)
    assert "no contraction is shown" in bound.why


@pytest.mark.parametrize("kind", KINDS[:2], ids=str)
def test_the_way_to_rest_ends_as_near_as_is_said(kind: Forgetful) -> None:
    """Of float LSTMs under constant features, beside ones that settle several times as long."""
    lstm = draw_lstm(kind)
    (node,) = (n for n in make_lstm(kind).quantized.model.nodes if isinstance(n, IntegerLstmLayer))
    rows = [
        [*lstm.bias[:, j], *lstm.w_x[:, j].ravel(), *lstm.w_h[:, j].ravel()]
        for j in range(kind.hidden)
    ]
    units = [RealUnit.of(row, 2, kind.hidden, 4) for row in rows]
    count = Fraction(1, 1 << 13)
    features = [Known(-32768, 32767, count, Fraction(0))] * 2
    rules = StepRules(node.layers[0], units, features)
    growths = [error.bound_growth(rules, j, [features]) for j in range(kind.hidden)]
    left = error._settle(growths, [e.total for e in error._solve(growths)])
    x = np.random.default_rng(1).uniform(-REACH, REACH, size=(500, 2))
    once = lstm.settle(x)
    state = once
    for _ in range(20):
        state = lstm._run(np.repeat(x[:, None], 64, axis=1), state, relaxing=True)[1]
    far = np.abs(once - state).max(axis=0)
    allowed = [float(h) for _, h in left] + [float(c) for c, _ in left]
    assert (far <= np.array(allowed) + 1e-15).all()
    assert max(allowed) < 1e-4


@pytest.mark.spread(0, "kind", KINDS, ids=str)
def test_the_check_confirms_the_bound_and_refuses_a_smaller_one(kind: Forgetful) -> None:
    told, texts = make_lstm(kind).certify()
    assert not compare(told, texts).failures
    for claim in told["error_bound"]:
        claim["bound"] *= 1.0 - 5e-3
    assert len(compare(told, texts).failures) == len(told["error_bound"])


@pytest.mark.long
def test_a_change_of_a_weight_of_the_float_layer_is_noticed() -> None:
    """One number of a unit a tenth more, in turn: the biases, weights of each gate."""
    told, texts = make_lstm(KINDS[1]).certify()
    rows = [line for line in told["float_model"] if line["operation"] == "lstm"]
    assert len(rows) == 4
    noticed = tried = 0
    for place in (0, 1, 2, 3, 4, 6, 8, 10, 12, 17, 20, 25):
        changed = json.loads(json.dumps(told))
        line = changed["float_model"][told["float_model"].index(rows[1])]
        line["numbers"][place] *= 1.1
        tried += 1
        noticed += bool(compare(changed, texts).failures)
    assert noticed >= 0.9 * tried


@pytest.mark.spread(1, "change", ["operation", "order", "short", "reads"])
def test_a_float_layer_that_is_not_the_cs_is_refused(change: str) -> None:
    told, texts = make_lstm(KINDS[1]).certify()
    rows = [line for line in told["float_model"] if line["operation"] == "lstm"]
    for line in rows:
        if change == "operation":
            line["operation"] = "gru_after"
        if change == "order":
            line["index"] = 3 - line["index"]
        if change == "short":
            line["numbers"] = line["numbers"][:-1]
        if change == "reads":
            line["of"] = line["of"][::-1]
    assert not compare(told, texts).understood
