"""What can be read but is odd is told, with run, place and what to do; what is in order is not."""

import numpy as np
import pytest

COUNT = 200


def write_runs(project, runs: int, change=None) -> None:
    """Write runs with a load that swings and noise; `change(run, rows)` may spoil numbers."""
    for run in range(runs):
        rng = np.random.default_rng(run)
        time_s = np.arange(COUNT, dtype=float)
        load = 100 * np.sin(time_s / 9 + run)
        temperature = 20 + 15 * np.sin(time_s / 40)
        reading = load + 0.2 * (temperature - 20) + rng.normal(0, 0.1, COUNT)
        table = np.stack([time_s, temperature, reading, load], axis=1)
        if change is not None:
            change(run, table)
        rows = [[repr(float(value)) for value in row] for row in table]
        project.write_log(rows, f"run_{run}.csv")
    text = (project.directory / "zerodrift.toml").read_text()
    project.write_toml(text.replace('"log.csv"', '"run_*.csv"'))


def test_load_notes_nothing_on_logs_in_order(project):
    write_runs(project, 3)
    assert project.load().notes == ()


def test_load_notes_one_run_in_kelvin(project):
    def change(run, table):
        if run == 1:
            table[:, 1] += 273.15

    write_runs(project, 3, change)
    (note,) = project.load().notes
    assert note.startswith("run run_1: 'temperature_degC' is 150 K and more above all other runs")


def test_load_leaves_a_hot_range_alone(project):
    def change(run, table):
        table[:, 1] += 60 * run

    write_runs(project, 4, change)
    assert project.load().notes == ()


@pytest.mark.parametrize(
    ("factor", "hint"),
    [
        (1000.0, "is 1000 times 'ref_Fz_N': one in thousandths"),
        (0.001, "is 0.001 times 'ref_Fz_N': one in thousandths"),
        (-1.0, "is -1 times 'ref_Fz_N': the sign of one reversed"),
        (9.80665, "is 9.80665 times 'ref_Fz_N': one in newtons"),
    ],
)
def test_load_notes_a_reading_in_another_unit_than_its_reference(project, factor, hint):
    def change(run, table):
        table[:, 2] *= factor

    write_runs(project, 2, change)
    (note,) = project.load().notes
    assert note.startswith("in every run 'Fz_N' ")
    assert hint in note


def test_load_notes_the_one_run_in_another_unit(project):
    def change(run, table):
        if run == 2:
            table[:, 3] *= 1000

    write_runs(project, 3, change)
    assert any(note.startswith("in run run_2 'Fz_N' is 0.001") for note in project.load().notes)


@pytest.mark.parametrize(
    ("column", "value", "told"),
    [
        (1, 85.0, "'temperature_degC' (temperature) jumps to 85 degC and back in one row at 70 s"),
        (2, 4000.0, "'Fz_N' (output Fz) jumps and back in one row at 70 s of run_0.csv"),
    ],
)
def test_load_notes_a_single_row_that_jumps_and_comes_back(project, column, value, told):
    def change(run, table):
        if run == 0:
            table[70, column] = value

    write_runs(project, 2, change)
    (note,) = project.load().notes
    assert note.startswith(told)


def test_load_takes_a_load_of_one_row_for_a_load(project):
    def change(run, table):
        table[70, 2:] += 5000

    write_runs(project, 2, change)
    assert project.load().notes == ()
