"""The error bound of GRUs: no input exceeds it, unsound rules are found, the check derives it."""

import json
from dataclasses import replace

import numpy as np
import pytest

from tests.bound.planted_recurrent import FOUND, RULES
from tests.bound.recurrent import (
    PROBES,
    Forgetful,
    draw_gru,
    make_case,
    make_probe,
    make_recurrent,
    measure_probe,
    measure_recurrent,
)
from zerodrift.export.error_bound import round_up
from zerodrift.operations.tables import T_MAX, T_MIN, bound_sigmoid_table, sigmoid_q31
from zerodrift_proof.bound.numbers import sigmoid_error
from zerodrift_proof.certificate.check import compare

KINDS = (
    Forgetful(),
    Forgetful(hidden=4, update=-4.0, of_update=0.3),
    Forgetful(hidden=4, update=-4.0, of_update=0.3, window=10),
    Forgetful(hidden=8, coupling=0.9, update=3.0),
    Forgetful(hidden=8, coupling=0.9, weights="int8"),
    Forgetful(hidden=5, coupling=0.9, weights="int8", window=6, seed=2),
    Forgetful(hidden=4, reset="before", coupling=0.9),
    Forgetful(hidden=4, reset="before", weights="int8", update=-4.0, of_update=0.3),
    Forgetful(hidden=3, reset="before", coupling=0.9, window=10, seed=3),
    Forgetful(hidden=6, coupling=0.95, update=-6.0, of_update=0.2, seed=4),
)
MANY = tuple(
    replace(kind, seed=seed, update=update, of_update=1.0 if update > -1.0 else 0.3)
    for kind in KINDS
    for seed in (11, 12, 13)
    for update in (6.0, 0.0, -5.0)
)


def _hold(kinds: tuple[Forgetful, ...]) -> None:
    for kind in kinds:
        bound = make_recurrent(kind).bound()
        assert bound.outputs, (kind, bound.why)
        largest = [round_up(error.total) for error in bound.outputs]
        assert (np.array(measure_recurrent(kind)) <= largest).all(), kind
        assert (10.0**3 * np.array(measure_recurrent(kind)) > largest).all(), kind


@pytest.mark.long
def test_no_drawn_input_exceeds_the_bound_of_a_gru() -> None:
    _hold(KINDS)


@pytest.mark.slow
def test_no_drawn_input_exceeds_the_bound_of_many_grus() -> None:
    _hold(MANY)


@pytest.mark.spread(2, "name", PROBES)
def test_the_rule_is_tight_where_one_part_of_it_shows(name: str) -> None:
    bound = make_probe(name).bound()
    assert bound.outputs, bound.why
    for error, found in zip(bound.outputs, measure_probe(name), strict=True):
        assert found <= round_up(error.total) <= 3.5 * found


@pytest.mark.spread(6, ("lacks", "name"), FOUND)
def test_an_unsound_rule_is_found(lacks: str, name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    RULES[lacks](monkeypatch)
    claimed = make_probe(name).bound().outputs
    largest = measure_probe(name)
    assert any(x > error.total for x, error in zip(largest, claimed, strict=True))


def test_a_gru_whose_errors_may_grow_has_no_bound_and_it_is_said_why() -> None:
    gru = draw_gru(Forgetful(hidden=4, coupling=0.9))
    case = make_case(replace(gru, w_h=4.0 * gru.w_h), np.ones((2, 4)))
    bound = case.bound()
    assert bound.outputs == ()
    assert "no contraction is shown" in bound.why
    assert "contracting = true" in bound.why


def test_of_a_gru_that_hardly_moves_only_the_range_is_claimed() -> None:
    gru = draw_gru(Forgetful(update=-14.0))
    bound = make_case(gru, np.ones((2, 1))).bound()
    assert all(error.range > 0.99 * error.total for error in bound.outputs)
    assert "near to 0" in bound.why


@pytest.mark.parametrize("ends", [(-3, 3), (-8, 8), (-9, 1), (2, 6), (-1, 15), (-17, 17)])
def test_the_sigmoids_table_is_as_near_as_both_derivations_say(ends: tuple[int, int]) -> None:
    low, high = (end << 15 for end in ends)
    t = np.arange(max(low, T_MIN - 99), min(high, T_MAX + 99) + 1)
    exact = 1.0 / (1.0 + np.exp(-t.astype(np.longdouble) / 2.0**15))
    table = sigmoid_q31(t).astype(np.longdouble) / 2.0**31
    found = bound_sigmoid_table(low, high)
    again = sigmoid_error(_read_lines(), low, high)
    for share, rest in ((found.share, found.rest), again):
        allowed = table * (float(share) * (1.0 - table) + float(rest))
        assert (np.abs(table - exact) <= allowed + 1e-17).all()
    assert abs(float(again[0] - found.share)) < 1e-10 or ends[0] < -16


def _read_lines() -> tuple[tuple[int, int], ...]:
    t = np.arange(T_MIN, T_MAX + 1, 2048)
    first, last = (sigmoid_q31(t + by).astype(np.int64) - (1 << 30) for by in (0, 2047))
    return tuple(zip(first.tolist(), last.tolist(), strict=True))


@pytest.mark.spread(1, "kind", KINDS, ids=str)
def test_the_check_confirms_the_bound_and_refuses_a_smaller_one(kind: Forgetful) -> None:
    told, texts = make_recurrent(kind).certify()
    assert not compare(told, texts).failures
    for claim in told["error_bound"]:
        claim["bound"] *= 1.0 - 4e-3
    assert len(compare(told, texts).failures) == len(told["error_bound"])


@pytest.mark.long
def test_a_change_of_a_weight_of_the_float_layer_is_noticed() -> None:
    """One number of each unit a hundredth more, in turn: the biases, a weight of each array."""
    told, texts = make_recurrent(Forgetful(hidden=4, update=-4.0, of_update=0.3)).certify()
    rows = [line for line in told["float_model"] if line["operation"] == "gru_after"]
    assert len(rows) == 4
    noticed = tried = 0
    for place in (0, 1, 2, 3, 4, 6, 8, 10, 15, 20):
        changed = json.loads(json.dumps(told))
        line = changed["float_model"][told["float_model"].index(rows[1])]
        line["numbers"][place] *= 1.05
        tried += 1
        noticed += bool(compare(changed, texts).failures)
    assert noticed >= 0.7 * tried


@pytest.mark.spread(1, "change", ["operation", "order", "short", "reads"])
def test_a_float_layer_that_is_not_the_cs_is_refused(change: str) -> None:
    told, texts = make_recurrent(Forgetful(hidden=4, update=-4.0, of_update=0.3)).certify()
    rows = [line for line in told["float_model"] if line["operation"] == "gru_after"]
    for line in rows:
        if change == "operation":
            line["operation"] = "gru_before"
        if change == "order":
            line["index"] = 3 - line["index"]
        if change == "short":
            line["numbers"] = line["numbers"][:-1]
        if change == "reads":
            line["of"] = line["of"][::-1]
    outcome = compare(told, texts)
    assert not outcome.understood
