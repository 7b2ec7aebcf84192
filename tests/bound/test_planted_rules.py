"""An unsound error rule is found: some input of some model goes beyond what it claims."""

import pytest

from tests.bound.planted import FOUND, MODELS, NETWORKS, PlantedRule, make_case, measure
from zerodrift.export.error_bound import round_up
from zerodrift.operations.registry import NODE_CLASSES


@pytest.mark.parametrize("name", [*MODELS, *NETWORKS])
def test_the_rules_hold_on_a_model_of_few_operations(name: str) -> None:
    bound = make_case(name).bound()
    assert bound.outputs, bound.why
    for error, found in zip(bound.outputs, measure(name), strict=True):
        assert found <= round_up(error.total) <= 4.0 * found


@pytest.mark.parametrize("rule", FOUND, ids=lambda rule: f"{rule.kind} without {rule.lacks}")
def test_an_unsound_rule_is_found(rule: PlantedRule, monkeypatch: pytest.MonkeyPatch) -> None:
    kind = NODE_CLASSES[rule.kind]
    monkeypatch.setattr(kind, "bound_error", rule.replace(kind.bound_error))
    claimed = make_case(rule.model).bound().outputs
    largest = measure(rule.model)
    assert any(x > error.total for x, error in zip(largest, claimed, strict=True))
