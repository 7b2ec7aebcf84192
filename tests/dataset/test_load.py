"""What becomes of good logs: runs, names, units, parts in time, notes."""

import numpy as np
import polars as pl
import pytest

HEADER = ("time_s", "temperature_degC", "Fz_N", "ref_Fz_N")


def list_names(runs):
    return [run.name for run in runs]


def test_load_passes_a_log_at_the_firmware_period_bit_for_bit(project, rows, column):
    text = rows()
    (run,) = project.load().train
    assert (run.name, run.group, run.part, len(run)) == ("log", "log", 0, 40)
    assert run.temperature_degC.tobytes() == column(text, 1).tobytes()
    assert np.array_equal(run.measured[:, 0], column(text, 2))
    assert np.array_equal(run.reference[:, 0], column(text, 3))
    assert np.array_equal(run.drift[:, 0], column(text, 2) - column(text, 3))
    assert np.array_equal(run.time_s, column(text, 0))
    assert run.source == project.directory / "log.csv"


def test_load_reads_csv_and_parquet_alike(project):
    frame = pl.read_csv(project.directory / "log.csv")
    frame.cast({"temperature_degC": pl.Float64}).write_parquet(project.directory / "log.parquet")
    (csv,) = project.load().train
    (parquet,) = project.load(train_logs=("log.parquet",)).train
    assert np.array_equal(csv.measured, parquet.measured)
    assert np.array_equal(csv.temperature_degC, parquet.temperature_degC)


@pytest.mark.parametrize("separator", [";", "\t"])
def test_load_takes_other_separators_line_ends_and_a_byte_order_mark(project, separator):
    path = project.directory / "log.csv"
    expected = project.load().train[0].measured
    text = path.read_text().replace(",", separator).replace("\n", "\r\n")
    path.write_bytes(b"\xef\xbb\xbf" + text.encode() + b"\r\n\r\n")
    assert np.array_equal(project.load().train[0].measured, expected)


def test_load_takes_blank_lines_for_nothing(project):
    path = project.directory / "log.csv"
    expected = project.load().train[0].measured
    lines = path.read_text().splitlines()
    path.write_text("\n".join([*lines[:9], "", *lines[9:], "", ""]))
    dataset = project.load()
    assert np.array_equal(dataset.train[0].measured, expected)
    assert dataset.notes == ()


def test_load_takes_blank_lines_after_the_header_for_nothing(project):
    path = project.directory / "log.csv"
    expected = project.load().train[0].measured
    lines = path.read_text().splitlines()
    path.write_text("\n".join([lines[0], "", " ", *lines[1:]]) + "\n")
    assert np.array_equal(project.load().train[0].measured, expected)
    path.write_text("\n\n".join([*lines[:5], lines[5].replace(",", ",x", 1), *lines[6:]]) + "\n")
    assert project.refusal().startswith("log.csv:11: column")


def test_load_reads_files_of_a_glob_sorted_by_name(project, rows):
    for name in ("logs/b.csv", "logs/a.csv", "logs/deep/c.csv"):
        project.write_log(rows(), name)
    assert list_names(project.load(train_logs=("logs/*.csv",)).train) == ["a", "b"]
    assert list_names(project.load(train_logs=("logs/**/*.csv",)).train) == ["a", "b", "c"]


def test_load_names_files_of_one_stem_by_their_paths(project, rows):
    project.write_log(rows(), "x/log.csv")
    project.write_log(rows(), "y/log.csv")
    names = list_names(project.load(train_logs=("x/*.csv", "y/*.csv")).train)
    assert names == ["x/log.csv", "y/log.csv"]


@pytest.fixture
def two_units(project, rows):
    """Two runs of unit A, one of unit B, rows of the units taking turns."""
    table = [
        [*row[:2], repr(float(row[2]) + offset), row[3], run, unit]
        for run, unit, offset in (("r1", "A", 0.0), ("r2", "B", 1000.0), ("r3", "A", 2000.0))
        for row in rows()
    ]
    taking_turns = [row for k in range(40) for row in table[k::40]]
    project.write_log(taking_turns, header=(*HEADER, "run", "unit"))
    return project


