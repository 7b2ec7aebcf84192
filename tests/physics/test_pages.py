"""The pages about effects say what the code does."""

import re
from pathlib import Path

from tests.physics.conftest import FULL_SCALE, OUTPUTS, UNITS, follow, make_dataset

from zerodrift.base.config import EffectConfig
from zerodrift.operations.registry import OPERATIONS
from zerodrift.physics.catalogue import load_catalogue
from zerodrift.physics.description import render_effects_page
from zerodrift.physics.effect import Signals
from zerodrift.physics.fit import fit

DOCS = Path(__file__).parents[2] / "docs"


def test_reference_page_is_as_new_as_the_declarations():
    written = (DOCS / "reference" / "effects.md").read_text(encoding="utf-8")
    assert written == render_effects_page(load_catalogue()), (
        "run: python -m zerodrift.physics.description > docs/reference/effects.md"
    )


def test_example_of_the_how_to_works(tmp_path):
    page = (DOCS / "how-to" / "write-an-effect.md").read_text(encoding="utf-8")
    (code,) = re.findall(r"```python\n(.*?)```", page, flags=re.DOTALL)
    path = tmp_path / "my_effects.py"
    path.write_text(code, encoding="utf-8")

    def disturb(bench):
        return follow(follow(bench.temperature, 60.0), 60.0)[:, None] * 1.0

    model = fit(
        [EffectConfig("second_order_lag")],
        make_dataset(disturb, runs=4, length=400).train,
        outputs=OUTPUTS,
        units=UNITS,
        full_scale=FULL_SCALE,
        catalogue=load_catalogue([path]),
    )
    assert 55.0 < model.terms[0].term.values["tau_s"] < 65.0


def test_how_to_names_every_operation_and_signal():
    page = (DOCS / "how-to" / "write-an-effect.md").read_text(encoding="utf-8")
    operations = {*OPERATIONS, "constant"}
    for name in operations:
        assert f"`{name}(" in page or f" `{name}(" in page, name
    for name in set(Signals.__dataclass_fields__) - {"saturated", "arrivals"}:
        assert name in page, name
