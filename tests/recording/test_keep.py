"""A log is whole after a kill at any instant."""

import math
import signal
import subprocess
import sys
import time
from pathlib import Path

import polars as pl
import pytest

from zerodrift.base.errors import InputError
from zerodrift.recording import recorder
from zerodrift.recording.recorder import Keeper, name_journal, recover

WRITER = """
import itertools, sys
from pathlib import Path
from zerodrift.recording import recorder
recorder.SYNC_S, recorder.WHOLE_S, recorder.SHARE = 0.01, 0.02, 0.0
with recorder.Keeper(Path(sys.argv[1])) as keeper:
    print("ready", flush=True)
    for number in itertools.count():
        keeper.add({"n": float(number), "half": number / 2})
        keeper.settle()
"""


def read(path: Path) -> list[dict[str, float | None]]:
    return pl.read_parquet(path).to_dicts()


def test_what_is_kept_is_what_came(tmp_path: Path) -> None:
    path = tmp_path / "log.parquet"
    with Keeper(path) as keeper:
        keeper.add({"a": 1.0})
        keeper.add({"b": 2.0, "a": math.nan})
        assert keeper.rows == 2
    assert read(path) == [{"a": 1.0, "b": None}, {"a": None, "b": 2.0}]
    assert [each.name for each in tmp_path.iterdir()] == ["log.parquet"]


def test_nothing_came_and_nothing_is_left(tmp_path: Path) -> None:
    with Keeper(tmp_path / "log.parquet"):
        pass
    assert list(tmp_path.iterdir()) == []


def test_no_log_is_replaced(tmp_path: Path) -> None:
    path = tmp_path / "log.parquet"
    path.write_text("mine")
    with pytest.raises(InputError, match="is there already; expected a new name"):
        Keeper(path)
    with pytest.raises(InputError, match=r"expected a name that ends in \.parquet"):
        Keeper(tmp_path / "log.csv")
    with pytest.raises(InputError, match="cannot be written"):
        Keeper(tmp_path / "none" / "log.parquet")
    assert path.read_text() == "mine"


@pytest.mark.parametrize("after_s", [0.0, 0.05, 0.13, 0.31])
def test_killed_at_any_instant(tmp_path: Path, after_s: float) -> None:
    path = tmp_path / "log.parquet"
    process = subprocess.Popen(
        [sys.executable, "-c", WRITER, str(path)], stdout=subprocess.PIPE, text=True
    )
    assert process.stdout is not None and process.stdout.readline() == "ready\n"
    time.sleep(after_s)
    process.send_signal(signal.SIGKILL)
    process.wait()
    there = name_journal(path).stat().st_size or path.exists()
    rows = recover(path)
    assert rows > 0 or not there
    if rows:
        assert read(path) == [{"n": float(n), "half": n / 2} for n in range(rows)]
    assert not name_journal(path).exists()


def test_a_kill_between_the_file_and_the_journal_doubles_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "log.parquet"
    keeper = Keeper(path)
    for number in range(5):
        keeper.add({"n": float(number)})
    real = recorder.write_whole

    def write_and_die(target: Path, content: bytes) -> None:
        real(target, content)
        raise KeyboardInterrupt

    monkeypatch.setattr(recorder, "write_whole", write_and_die)
    with pytest.raises(KeyboardInterrupt):
        keeper._write()
    monkeypatch.undo()
    assert path.exists() and name_journal(path).stat().st_size > 0
    keeper._journal.close()  # as the end of its process does
    assert recover(path) == 5
    assert [row["n"] for row in read(path)] == [0.0, 1.0, 2.0, 3.0, 4.0]


def test_a_line_that_was_cut_is_left_out(tmp_path: Path) -> None:
    path = tmp_path / "log.parquet"
    name_journal(path).write_text('[0, {"n": 0.0}]\n[1, {"n": null}]\n[2, {"n": 2.')
    with pytest.raises(InputError, match="was cut off"):
        Keeper(path)
    assert recover(path) == 2
    assert read(path) == [{"n": 0.0}, {"n": None}]
    with pytest.raises(InputError, match="is whole; expected one that was cut off"):
        recover(path)
    with pytest.raises(InputError, match="there is no recording of that name"):
        recover(tmp_path / "other.parquet")