def test_load_splits_a_file_by_its_run_column(two_units, rows, column):
    runs = two_units.load().train
    assert list_names(runs) == ["r1", "r2", "r3"]
    for run, offset in zip(runs, (0, 1000, 2000), strict=True):
        assert np.array_equal(run.measured[:, 0], column(rows(), 2) + offset)


def test_load_selects_runs_by_name_or_pattern(two_units):
    assert list_names(two_units.load(train_logs=("log.csv#r2",)).train) == ["r2"]
    assert list_names(two_units.load(train_logs=("log.csv#r[13]",)).train) == ["r1", "r3"]
    assert list_names(two_units.load(train_logs=("log.csv#*",)).train) == ["r1", "r2", "r3"]


def test_load_refuses_a_run_that_is_not_there(two_units):
    message = two_units.refusal(train_logs=("log.csv#r4",))
    assert "log.csv has no run 'r4'; did you mean" in message
    assert "It has: r1, r2, r3" in message


def test_load_refuses_a_run_of_a_file_without_a_run_column(project):
    assert "has no column 'run'" in project.refusal(train_logs=("log.csv#r1",))
    assert list_names(project.load(train_logs=("log.csv#*",)).train) == ["log"]


def test_load_filters_rows_by_where(two_units):
    assert list_names(two_units.load(where={"unit": "A"}).train) == ["r1", "r3"]
    message = two_units.refusal(where={"unit": "C"})
    assert "log.csv: no row has unit = 'C'; there unit is one of A, B" in message
    assert "did you mean 'unit'" in two_units.refusal(where={"unti": "A"})


def test_load_names_the_line_behind_a_filter_and_a_run(two_units):
    path = two_units.directory / "log.csv"
    lines = path.read_text().splitlines()
    number = next(n for n, line in enumerate(lines) if line.endswith("r3,A") and ",25.0," in line)
    fields = lines[number].split(",")
    lines[number] = ",".join([*fields[:2], "bad", *fields[3:]])
    path.write_text("\n".join(lines))
    for changes in ({}, {"where": {"unit": "A"}}, {"train_logs": ("log.csv#r3",)}):
        assert f"log.csv:{number + 1}: column 'Fz_N' holds 'bad'" in two_units.refusal(**changes)
    assert list_names(two_units.load(train_logs=("log.csv#r1",)).train) == ["r1"]


def test_load_names_equal_runs_of_two_files_by_file(two_units):
    text = (two_units.directory / "log.csv").read_text()
    (two_units.directory / "late.csv").write_text(text)
    runs = two_units.load(train_logs=("log.csv#r1", "late.csv#r[12]")).train
    assert list_names(runs) == ["late:r1", "r2", "log:r1"]


def test_load_cuts_a_run_by_share_and_by_seconds(project, rows):
    project.write_log(rows(100, start_s=500.0))
    dataset = project.load(train_logs=("log.csv@0%:60%",), test_logs=("log.csv@60%:100%",))
    assert list_names(dataset.train + dataset.test) == ["log@0%:60%", "log@60%:100%"]
    # 99 s of duration: row 59 is the last one before 59.4 s.
    assert [len(run) for run in dataset.train + dataset.test] == [60, 40]
    joined = np.concatenate([run.time_s for run in dataset.train + dataset.test])
    assert np.array_equal(joined, 500 + np.arange(100.0))
    (run,) = project.load(train_logs=("log.csv@10:30",)).train
    assert np.array_equal(run.time_s, 510 + np.arange(20.0))
    assert len(project.load(train_logs=("log.csv@85:",)).train[0]) == 15
    assert len(project.load(train_logs=("log.csv@:25",)).train[0]) == 25


def test_load_cuts_a_selected_run(two_units):
    (run,) = two_units.load(train_logs=("log.csv#r2@50%:100%",)).train
    assert (run.name, len(run)) == ("r2@50%:100%", 20)


@pytest.mark.parametrize("cut", ["60%", "60%:40%", "a:b", "0%:120%", "-5:10"])
def test_load_refuses_a_cut_it_cannot_read(project, cut):
    message = project.refusal(train_logs=(f"log.csv@{cut}",))
    assert f"'log.csv@{cut}'" in message
    assert "expected" in message


def test_load_takes_a_name_with_signs_literally(project, rows):
    project.write_log(rows(), "odd#1@2:3[x].csv")
    assert list_names(project.load(train_logs=("odd#1@2:3[x].csv",)).train) == ["odd#1@2:3[x]"]


