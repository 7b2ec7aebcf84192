"""What `apply` leaves where the disk gives out, or where it was killed."""

from types import SimpleNamespace

import polars as pl
import pytest
from polars.exceptions import ComputeError

from zerodrift.base.errors import InputError
from zerodrift.dataset.text_format import TextFormat
from zerodrift.tasks import apply
from zerodrift.tasks.built import read_kept


def make_rows(text=None, **columns):
    frame = pl.DataFrame(columns or {"a": [1.0]})
    source = SimpleNamespace(text=text)
    return SimpleNamespace(
        stream=lambda *, as_text: iter([frame]), steps=SimpleNamespace(source=source)
    )


ROWS = make_rows()


@pytest.mark.parametrize(
    ("name", "comma", "written"),
    [
        ("out.csv", True, "Kraft;drift;flags\n-7,994;-8,5;0\n"),
        ("out.tsv", True, "Kraft\tdrift\tflags\n-7,994\t-8,5\t0\n"),
        ("out.csv", False, 'Kraft,drift,flags\n"-7,994",-8.5,0\n'),
    ],
)
def test_answers_have_the_decimal_mark_of_the_log(tmp_path, name, comma, written):
    text = TextFormat(names=("Kraft",), separator=";", decimal_comma=comma)
    rows = make_rows(text, Kraft=["-7,994"], drift=[-8.5], flags=[0])
    apply.write_rows(rows, tmp_path / name)
    assert (tmp_path / name).read_text("utf-8") == written


def test_a_full_disk_under_parquet_is_one_message(tmp_path, monkeypatch):
    def fail(rows, path):
        path.write_bytes(b"half")
        raise ComputeError("No space left on device (os error 28)")

    monkeypatch.setattr(apply, "_write_parquet", fail)
    out = tmp_path / "out.parquet"
    out.write_bytes(b"before")
    with pytest.raises(InputError, match=r"No space left on device.*Make room on that disk"):
        apply.write_rows(ROWS, out)
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == {
        "out.parquet": b"before"
    }


def test_what_is_no_answer_of_the_disk_stays_as_it_is(tmp_path, monkeypatch):
    def fail(rows, path):
        raise ComputeError("schemas differ")

    monkeypatch.setattr(apply, "_write_parquet", fail)
    with pytest.raises(ComputeError, match="schemas differ"):
        apply.write_rows(ROWS, tmp_path / "out.parquet")


def test_what_a_killed_run_left_goes(tmp_path):
    (tmp_path / ".out.csv.0123abcd.zd-new").write_bytes(b"half")
    (tmp_path / ".other.csv.0123abcd.zd-new").write_bytes(b"of another file")
    apply.write_rows(ROWS, tmp_path / "out.csv")
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        ".other.csv.0123abcd.zd-new",
        "out.csv",
    ]


def test_a_kept_file_that_the_disk_refuses_is_not_taken_for_a_missing_one(tmp_path, monkeypatch):
    assert read_kept(tmp_path / "uncertainty.json") is None

    def refuse(path):
        raise OSError(5, "Input/output error", str(path))

    monkeypatch.setattr("pathlib.Path.read_bytes", refuse)
    with pytest.raises(OSError, match="Input/output error"):
        read_kept(tmp_path / "uncertainty.json")
