"""A drift outside the catalogue: proposed, written, added, and generated as C, bit for bit."""

import json

import numpy as np
import pytest
from benchmarks.formula_cases import TOML, simulate

from zerodrift.diagnosis.formula.proposal import propose_formula, render_file
from zerodrift.physics.catalogue import load_catalogue


def write_project(directory, kind, runs=6, seed=7):
    """Write a simulated project's logs and zerodrift.toml."""
    simulated = simulate(kind, 5.0, runs, seed)
    data = simulated.dataset
    for run in (*data.train, *data.test, *data.dwell):
        names = ["time_s", "temperature_degC", "Fz_N", "Mx_Nm", "ref_Fz_N", *run.inputs]
        columns = [run.time_s, run.temperature_degC, *run.measured.T, run.reference[:, 0]]
        path = directory / "logs" / f"{run.name}.csv"
        path.parent.mkdir(exist_ok=True)
        np.savetxt(
            path,
            np.stack([*columns, *run.inputs.values()], axis=1),
            delimiter=",",
            fmt="%.6f",
            header=",".join(names),
            comments="",
        )
    (directory / "zerodrift.toml").write_text(TOML, encoding="utf-8")


@pytest.mark.slow
def test_a_formula_is_proposed_written_added_and_becomes_checked_c(tmp_path, zerodrift):
    write_project(tmp_path, "|T - LP(T)|")
    file = tmp_path / "my_effect.py"
    told = json.loads(zerodrift("propose", "-C", tmp_path, "--write", file, "--json").out)
    assert told["found"] and told["written"] == str(file)
    assert told["formula"].startswith("k * |T - LP(T, ")
    assert told["instructions"]["cortex-m4"] > 0 and told["flash_bytes"]["cortex-m4"] > 0
    assert all(told["rounding"][k] < 0.1 * told["rmse_left_out"][k]["after"] for k in ("Fz", "Mx"))
    for box in told["black_boxes"]:
        assert not box["learns_more"] and 1.0 < box["floor_ratio_beside"] < box["floor_ratio"]
    assert [box["name"] for box in told["black_boxes"]] == ["lag bank", "GRU"]
    for curve in told["curves"].values():
        x, y = np.array(curve["formula"]), np.array(curve["remainder"])
        assert np.corrcoef(x, y)[0, 1] > 0.98 and abs(np.polyfit(x, y, 1)[0] - 1.0) < 0.05
    assert zerodrift("report", "-C", tmp_path, "--no-diagnose").code == 0
    assert told["formula"] in (tmp_path / "report.html").read_text()
    added = json.loads(zerodrift("add", file, "-C", tmp_path, "--json").out)
    assert added["added"] and added["effect"] == told["kind"]
    assert 'files = ["my_effect.py"]' in (tmp_path / "zerodrift.toml").read_text()
    value, std = (added["parameters"]["tau_s"][key] for key in ("value", "std_error"))
    assert abs(value - told["parameters"]["tau_s"]["value"]) < 3.0 * std
    built = json.loads(zerodrift("firmware", "-C", tmp_path, "--json").out)
    assert built["bit_exact"] and built["written"]


@pytest.mark.slow
def test_a_second_term_is_found_and_the_first_one_anew(tmp_path):
    simulated = simulate("play(humidity) + max(supply, c)", 5.0, 6, 77)
    found = propose_formula(simulated.config, simulated.dataset, load_catalogue())
    assert found.formula is not None
    assert {one.write() for one in found.formula.expressions} == {
        "max(supply, threshold_1)",
        "play(humidity, half_width_2)",
    }
    (tmp_path / "two.py").write_text(render_file(found.formula), encoding="utf-8")
    effect = load_catalogue([tmp_path / "two.py"])[found.formula.effect.kind]
    assert [p.name for p in effect.parameters] == ["threshold_1", "half_width_2"]


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["complete", "random walk"])
def test_where_there_is_no_formula_none_is_proposed(tmp_path, zerodrift, kind):
    write_project(tmp_path, kind)
    file = tmp_path / "my_effect.py"
    told = json.loads(zerodrift("propose", "-C", tmp_path, "--write", file, "--json").out)
    assert not told["found"] and told["written"] is None and not file.exists()
    assert "NO FORMULA" in zerodrift("propose", "-C", tmp_path, "--no-black-box").out