@pytest.mark.parametrize(
    ("train", "test"),
    [
        (("log.csv",), ("log.csv",)),
        (("log.csv", "*.csv"), ()),
        (("log.csv", "log.csv"), ()),
        (("log.csv@0%:60%",), ("log.csv@50%:100%",)),
    ],
)
def test_load_refuses_rows_that_are_selected_twice(project, train, test):
    message = project.refusal(train_logs=train, test_logs=test)
    assert "selects rows of log.csv" in message
    assert "expected every row once" in message


def test_load_lets_dwell_share_rows_with_train(project):
    assert list_names(project.load(dwell_logs=("log.csv",)).dwell) == ["log"]


def test_load_splits_at_a_gap_and_drops_what_is_too_short(project, rows):
    gappy = rows(30) + rows(5, start_s=100.0) + rows(20, start_s=200.0)
    project.write_log(gappy)
    dataset = project.load()
    assert [(run.name, run.group, run.part, len(run)) for run in dataset.train] == [
        ("log", "log", 0, 30),
        ("log#2", "log", 1, 20),
    ]
    first, second = dataset.train
    assert (first.before, second.before) == (None, first)
    notes = "\n".join(dataset.notes)
    assert "log.csv: interrupted 2 times (longest 96 s, after 104 s)" in notes
    assert "log.csv: left out 1 of 3 stretches, of fewer than 10 steps each" in notes


def test_load_skips_invalid_rows_on_request_and_says_how_many(project, rows):
    spoilt = rows(60)
    spoilt[20][2] = "oops"
    spoilt[30][1] = "-256"
    spoilt[40][0] = "3.0"
    project.write_log(spoilt)
    dataset = project.load(skip_invalid=True)
    assert "log.csv: dropped 2 of 60 rows that hold invalid values" in dataset.notes
    assert "log.csv: dropped 1 of 58 rows whose time does not rise" in dataset.notes
    (run,) = dataset.train
    clean = np.array([float(row[2]) for row in rows(60)])
    # The dropped rows lie on straight lines, which interpolation restores.
    np.testing.assert_allclose(run.measured[:, 0], clean, atol=1e-9)


def test_load_does_not_skip_a_log_without_a_valid_row(project, rows):
    spoilt = rows()
    for row in spoilt:
        row[2] = "x"
    project.write_log(spoilt)
    assert "log.csv:2: column 'Fz_N' holds 'x'" in project.refusal(skip_invalid=True)


def test_load_averages_a_finer_log_over_the_period_that_ends_at_the_step(project, rows, column):
    fine = rows(400, 0.1)
    project.write_log(fine)
    (run,) = project.load().train
    np.testing.assert_allclose(run.time_s, np.arange(1.0, 41.0), atol=1e-9)
    expected = column(fine, 2).reshape(40, 10).mean(axis=1)
    np.testing.assert_allclose(run.measured[:, 0], expected, atol=1e-9)


def test_load_reads_inputs_and_constant_references(project, rows):
    project.write_log(
        [[*row, repr(5 + 0.01 * k)] for k, row in enumerate(rows())], header=(*HEADER, "supply_V")
    )
    output = project.config().outputs[0]
    fixed = type(output)("Fz", "Fz_N", 2.5, "N", 100.0)
    (run,) = project.load(outputs=(fixed,), inputs={"supply": "supply_V", "clock": "time_s"}).train
    assert np.all(run.reference == 2.5)
    np.testing.assert_allclose(run.inputs["supply"], 5 + 0.01 * np.arange(40), atol=1e-12)
    assert np.array_equal(run.inputs["clock"], np.arange(40.0))


def test_load_notes_what_is_worth_a_look(project, rows):
    flat = rows()
    for k, row in enumerate(flat):
        row[1], row[2] = repr(25 + 0.01 * k), "12.5"
    project.write_log(flat)
    output = project.config().outputs[0]
    notes = "\n".join(project.load(outputs=(type(output)("Fz", "Fz_N", 0.0, "Nm", 1.0),)).notes)
    assert "span only 0.39 K" in notes
    assert "'Fz_N' of output Fz is 12.5 Nm in every row" in notes
    assert "'Fz_N' ends in N, but [outputs.Fz] unit is Nm" in notes


