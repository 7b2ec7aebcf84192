"""Every way a log can be wrong is refused with place, found, expected and remedy."""

from pathlib import Path

import numpy as np
import polars as pl
import pytest

from zerodrift.base.errors import InputError


def expect(message: str, *parts: str) -> None:
    for part in parts:
        assert part in message, message


def spoil(rows, row: int, column: int, value: str):
    """Return the rows with one field changed; row 0 stands on line 2 of the file."""
    rows[row][column] = value
    return rows


@pytest.mark.parametrize(
    ("value", "found", "expected", "remedy"),
    [
        ("nan", "column 'Fz_N' is nan", "expected a finite number", "--skip-invalid"),
        ("inf", "column 'Fz_N' is inf", "expected a finite number", "--skip-invalid"),
        ("1e308", "column 'Fz_N' is 1e308", "within 1e+30 of 0", "--skip-invalid"),
        ("-inf", "column 'Fz_N' is -inf", "expected a finite number", "--skip-invalid"),
        ("oops", "column 'Fz_N' holds 'oops'", "expected a finite number", "Correct the row"),
        ("NA", "column 'Fz_N' holds 'NA'", "expected a finite number", "Correct the row"),
        ("", "column 'Fz_N' is empty", "expected a number", "Fill it in"),
        ('"1,5"', "column 'Fz_N' holds '1,5'", "Write the decimals with a point", "--skip-invalid"),
    ],
)
def test_load_refuses_a_value_that_is_no_finite_number(
    project, rows, value, found, expected, remedy
):
    project.write_log(spoil(rows(), 15, 2, value))
    expect(project.refusal(), "log.csv:17: ", found, expected, remedy, "this row")


def test_load_counts_the_invalid_rows_and_names_the_first(project, rows):
    bad = spoil(spoil(rows(), 30, 2, "x"), 8, 1, "-256")
    project.write_log(bad)
    expect(project.refusal(), "log.csv:10: temperature_degC is -256 degC", "the 2 such rows")


def test_load_refuses_the_code_before_the_first_conversion(project, rows):
    project.write_log(spoil(rows(), 0, 1, "-256.0"))
    expect(
        project.refusal(),
        "log.csv:2: temperature_degC is -256 degC",
        "before its first conversion",
        "expected a measured temperature",
        "--skip-invalid",
    )


@pytest.mark.parametrize(
    ("convert", "hint"),
    [
        (lambda t: t + 273.15, "look like kelvin: subtract 273.15"),
        (lambda t: t * 9 / 5 + 532, "look like degF"),
        (lambda t: round(t / 0.0078125), "0.0078125 degC per LSB"),
    ],
)
def test_load_hints_at_the_unit_of_an_implausible_temperature(project, rows, convert, hint):
    bad = rows()
    for row in bad:
        row[1] = repr(convert(float(row[1])))
    bad[6][1] = repr(5 * convert(21.0))
    bad[6][1] = bad[6][1] if float(bad[6][1]) > 500 else "777"
    project.write_log(bad)
    message = project.refusal()
    expect(message, " degC; expected -200 to 500 degC", hint, "Correct the unit")


def test_load_notes_a_temperature_that_looks_like_kelvin(project, rows):
    warm = rows()
    for row in warm:
        row[1] = repr(float(row[1]) + 273.15)
    project.write_log(warm)
    notes = "\n".join(project.load().notes)
    expect(notes, "'temperature_degC' is read as degC", "kelvin")


def test_load_refuses_a_temperature_that_never_moves(project, rows):
    still = rows()
    for row in still:
        row[1] = "25.0"
    project.write_log(still)
    expect(
        project.refusal(),
        "zerodrift.toml:14: ",
        "is 25 degC in every row of the train logs",
        "expected it to move",
        "Record a log",
    )


@pytest.mark.parametrize(
    ("time", "found"), [("7.5", "goes back from 19 to 7.5 s"), ("19.0", "repeats 19 s")]
)
def test_load_refuses_a_time_that_does_not_rise(project, rows, time, found):
    project.write_log(spoil(rows(), 20, 0, time))
    expect(
        project.refusal(),
        f"log.csv:22: time_s {found}",
        "expected rising times within a run",
        "--skip-invalid to drop the row that",
    )


def test_load_refuses_two_runs_after_each_other_without_a_run_column(project, rows):
    project.write_log(rows() + rows())
    expect(project.refusal(), "log.csv:42: time_s goes back from 39 to 0 s", "`run` column")


@pytest.mark.parametrize("second", [10.0, 2.0])
def test_load_refuses_a_cadence_slower_than_the_step_at_the_line_where_it_begins(
    project, rows, second
):
    project.write_log(rows(400) + rows(400, second, start_s=399 + second))
    message = project.refusal(sample_period_s=second / 1.6)
    expect(message, f"changes from 1 s to {second:g} s", "expected a row at least every", "Set")
    line = int(message.split("log.csv:")[1].split(":")[0])
    assert abs(line - 402) <= 1


def test_load_refuses_a_log_coarser_than_the_firmware(project, rows):
    project.write_log(rows(40, 2.0))
    expect(
        project.refusal(),
        "log.csv: a row every 2 s",
        "zerodrift.toml:5 sets sample_period_s = 1",
        "expected a row at least every 1.5 s",
        "Set sample_period_s = 2",
    )


def test_load_hints_at_milliseconds(project, rows):
    project.write_log(rows(40, 1000.0))
    expect(project.refusal(), "the times look like ms")


@pytest.mark.parametrize("count", [1, 2, 9])
def test_load_refuses_too_few_rows(project, rows, count):
    project.write_log(rows(count))
    expect(
        project.refusal(),
        f"log.csv: too few rows: {count}",
        "expected at least 10 steps",
        "Record longer",
    )


