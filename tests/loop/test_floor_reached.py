"""Models that lack nothing are told to be at the noise floor, whatever their effects do to it."""

import json

import numpy as np
import pytest

pytestmark = pytest.mark.long


def rewrite_logs(project, change):
    """Rewrite logs: `change(table, number)` gets a table of named columns and changes it."""
    for number, path in enumerate(sorted((project.directory / "logs").glob("*.csv"))):
        table = np.genfromtxt(path, delimiter=",", names=True)
        change(table, number)
        columns = np.stack([table[name] for name in table.dtype.names], axis=1)
        header = ",".join(table.dtype.names)
        np.savetxt(path, columns, delimiter=",", fmt="%.5f", header=header, comments="")


def told_of(zerodrift, project, *command):
    result = zerodrift(*command, "-C", project.directory, "--json")
    assert result.code == 0, result.err
    return json.loads(result.out)


def add_tables(project, *kinds):
    text = project.toml.read_text()
    tables = "".join(f'[[effect]]\nkind = "{kind}"\n\n' for kind in kinds)
    project.toml.write_text(text.replace("[network]", f"{tables}[network]"))


def test_samples_at_a_rail_count_in_no_error_once_the_model_knows_of_it(project, zerodrift):
    add_tables(project, "thermal_lag")
    clean = told_of(zerodrift, project, "compare")["outputs"]["Fz"]["rmse_heldout"]

    def clip(table, number):
        table["Fz_N"] = np.minimum(table["Fz_N"], 40.0)

    rewrite_logs(project, clip)
    clipped = told_of(zerodrift, project, "compare")
    assert clipped["outputs"]["Fz"]["rmse_heldout"] > 10.0 * clean
    assert clipped["set_aside"] == 0.0
    diagnosis = told_of(zerodrift, project, "diagnose")
    assert (diagnosis["verdict"], diagnosis["effect"]) == ("missing", "adc_saturation")
    added = told_of(zerodrift, project, "add", "adc_saturation")
    assert added["after"]["rmse_heldout"]["Fz"] == pytest.approx(clean, rel=0.05)
    after = told_of(zerodrift, project, "compare")
    assert 0.05 < after["set_aside"] < 0.5
    assert after["outputs"]["Fz"]["rmse_heldout"] < 1.1 * after["outputs"]["Fz"]["noise_floor"]
    assert "stand at a converter's rail" in zerodrift("compare", "-C", project.directory).out


def test_what_an_effect_does_in_the_dwell_is_no_noise(project, zerodrift):
    """A supply that wavers in the dwell as in the runs."""
    text = project.toml.read_text()
    project.toml.write_text(text.replace("[logs]", '[inputs]\nsupply = "ref_Fz_N"\n\n[logs]'))

    def lean_on_supply(table, number):
        # The column of the load serves as that of the supply.
        seconds = np.arange(len(table))
        channel = np.sin(seconds / 40.0 + number)
        table["Mx_Nm"] += 0.05 * channel
        table["Fz_N"] += channel - table["ref_Fz_N"]
        table["ref_Fz_N"] = channel

    rewrite_logs(project, lean_on_supply)
    text = project.toml.read_text()
    project.toml.write_text(text.replace('reference = "ref_Fz_N"\n', ""))
    add_tables(project, "thermal_lag")
    before = told_of(zerodrift, project, "compare")["outputs"]
    assert before["Mx"]["noise_floor"] == pytest.approx(0.004, rel=0.1)
    assert before["Mx"]["rmse_heldout"] > 5.0 * before["Mx"]["noise_floor"]
    add_tables(project, "supply_sensitivity")
    after = told_of(zerodrift, project, "compare")["outputs"]
    assert after["Mx"]["noise_floor"] == before["Mx"]["noise_floor"]
    assert after["Mx"]["rmse_heldout"] < 1.1 * after["Mx"]["noise_floor"]