def test_load_notes_a_log_that_is_a_little_coarser(project, rows):
    project.write_log(rows(40, 1.25))
    dataset = project.load()
    assert dataset.notes == ("log.csv: a row every 1.25 s is interpolated to steps of 1 s",)
    np.testing.assert_allclose(dataset.train[0].temperature_degC, 20 + 0.2 * np.arange(49.0))


def test_real_load_cell_splits_in_time(project, real_log):
    path = real_log("loadcell_h40a_22kg.csv")
    cell = project.config().outputs[0]
    cell = type(cell)("weight", "weight_kg", "static_load_nominal_kg", "kg", 150.0)
    dataset = project.load(
        outputs=(cell,),
        sample_period_s=256.0,
        train_logs=(f"{path}@0%:60%",),
        test_logs=(f"{path}@60%:100%",),
    )
    steps = [sum(len(run) for run in use) for use in (dataset.train, dataset.test)]
    assert abs(steps[0] / sum(steps) - 0.6) < 0.01
    raw = pl.read_csv(path)
    assert dataset.train[0].measured[0, 0] == raw["weight_kg"][0]
    assert all(np.all(run.reference == 22) for run in dataset.train + dataset.test)


def test_real_genrad_log_selects_one_unit(project, real_log):
    path = real_log("resistor_genrad2k_oven_ramps.csv")
    output = project.config().outputs[0]
    dataset = project.load(
        outputs=(type(output)("R", "drift_ppm", 0.0, "ppm", 1000.0),),
        temperature_column="oven_temperature_degC",
        sample_period_s=5.0,
        where={"unit": "2k_card1_R1"},
        train_logs=(str(path),),
    )
    assert list_names(dataset.train) == ["run1", "run2"]
    rows_of_unit = pl.read_csv(path).filter(pl.col("unit") == "2k_card1_R1").height
    assert abs(sum(len(run) for run in dataset.train) - rows_of_unit) <= 2


def test_real_vhd200_log_averages_ten_second_means_to_minutes(project, real_log):
    path = real_log("resistor_vhd200_oven_ramps.csv")
    output = project.config().outputs[0]
    dataset = project.load(
        outputs=(type(output)("R", "drift_ppm", 0.0, "ppm", 1000.0),),
        temperature_column="oven_temperature_degC",
        sample_period_s=60.0,
        train_logs=(str(path),),
    )
    assert len(dataset.train) == 9
    raw = pl.read_csv(path)
    for run in dataset.train:
        whole = raw.filter(pl.col("run") == run.group)["oven_temperature_degC"]
        assert len(run) == pytest.approx(whole.len() / 6, abs=2)
        # A wrong weighting would shift the mean over the ramps.
        assert float(run.temperature_degC.mean()) == pytest.approx(float(whole.mean()), abs=0.02)


def test_load_skips_every_row_until_the_time_moves_on(project, rows):
    back = rows(60)
    back[30][0], back[31][0] = "3.25", "4.5"
    project.write_log(back)
    assert "the 2 rows that do not move on" in project.refusal()
    dataset = project.load(skip_invalid=True)
    assert "log.csv: dropped 2 of 60 rows whose time does not rise" in dataset.notes
    assert len(dataset.train[0]) == 60


def test_load_takes_blank_lines_for_nothing_in_a_selected_run(two_units):
    path = two_units.directory / "log.csv"
    lines = path.read_text().splitlines()
    path.write_text("\n".join([*lines[:20], "", *lines[20:]]))
    everything = two_units.load()
    assert list_names(everything.train) == ["r1", "r2", "r3"]
    (run,) = two_units.load(train_logs=("log.csv#r2",)).train
    assert np.array_equal(run.measured, everything.train[1].measured)
    assert len(run) == 40
    spoilt = path.read_text().replace(",25.0,1063.0,", ",25.0,bad,")
    path.write_text(spoilt)
    number = 1 + next(n for n, line in enumerate(spoilt.splitlines()) if ",bad," in line)
    dataset = two_units.load(train_logs=("log.csv#r2",), skip_invalid=True)
    assert dataset.notes == ("log.csv: dropped 1 of 40 rows that hold invalid values",)
    assert f"log.csv:{number}: " in two_units.refusal(train_logs=("log.csv#r2",))