def test_load_refuses_a_misspelt_column_and_names_the_nearest(project, rows):
    project.write_log(rows(), header=("time_s", "temperature_degC", "FzN", "ref_Fz_N"))
    expect(
        project.refusal(),
        "log.csv:1: there is no column 'Fz_N'; did you mean 'FzN'",
        "Found: time_s, temperature_degC, FzN, ref_Fz_N",
        "expected the name that [outputs.Fz] measured gives",
        "Correct the one or the other",
    )


def test_load_refuses_a_missing_input_column(project):
    expect(
        project.refusal(inputs={"supply": "supply_V"}),
        "no column 'supply_V'",
        "[inputs] supply gives",
    )


def test_load_refuses_a_column_named_twice(project, rows):
    project.write_log(
        [[*row, "0"] for row in rows()],
        header=("time_s", "temperature_degC", "Fz_N", "ref_Fz_N", "Fz_N"),
    )
    expect(project.refusal(), "log.csv:1: the header names column 'Fz_N' 2 times", "Rename one")


def test_load_refuses_an_empty_file(project):
    (project.directory / "log.csv").write_bytes(b"")
    expect(project.refusal(), "log.csv: the file is empty", "expected a header", "Copy it again")


def test_load_refuses_a_header_without_rows(project):
    project.write_log([])
    expect(project.refusal(), "log.csv: there is a header but no row", "expected one row per")


def test_load_refuses_a_row_with_too_many_fields(project, rows):
    many = rows()
    many[5].append("99")
    project.write_log(many)
    expect(project.refusal(), "log.csv:7: the row has 5 fields", "expected 4", "Correct the row")


@pytest.mark.parametrize("damage", ["cut", "garbage", "text", "flipped"])
def test_load_refuses_a_damaged_parquet_file(project, damage):
    path = project.directory / "log.parquet"
    whole = pl.read_csv(project.directory / "log.csv")
    pl.concat([whole] * 50).write_parquet(path)
    data = path.read_bytes()
    path.write_bytes(
        {
            "cut": data[: len(data) // 2],
            "garbage": bytes(range(256)) * 8,
            "text": (project.directory / "log.csv").read_bytes(),
            "flipped": data[:20] + b"\xff" * 60 + data[80:],
        }[damage]
    )
    expect(
        project.refusal(train_logs=("log.parquet",)),
        "log.parquet: not a whole Parquet file",
        "expected one that ends in its footer",
        "Copy it again",
    )


def test_load_refuses_text_in_a_parquet_column(project):
    frame = pl.read_csv(project.directory / "log.csv").cast({"Fz_N": pl.String})
    frame.write_parquet(project.directory / "log.parquet")
    expect(
        project.refusal(train_logs=("log.parquet",)),
        "log.parquet: column 'Fz_N' holds String; expected numbers",
    )


def test_load_names_the_row_of_a_parquet_file(project):
    frame = pl.read_csv(project.directory / "log.csv")
    values = np.array(frame["Fz_N"])
    values[15] = np.nan
    frame.with_columns(Fz_N=values).write_parquet(project.directory / "log.parquet")
    expect(project.refusal(train_logs=("log.parquet",)), "log.parquet: row 16: column 'Fz_N' is")


def test_load_refuses_parquet_that_is_called_csv(project):
    path = project.directory / "log.csv"
    pl.read_csv(path).write_parquet(path)
    expect(project.refusal(), "log.csv: holds Parquet; expected CSV", "log.parquet")


def test_load_refuses_a_file_it_may_not_read(project, monkeypatch):
    def refuse(self, *args, **kwargs):
        if self.name == "log.csv":
            raise PermissionError(13, "Permission denied")
        return original(self, *args, **kwargs)

    # A change of mode would not hold for root.
    original = Path.open
    monkeypatch.setattr(Path, "open", refuse)
    with pytest.raises(InputError, match=r"log\.csv: cannot be read \(Permission") as caught:
        project.load()
    expect(str(caught.value), "expected a file that this user may read", "Check its permissions")


def test_load_refuses_a_glob_that_matches_nothing_and_names_the_nearest(project):
    expect(
        project.refusal(train_logs=("lg.csv",)),
        "zerodrift.toml:14: [logs] train: no file matches 'lg.csv'",
        "did you mean 'log.csv'",
        "Expected at least one log",
        "correct the glob",
    )


def test_load_refuses_a_directory_without_logs(project):
    (project.directory / "empty").mkdir()
    expect(
        project.refusal(train_logs=("empty/*.csv",)),
        "no file matches 'empty/*.csv'",
        "holds no CSV or Parquet file",
    )
    expect(project.refusal(train_logs=("absent/*.csv",)), "there is no directory")


def test_load_refuses_a_file_of_another_kind(project):
    expect(project.refusal(train_logs=("*",)), "'*' selects zerodrift.toml", ".csv", "Narrow")


def test_load_refuses_an_empty_run_name(project, rows):
    named = [[*row, "a"] for row in rows(20)] + [[*row, ""] for row in rows(20)]
    project.write_log(named, header=("time_s", "temperature_degC", "Fz_N", "ref_Fz_N", "run"))
    expect(project.refusal(), "log.csv:22: column 'run' is empty", "Fill it in")


def test_load_counts_lines_past_line_breaks_in_quotes(project, rows):
    noted = [[*row, '"two\nlines"'] for row in rows()]
    noted[15][2] = "x"
    project.write_log(noted, header=("time_s", "temperature_degC", "Fz_N", "ref_Fz_N", "comment"))
    # 15 rows of two lines each stand before it, and it ends on its own second line.
    expect(project.refusal(), "log.csv:33: column 'Fz_N' holds 'x'")
