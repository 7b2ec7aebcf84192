"""The main job on real measurements, which lie beside the repository and not in it."""

import json
import shutil
from pathlib import Path

import pytest
from tests.main_job.conftest import invoke

ROOT = Path(__file__).parents[2]
DATA = ROOT.parent / "shared" / "data"


def run_example(name: str, log: str, tmp_path: Path) -> dict[str, dict[str, dict[str, float]]]:
    """Run `firmware` on a copy of an example that reads its log where it lies."""
    if not (DATA / log).exists():
        pytest.skip(f"the measurements {log} are not in ../shared/data")
    directory = tmp_path / "examples" / name
    directory.mkdir(parents=True)
    text = (ROOT / "examples" / name / "zerodrift.toml").read_text()
    (directory / "zerodrift.toml").write_text(text.replace("../../../shared/data", str(DATA)))
    result = invoke("firmware", "-C", str(directory), "--json")
    assert result.exit_code == 0, result.output
    body: dict[str, dict[str, dict[str, float]]] = json.loads(result.stdout)
    shutil.rmtree(directory)
    return body


def test_real_resistor_is_bit_exact_and_within_its_mark(tmp_path: Path) -> None:
    body = run_example("real_resistor", "resistor_genrad2k_oven_ramps.csv", tmp_path)
    assert body["bit_exact"] is True
    assert body["held_out"] is True
    assert body["rmse"]["integer"]["R"] <= 2.5  # ppm


@pytest.mark.long
def test_real_loadcell_is_bit_exact_and_within_its_mark(tmp_path: Path) -> None:
    body = run_example("real_loadcell", "loadcell_h40a_22kg.csv", tmp_path)
    assert body["bit_exact"] is True
    rmse, bias = body["rmse"]["integer"]["weight"], body["bias"]["weight"]
    assert (rmse**2 - bias**2) ** 0.5 <= 0.0114  # kg, mean bias removed
