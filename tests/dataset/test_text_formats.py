"""Every way in which loggers write text gives the same columns, and what is odd is told."""

import numpy as np
import pytest

from zerodrift.dataset.tables import open_source, read_table

ROWS = 40
T = 20 + 0.25 * np.arange(ROWS)
F = 3.5 * np.arange(ROWS) - 7
R = 0.5 * np.arange(ROWS)
NAMES = ["time_s", "temperature_degC", "Fz_N", "ref_Fz_N"]


def write(rows=None, header=NAMES, separator=",", end="\n", comma=False, pad="") -> str:
    lines = [] if header is None else [separator.join(header)]
    for k in range(ROWS):
        fields = [repr(float(value)) for value in (k, T[k], F[k], R[k])]
        if comma:
            fields = [field.replace(".", ",") for field in fields]
        lines.append((separator + pad).join(fields))
    return end.join(lines) + end


def check(project, data: str | bytes, **changes):
    path = project.directory / "log.csv"
    path.write_bytes(data.encode() if isinstance(data, str) else data)
    dataset = project.load(**changes)
    (run,) = dataset.train
    np.testing.assert_array_equal(run.time_s - run.time_s[0], np.arange(ROWS))
    np.testing.assert_array_equal(run.temperature_degC, T)
    np.testing.assert_array_equal(run.measured[:, 0], F)
    np.testing.assert_array_equal(run.reference[:, 0], R)
    return "\n".join(dataset.notes)


@pytest.mark.parametrize(
    "text",
    [
        write(separator=";"),
        write(separator="\t"),
        write(separator="|"),
        write(separator=" "),
        write(separator="    "),
        write(separator=";", comma=True),
        write(separator="\t", comma=True),
        write(separator=" ", comma=True),
        write(pad=" "),
        write(separator=" ; ", comma=True),
        write(end="\r\n"),
        write(end="\r"),
        write(separator=";", end="\r\n", comma=True),
        "\ufeff" + write(),
        "\ufeff" + write(separator=";", comma=True, end="\r\n"),
        "\n\n" + write(),
        "# a logger\n# of some make\n" + write(),
        "% made by hand\n" + write(separator="\t"),
        "// one\n//two\n" + write(),
        "# " + write(separator=" "),
        "# comment\n# " + write(),
        "Logger;X100\nSerial;0815\n\n" + write(separator=";", comma=True),
        "A logger's export\nof 2024\n" + write(),
        write().replace("\n", "\ns,degC,N,N\n", 1),
        write(separator=";").replace("\n", "\n[s];[°C];[N];[N]\n", 1),
        write().replace("\n", ",\n"),
        write().replace("\n", ",\n").replace(",\n", "\n", 1),
        write().replace("20.25", '"20.25"').replace("-3.5", '"-3.5"'),
        write().replace("-7.0", "# restarted\n-7.0", 0),
    ],
)
def test_text_of_any_form_gives_the_same_columns(project, text):
    check(project, text)


def test_comments_amid_the_rows_are_no_rows(project):
    lines = write().splitlines()
    lines.insert(20, "# lid opened")
    check(project, "# logger\n" + "\n".join(lines) + "\n")


@pytest.mark.parametrize("encoding", ["utf-16", "utf-16-le", "utf-16-be", "cp1252", "utf-8-sig"])
@pytest.mark.parametrize("separator", [";", "\t"])
def test_encodings_are_told(project, encoding, separator):
    names = ["time_s", "temperature_degC", "Fz_N", "ref_Fz_N", "Gehäuse °C"]
    text = write(header=names, separator=separator, comma=True).replace("\r\n", "\n")
    text = text.replace("\n", f"{separator}1,5\n").replace(f"C{separator}1,5\n", "C\n", 1)
    notes = check(project, text.encode(encoding))
    assert ("Windows-1252" in notes) == (encoding == "cp1252")
    source = open_source(project.directory / "log.csv", "log.csv", {})
    assert source.names[4] == "Gehäuse °C"


def test_bytes_that_are_not_utf8_far_into_a_file_are_read_as_latin_1(project):
    text = write(header=[*NAMES, "remark"]).replace("\n", ",ok\n").replace("remark,ok", "remark")
    lines = text.encode().splitlines()
    padding = b"\n".join(b"# " + b"x" * 1000 for _ in range(300))
    lines[30] = lines[30].replace(b"ok", b"25 \xb0C")
    notes = check(project, b"\n".join([*lines[:9], padding, *lines[9:]]) + b"\n")
    assert "line 331 is not UTF-8; read as Windows-1252" in notes


def test_rows_that_end_in_a_delimiter_are_told(project):
    lines = write().splitlines()
    lines[7] += ","
    lines[20] += ",,"
    notes = check(project, "\n".join(lines) + "\n")
    assert "2 rows end in a delimiter after which nothing follows" in notes


def test_short_rows_are_refused_with_their_line_and_can_be_left_out(project):
    lines = write().splitlines()
    lines[7] = lines[7].rsplit(",", 2)[0]
    (project.directory / "log.csv").write_text("\n".join(lines) + "\n")
    assert "log.csv:8: column 'Fz_N' is empty" in project.refusal()
    assert len(project.load(skip_invalid=True).train[0]) == ROWS


def test_line_numbers_hold_below_comments_and_in_other_encodings(project):
    lines = ["# one", "# two", *write(separator=";", comma=True).splitlines()]
    lines[30] = lines[30].replace(";", ";x", 1)
    (project.directory / "log.csv").write_bytes("\n".join(lines).encode("utf-16"))
    assert "log.csv:31: column 'temperature_degC' holds 'x" in project.refusal()


def test_columns_without_a_header_are_numbers(project):
    toml = project.directory / "zerodrift.toml"
    text = toml.read_text()
    for number, name in enumerate(NAMES, start=1):
        text = text.replace(f'"{name}"', f'"{number}"')
    toml.write_text(text)
    notes = check(project, write(header=None))
    assert "has no header; its columns are numbered, '1' to '4'" in notes


def test_rows_without_times_are_a_period_apart(project):
    toml = project.directory / "zerodrift.toml"
    text = toml.read_text().replace('time = "time_s"\n', "")
    toml.write_text(text.replace("[logs]\n", "[logs]\nperiod_s = 1.0\n"))
    lines = [line.split(",", 1)[1] for line in write().splitlines()]
    check(project, "\n".join(lines) + "\n")


def test_row_of_units_is_kept(project):
    path = project.directory / "log.csv"
    path.write_text(write(header=["t", "T", "F", "R"]).replace("\n", "\ns,°C,(N),[N]\n", 1))
    source = open_source(path, "log.csv", {})
    assert source.units == {"t": "s", "T": "°C", "F": "N", "R": "N"}
    assert len(read_table(source, {"T": "here"})) == ROWS


@pytest.mark.parametrize("quote", ['"', ""])
def test_quoted_decimal_commas_between_commas_are_read(project, quote):
    lines = [",".join(NAMES)]
    for k in range(ROWS):
        fields = (repr(float(v)).replace(".", ",") for v in (k, T[k], F[k], R[k]))
        lines.append(",".join(f'"{field}"' for field in fields))
    check(project, "\n".join(lines) + "\n")
