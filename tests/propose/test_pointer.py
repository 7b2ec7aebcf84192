"""`diagnose` points to `propose` where the catalogue ends, and nowhere else."""

import pytest

from tests.report.test_verdict import told
from zerodrift.physics.catalogue import load_catalogue
from zerodrift.report.sentences import explain_verdict


@pytest.mark.parametrize(
    ("diagnosis", "pointed"),
    [
        (told("unknown"), True),
        (told("complete"), False),
        (told("missing", "creep", something_else=0.2), False),
        (told("missing", "creep", something_else=0.8), True),
    ],
)
def test_a_formula_is_looked_for_where_no_effect_explains_all(diagnosis, pointed):
    sentences = explain_verdict(diagnosis, "zerodrift add creep", load_catalogue())
    assert any("zerodrift propose" in one.text for one in sentences) is pointed
