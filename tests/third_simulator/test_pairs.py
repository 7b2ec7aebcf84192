"""Two large effects of which each hides the other in runs left out."""

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
