"""Effects that hide each other in runs left out, and effects in a form unlike the catalogue's."""

from pathlib import Path

import pytest
from benchmarks.third_simulator import draw_case

from zerodrift.base.config import load_config
from zerodrift.dataset.load import load_dataset
from zerodrift.diagnosis import diagnose


@pytest.fixture(scope="module")
def project(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A load cell whose creep and whose air pressure are ten times its noise; simulated."""
    folder = tmp_path_factory.mktemp("pair")
    draw_case(181215418, runs=7, effect=("barometric_pressure", "creep"), size=10.0).write(folder)
    return folder


def test_two_effects_that_hide_each_other_are_both_named(
    project: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    config = load_config(project)
    dataset = load_dataset(config)
    found = diagnose.diagnose_config(config, dataset)
    assert found.verdict == "missing"
    assert {found.effect, *found.also} == {"barometric_pressure", "creep"}
    monkeypatch.setattr(diagnose, "find_pair", lambda case, first: [])
    assert diagnose.diagnose_config(config, dataset).verdict == "unknown"


@pytest.mark.parametrize(
    ("seed", "effect", "size"), [(516946873, "ambient_light", 3.0), (1627773399, "warm_up", 10.0)]
)
def test_an_effect_of_an_unlike_form_is_named_where_nothing_else_explains_it(
    seed: int, effect: str, size: float, tmp_path: Path
) -> None:
    """Light that saturates, a warm-up of three modes: the catalogue's form leaves a rest."""
    draw_case(seed, runs=6, effect=effect, size=size).write(tmp_path)
    config = load_config(tmp_path)
    dataset = load_dataset(config)
    found = diagnose.diagnose_config(config, dataset)
    assert (found.verdict, found.effect) == ("missing", effect)
    assert found.floor_ratio_after > 1.5  # and something else is told
    assert found.something_else > 0.5
