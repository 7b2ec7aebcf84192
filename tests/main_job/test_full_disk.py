"""A disk that takes no more: one message, the old files still there, nothing half-written."""

import errno
import os
import resource
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from tests.golden.vectors import load
from tests.projects import render_toml
from tests.verify.conftest import write_firmware

from zerodrift.base.config import load_config
from zerodrift.base.errors import InputError
from zerodrift.base.journal import write_text
from zerodrift.base.lock import STATE
from zerodrift.cli.main import main
from zerodrift.codegen.generate import generate
from zerodrift.export.golden import GoldenVectors, compute_golden
from zerodrift.export.integer_model import IntegerModel
from zerodrift.verify.firmware import write_artefacts

ROOT = Path(__file__).parents[2]
ANSWERS = (errno.ENOSPC, errno.EROFS, errno.EACCES, errno.EDQUOT, errno.EIO)


def fail_at(
    call: int, code: int, times: float = float("inf"), instead: Callable[..., object] | None = None
) -> Callable[..., object]:
    """Return a function that raises from its `call`-th call on, as a disk does that is full."""
    count = [0]

    def fail(*arguments: object, **options: object) -> object:
        count[0] += 1
        if call <= count[0] < call + times:
            raise OSError(code, os.strerror(code))
        return instead(*arguments, **options) if instead is not None else None

    return fail


def golden(model: IntegerModel) -> GoldenVectors:
    return compute_golden(model, np.zeros((2, len(model.channels)), dtype=model.code_type))


def read_tree(folder: Path) -> dict[str, bytes]:
    """Return the files; not the lock and its holder, which a command leaves."""
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in folder.rglob("*")
        if path.is_file() and path.parent != folder / STATE
    }


@pytest.mark.parametrize("code", ANSWERS)
@pytest.mark.parametrize("where", ["open", "fsync", "replace"])
def test_every_answer_is_one_message_and_the_old_file_stays(
    code: int, where: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "a.txt"
    path.write_text("old")
    owner = Path if where == "replace" else os
    monkeypatch.setattr(owner, where, fail_at(1, code))
    with pytest.raises(InputError) as caught:
        write_text(path, "new")
    told = str(caught.value)
    assert told.startswith(f"{path}: cannot be written ({os.strerror(code)})") and "-C" in told
    assert read_tree(tmp_path) == {"a.txt": b"old"}


def test_file_size_limit_of_the_system_leaves_the_old_file(tmp_path: Path) -> None:
    """No stand-in: the kernel refuses the write."""
    path = tmp_path / "a.txt"
    path.write_text("old")
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (4096, before[1]))
    try:
        with pytest.raises(InputError, match="cannot be written"):
            write_text(path, "x" * 10_000)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert read_tree(tmp_path) == {"a.txt": b"old"}


def test_firmware_is_replaced_as_a_whole_or_not_at_all(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whichever of the files is the one that no longer fits."""
    (tmp_path / "zerodrift.toml").write_text(render_toml('[logs]\ntrain = ["run.csv"]\n'))
    (tmp_path / "run.csv").write_text("time_s\n0\n")
    config = load_config(tmp_path)
    old, new = load("front_end").model, load("odd_hidden").model
    files = write_artefacts(config, old, generate(old), "{}", golden(old))
    before = read_tree(tmp_path)
    assert len(before) == len(files) + 6
    code = generate(new)
    for call in range(1, len(files) + 5):
        with monkeypatch.context() as patch, pytest.raises(InputError, match="No space left"):
            patch.setattr(os, "fsync", fail_at(call, errno.ENOSPC))
            write_artefacts(config, new, code, "{}", golden(new))
        assert read_tree(tmp_path) == before, call
    write_artefacts(config, new, code, "{}", golden(new))
    assert read_tree(tmp_path) != before


def test_package_that_does_not_fit_leaves_the_old_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, zerodrift: Callable[..., object]
) -> None:
    tmp_path = write_firmware(tmp_path / "project")
    assert zerodrift("package", "cmake", "-C", tmp_path).code == 0  # type: ignore[attr-defined]
    before = read_tree(tmp_path)
    for where, call in (("fsync", 1), ("fsync", 4), ("replace", 2)):
        with monkeypatch.context() as patch:
            patch.setattr(os, where, fail_at(call, errno.ENOSPC, 1, getattr(os, where)))
            done = zerodrift("package", "cmake", "-C", tmp_path)
        assert done.code == 2 and "No space left" in done.err  # type: ignore[attr-defined]
        assert read_tree(tmp_path) == before


@pytest.mark.parametrize("code", ANSWERS)
def test_what_no_command_expects_is_still_one_message(
    code: int, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def fail(*_: object, **__: object) -> None:
        raise OSError(code, os.strerror(code), "/somewhere/file")

    monkeypatch.setattr("zerodrift.cli.main.cli.main", fail)
    with pytest.raises(SystemExit) as end:
        main()
    told = capsys.readouterr().err
    of_writes = code in (errno.ENOSPC, errno.EROFS, errno.EDQUOT)
    what = "written" if of_writes else "opened, read or written"
    assert end.value.code == 2
    assert told.startswith(f"error: /somewhere/file: cannot be {what} ({os.strerror(code)})")
    assert "Traceback" not in told


@pytest.mark.parametrize(
    ("error", "answer"),
    [
        (OSError(errno.ESTALE, "Stale file handle", "logs/a.csv"), "Stale file handle"),
        (OSError("Too many open files (os error 24): logs/a.csv"), "Too many open files"),
    ],
)
def test_a_log_that_cannot_be_opened_in_the_midst_is_one_message(
    error: OSError, answer: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def fail(*_: object, **__: object) -> None:
        raise error

    monkeypatch.setattr("zerodrift.cli.main.cli.main", fail)
    with pytest.raises(SystemExit) as end:
        main()
    told = capsys.readouterr().err
    expected = f"error: logs/a.csv: cannot be opened, read or written ({answer}); "
    assert end.value.code == 2 and told.startswith(expected)


def test_an_error_that_is_no_disks_answer_is_not_hidden(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object, **__: object) -> None:
        raise ConnectionResetError(errno.ECONNRESET, "reset")

    monkeypatch.setattr("zerodrift.cli.main.cli.main", fail)
    with pytest.raises(ConnectionResetError):
        main()
