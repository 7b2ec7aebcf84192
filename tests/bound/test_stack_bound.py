"""The error bound of GRUs on top of each other: no input exceeds it, the check derives it again."""

import json
from collections.abc import Sequence
from dataclasses import replace
from fractions import Fraction
from functools import cache

import numpy as np
import pytest

from tests.bound.cases import Case
from tests.bound.recurrent import (
    STEPS,
    Forgetful,
    draw_all_codes,
    draw_gru,
    draw_probe,
    draw_upper,
    make_case,
    make_recurrent,
    measure_recurrent,
)
from zerodrift.export import error_bound
from zerodrift.export.error_bound import round_up
from zerodrift.operations.errors import Error, Known
from zerodrift.operations.gru import IntegerGruLayer
from zerodrift.operations.gru.cell import FloatGru
from zerodrift.operations.gru_stack import IntegerGruStack
from zerodrift.operations.signals import Real
from zerodrift_proof.certificate.check import compare

KINDS = (
    Forgetful(hidden=4, upper=(3,)),
    Forgetful(hidden=3, upper=(4, 2), update=-4.0, of_update=0.3),
    Forgetful(hidden=4, upper=(4,), reset="before", coupling=0.8, seed=2),
    Forgetful(hidden=4, upper=(3,), weights="int8", coupling=0.8, seed=3),
    Forgetful(hidden=3, upper=(3,), window=6, seed=4),
)
MANY = tuple(replace(kind, seed=seed) for kind in KINDS for seed in (11, 12, 13))


def _hold(kinds: tuple[Forgetful, ...]) -> None:
    for kind in kinds:
        bound = make_recurrent(kind).bound()
        assert bound.outputs, (kind, bound.why)
        largest = [round_up(error.total) for error in bound.outputs]
        found = np.array(measure_recurrent(kind))
        assert (found <= largest).all(), kind
        assert (10.0**3 * found > largest).all(), kind


@pytest.mark.long
def test_no_drawn_input_exceeds_the_bound_of_a_stack() -> None:
    _hold(KINDS)


@pytest.mark.slow
def test_no_drawn_input_exceeds_the_bound_of_many_stacks() -> None:
    _hold(MANY)


@cache
def make_tower() -> tuple[Case, tuple[float, ...]]:
    """Return a layer whose units are off alike, one unit that adds them up, and what is found."""
    w_x, bias = np.zeros((3, 1, 10)), np.zeros((4, 1))
    w_x[2, 0, 1:9] = 0.125
    bias[1] = 6.0
    upper = FloatGru(w_x, np.zeros((3, 1, 1)), bias, "after")
    below = draw_probe("passed on")
    case = make_case(below, np.array([[1.0], [0.5]]), feature_max=0.25, upper=(upper,))
    codes = draw_all_codes(case.calibration.code_limits, np.random.default_rng(3), STEPS)
    case = replace(case, codes=codes)
    return case, tuple(case.measure().max(axis=(0, 1)).tolist())


def test_the_rule_is_tight_where_the_layer_below_is_most_of_it() -> None:
    case, found = make_tower()
    for error, most in zip(case.bound().outputs, found, strict=True):
        assert most <= round_up(error.total) <= 3.5 * most


def test_a_rule_without_the_errors_of_the_layer_below_is_found(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    honest = IntegerGruLayer.bound_states

    def claim(self: IntegerGruLayer, rows: Sequence[Real], inputs: Sequence[Known]) -> list[Error]:
        left_out = isinstance(self, IntegerGruStack)
        return honest(self, rows, [replace(x, error=Error()) if left_out else x for x in inputs])

    monkeypatch.setattr(IntegerGruLayer, "bound_states", claim)
    case, found = make_tower()
    assert any(most > error.total for most, error in zip(found, case.bound().outputs, strict=True))


@pytest.mark.spread(0, "kind", KINDS, ids=str)
def test_the_check_confirms_the_bound_and_refuses_a_smaller_one(kind: Forgetful) -> None:
    told, texts = make_recurrent(kind).certify()
    assert not compare(told, texts).failures
    for claim in told["error_bound"]:
        claim["bound"] *= 1.0 - 8e-3
    assert len(compare(told, texts).failures) == len(told["error_bound"])


@pytest.mark.spread(1, "change", ["operation", "order", "short", "reads", "skips", "fine"])
def test_a_float_stack_that_is_not_the_cs_is_refused(change: str) -> None:
    told, texts = make_recurrent(KINDS[0]).certify()
    lines = told["float_model"]
    low = [k for k, line in enumerate(lines) if line["node"] == "gru.0"]
    top = [k for k, line in enumerate(lines) if line["node"] == "gru"]
    assert len(low) == 4 and len(top) == 3
    for k in low:
        if change == "operation":
            lines[k]["operation"] = "gru_before"
        if change == "order":
            lines[k]["index"] = 3 - lines[k]["index"]
        if change == "short":
            lines[k]["numbers"] = lines[k]["numbers"][:-1]
        if change == "fine":
            lines[k]["scale"] = 2.0**-30
    for k in top:
        if change == "reads":
            lines[k]["of"] = lines[k]["of"][::-1]
        if change == "skips":
            lines[k]["of"] = lines[low[0]]["of"]
    assert not compare(told, texts).understood


@pytest.mark.long
def test_a_change_of_a_weight_of_the_lower_layer_is_noticed() -> None:
    told, texts = make_recurrent(
        Forgetful(hidden=4, upper=(3,), update=-4.0, of_update=0.3)
    ).certify()
    place = next(k for k, x in enumerate(told["float_model"]) if x["node"] == "gru.0")
    noticed = tried = 0
    for number in (0, 1, 4, 8, 10, 15):
        changed = json.loads(json.dumps(told))
        changed["float_model"][place]["numbers"][number] *= 1.1
        tried += 1
        noticed += bool(compare(changed, texts).failures)
    assert noticed >= 0.6 * tried


def test_a_stack_with_a_layer_that_may_not_forget_has_no_bound() -> None:
    kind = Forgetful(hidden=4, upper=(3,), coupling=0.9)
    (upper,) = draw_upper(kind)
    wild = replace(upper, w_h=9.0 * upper.w_h)
    bound = make_case(draw_gru(kind), np.ones((2, 3)), upper=(wild,)).bound()
    assert bound.outputs == () and "no contraction is shown" in bound.why


def test_the_copy_between_two_layers_is_half_a_count_off() -> None:
    assert error_bound.OF_COPY.total == Fraction(1, 1 << 16)
