"""Effects that hide each other in runs left out, and effects in a form unlike the catalogue's."""

from pathlib import Path

import pytest
from benchmarks.third_simulator import draw_case

from zerodrift.base.config import load_config
from zerodrift.dataset.load import load_dataset
from zerodrift.diagnosis import diagnose

pytestmark = pytest.mark.long


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
    ("seed", "effect", "size"), [(516946873, "ambient_light", 30.0), (1627773399, "warm_up", 10.0)]
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


def test_an_effect_beside_one_that_no_catalogue_has_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Crosstalk in all runs, and a motor nearby that is not logged, each three times the noise."""
    draw_case(995969873, runs=6, effect=("crosstalk", "unlogged_input"), size=3.0).write(tmp_path)
    config = load_config(tmp_path)
    dataset = load_dataset(config)
    found = diagnose.diagnose_config(config, dataset)
    assert (found.verdict, found.effect) == ("missing", "crosstalk")
    assert found.something_else > 0.5
    assert found.floor_ratio_after > 1.5
    monkeypatch.setattr(diagnose, "is_there", lambda finding: False)
    assert diagnose.diagnose_config(config, dataset).verdict == "unknown"


def test_what_sticks_and_slips_at_random_is_not_named_a_hysteresis(tmp_path: Path) -> None:
    draw_case(1509031335, runs=4, effect="sticky_valve", size=3.0).write(tmp_path)
    config = load_config(tmp_path)
    dataset = load_dataset(config)
    found = diagnose.diagnose_config(config, dataset)
    assert (found.verdict, found.nearest) == ("unknown", "load_hysteresis")
