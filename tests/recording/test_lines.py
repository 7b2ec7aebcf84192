"""Lines of a source: what is a row, what is none, and why."""

import math

import pytest

from zerodrift.base.errors import InputError
from zerodrift.recording.sources import LineError, LineReader


def read_all(text: str, *columns: str) -> list[dict[str, float]]:
    reader = LineReader(columns)
    return [row for line in text.splitlines() if (row := reader.read(line)) is not None]


@pytest.mark.parametrize(
    "text",
    [
        "a,b\n1,2.5\n3,4",
        "a;b\n1;2,5\n3;4",
        "a\tb\n1\t2.5\n3\t4",
        "  a   b\n 1  2.5\n3 4 ",
        "# hello\n\na,b,\n1,2.5,\n3,4,",
        '"a","b"\n1,2.5\na,b\n3,4',
        '{"a": 1, "b": 2.5}\n{"a": 3, "b": 4}',
        "a=1 b=2.5\na = 3, b = 4",
        "a: 1; b: 2.5\na: 3; b: 4",
        "\ufeffa,b\n1,2.5\n3,4",
    ],
)
def test_forms_of_lines(text: str) -> None:
    assert read_all(text) == [{"a": 1.0, "b": 2.5}, {"a": 3.0, "b": 4.0}]


def test_numbers_alone_need_names() -> None:
    assert read_all("1,2\n3,4", "x", "y") == [{"x": 1.0, "y": 2.0}, {"x": 3.0, "y": 4.0}]
    with pytest.raises(LineError, match="'1,2' came before any names; expected a header line"):
        read_all("1,2")


def test_inner_objects_are_named_by_their_way() -> None:
    (row,) = read_all('{"t": {"chamber": 20.5, "ok": true}, "f": [1, 2], "unit": "N"}')
    assert row == {"t.chamber": 20.5, "t.ok": 1.0, "f[0]": 1.0, "f[1]": 2.0}


def test_no_reading_is_no_number() -> None:
    (row,) = read_all("a,b,c\n1,,nan")
    assert row["a"] == 1.0 and math.isnan(row["b"]) and math.isnan(row["c"])


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("a,b\n1", "'1' has 1 values; expected 2"),
        ("a,b\n1,x", "'x' is no number"),
        ("{broken", "is no JSON object"),
        ("a,a\n1,2", "'a' appears twice"),
    ],
)
def test_what_is_no_row_says_why(text: str, told: str) -> None:
    with pytest.raises(LineError, match=told):
        read_all(text)


def test_names_on_the_command_line_are_checked() -> None:
    with pytest.raises(InputError, match="one has no name"):
        LineReader(("a", ""))
