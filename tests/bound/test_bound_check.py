"""The error bound is derived again from the C by other code, and less than that is refused."""

import hashlib
import json
import random
import re
from collections.abc import Mapping
from typing import Any

import pytest

from tests.bound.cases import draw_case
from tests.certificate.test_check import list_texts
from zerodrift.codegen.generate import generate
from zerodrift.verify.certificate import certify
from zerodrift_proof.certificate.check import compare

SEED = 11
NUMBERS = (0, 2, 3, 5, 6, 11)
Told = dict[str, Any]


def _certify(number: int) -> tuple[Told, dict[str, str]]:
    case = draw_case(SEED, number)
    code, bound = generate(case.quantized.model), case.bound()
    assert bound.outputs
    return json.loads(certify(case.quantized.model, code, bound)), list_texts(code)


def _copy(told: Mapping[str, Any]) -> Told:
    copied: Told = json.loads(json.dumps(told))
    return copied


@pytest.mark.spread(1, "number", NUMBERS)
def test_the_bound_is_confirmed_and_any_smaller_one_refused(number: int) -> None:
    told, texts = _certify(number)
    outcome = compare(told, texts)
    assert not outcome.failures
    for claim in told["error_bound"]:
        claim["bound"] *= 1.0 - 1e-4
    assert len(compare(told, texts).failures) == len(told["error_bound"])


@pytest.mark.long
def test_a_change_of_a_parameter_of_the_float_model_is_noticed() -> None:
    """One number of the float model in a thousandth, one at a time."""
    noticed = tried = 0
    for number in (0, 2, 6):
        told, texts = _certify(number)
        draw = random.Random(number)
        places = [
            (i, j)
            for i, line in enumerate(told["float_model"])
            for j, x in enumerate(line["numbers"])
            if x and line["operation"] in ("linear", "lowpass", "input", "dense_tanh", "play")
        ]
        for i, j in draw.sample(places, min(12, len(places))):
            changed = _copy(told)
            changed["float_model"][i]["numbers"][j] *= 1.001
            tried += 1
            noticed += bool(compare(changed, texts).failures)
    # what some weight of next to nothing changes is within the bound
    assert noticed >= 0.7 * tried


@pytest.mark.long
def test_a_change_of_a_number_in_the_c_is_noticed() -> None:
    told, texts = _certify(0)
    name = next(name for name in texts if name.endswith(".c") and not name.startswith("zd_"))
    draws = random.Random(5)
    found = list(re.finditer(r"\(\(int64_t\)(-?\d{6,})", texts[name]))
    noticed = 0
    for match in draws.sample(found, 6):
        number = int(match[1])
        changed = (
            texts[name][: match.start(1)] + str(number * 999 // 1000) + texts[name][match.end(1) :]
        )
        claims = _copy(told)
        claims["files"][name] = hashlib.sha256(changed.encode()).hexdigest()
        failures = compare(claims, {**texts, name: changed}).failures
        noticed += any("an error of at most" in text for text in failures)
    assert noticed >= 5


def test_a_claim_about_another_signal_is_refused() -> None:
    told, texts = _certify(6)
    told["error_bound"][0]["signal"] -= 1
    assert any("another signal" in text for text in compare(told, texts).failures)


def test_an_operation_without_a_rule_is_refused_by_name() -> None:
    told, texts = _certify(6)
    line = next(x for x in told["float_model"] if x["operation"] == "lowpass")
    line["operation"] = "resonance"
    outcome = compare(told, texts)
    assert not outcome.understood
    assert "resonance" in outcome.failures[0]
