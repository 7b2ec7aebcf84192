"""SOUNDNESS.md claims of each kind of model what the code does."""

import pytest

from tests.bound import claims
from tests.house.test_order import ROOT
from zerodrift.operations.errors import CAUSES

PAGE = (ROOT / "SOUNDNESS.md").read_text(encoding="utf-8")


@pytest.mark.long
def test_the_table_on_the_page_is_what_the_code_says() -> None:
    _, _, rest = PAGE.partition(claims.BEGIN)
    table, found, _ = rest.partition(claims.END)
    assert found
    assert table.strip() == claims.write_table()


def test_every_cause_of_an_error_is_named_on_the_page() -> None:
    assert [cause for cause in CAUSES if f"| `{cause}` |" not in PAGE] == []


def test_models_of_one_kind_have_the_same_bound(monkeypatch: pytest.MonkeyPatch) -> None:
    kinds = [*claims.KINDS]
    mixed = {"all": (*claims.KINDS[kinds[0]], *claims.KINDS[kinds[4]])}
    monkeypatch.setattr(claims, "KINDS", mixed)
    with pytest.raises(ValueError, match="all: "):
        claims.find_claim("all")
