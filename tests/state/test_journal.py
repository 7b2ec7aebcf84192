"""Files that change together: the old set or the new one, wherever a kill or a refusal falls."""

import errno
import json
import os
from pathlib import Path

import pytest

from tests.state.faults import Tree, before_each_call, find_mixed, list_crashes, read_tree
from zerodrift.base.errors import InputError
from zerodrift.base.journal import change_together, hold_project, settle_project, write_all
from zerodrift.base.lock import STATE


def make_project(folder: Path) -> dict[Path, bytes | None]:
    """Write three files; return a change that replaces, adds and removes."""
    (folder / "build").mkdir(parents=True)
    (folder / "zerodrift.toml").write_bytes(b"old")
    (folder / "build" / "history.json").write_bytes(b"old history")
    (folder / "build" / "rehearsal.npz").write_bytes(b"checkpoint")
    return {
        folder / "zerodrift.toml": b"new",
        folder / "build" / "history.json": b"new history",
        folder / "firmware" / "sensor" / "a.h": b"header",
        folder / "firmware" / "sensor" / "a.c": b"source",
        folder / "build" / "rehearsal.npz": None,
    }


def test_a_kill_before_any_call_leaves_the_old_set_or_the_new_one(tmp_path: Path) -> None:
    project = tmp_path / "project"
    change = make_project(project)
    old = read_tree(project)
    crashes = list_crashes(project, lambda: write_all(project, change), tmp_path / "crashes")
    new = read_tree(project)
    assert set(new) == set(old) - {"build/rehearsal.npz"} | {
        "firmware/sensor/a.h",
        "firmware/sensor/a.c",
    }
    assert len(crashes) > 30
    outcomes = set()
    for place in crashes:
        settle_project(place)
        with hold_project(place):
            pass
        found = read_tree(place)  # hidden files count
        assert found in (old, new), place.name
        outcomes.add(found == new)
    assert outcomes == {True, False}


def test_half_a_set_would_be_found(tmp_path: Path) -> None:
    """The test above can fail: files put in place one by one are mixed at most points."""
    project = tmp_path / "project"
    change = make_project(project)
    old = read_tree(project)

    def put() -> None:
        for path, content in change.items():
            path.parent.mkdir(parents=True, exist_ok=True)
            beside = path.with_name("beside")
            beside.write_bytes(content or b"")
            os.replace(beside, path)  # noqa: PTH105

    crashes = list_crashes(project, put, tmp_path / "crashes")
    assert len(find_mixed(crashes, old, read_tree(project))) > 3


def test_a_kill_while_the_next_command_cleans_up_is_survived_too(tmp_path: Path) -> None:
    project = tmp_path / "project"
    change = make_project(project)
    old = read_tree(project)
    crashes = list_crashes(project, lambda: write_all(project, change), tmp_path / "crashes")
    new = read_tree(project)
    for place in crashes[::4]:
        again = list_crashes(place, lambda p=place: _hold(p), tmp_path / f"again_{place.name}")  # type: ignore[misc]
        for second in again:
            _hold(second)
            assert read_tree(second) in (old, new), second


def _hold(project: Path) -> None:
    with hold_project(project):
        pass


def count_calls(project: Path, change: dict[Path, bytes | None]) -> int:
    numbers = []
    with before_each_call(lambda number, _: numbers.append(number)):
        write_all(project, change)
    return len(numbers)


@pytest.mark.parametrize("code", [errno.EIO, errno.ENOSPC, errno.EMFILE, errno.EACCES])
@pytest.mark.parametrize("lasting", [False, True], ids=["once", "from then on"])
def test_a_refusal_at_any_call_is_one_true_message(
    code: int, lasting: bool, tmp_path: Path
) -> None:
    calls = count_calls(tmp_path / "count", make_project(tmp_path / "count"))
    new_content = read_tree(tmp_path / "count")
    for refused in range(calls):
        project = tmp_path / f"project_{refused}"
        change = make_project(project)
        old = read_tree(project)

        def refuse(number: int, name: str, refused: int = refused) -> None:
            if number == refused or (lasting and number > refused):
                raise OSError(code, os.strerror(code))

        told = ""
        with before_each_call(refuse):
            try:
                write_all(project, change)
            except InputError as error:
                told = str(error)
        found = read_tree(project)
        kept = {name: c for name, c in found.items() if not _is_hidden(name)}
        if not told:
            assert kept == new_content, refused
        elif "Every file is as it was before." in told:
            assert kept == old, (refused, told)
        else:
            assert "not finished" in told, told
        _hold(project)
        assert read_tree(project) in ((new_content,) if not told else (old, new_content)), refused


def _is_hidden(name: str) -> bool:
    return any(part.startswith(".") for part in name.split("/"))


def test_a_directory_in_the_place_of_a_file_is_told_before_anything_is_written(
    tmp_path: Path,
) -> None:
    change = make_project(tmp_path)
    (tmp_path / "firmware" / "sensor" / "a.c").mkdir(parents=True)
    old = read_tree(tmp_path)
    with pytest.raises(InputError, match=r"a\.c: is a directory; .*Every file is as it was"):
        write_all(tmp_path, change)
    assert read_tree(tmp_path) == old


def cut_off(tmp_path: Path) -> tuple[Path, Tree, Tree]:
    """Return a project cut off between two renames, and its files before and after."""
    project = tmp_path / "project"
    change = make_project(project)
    old = read_tree(project)
    crashes = list_crashes(project, lambda: write_all(project, change), tmp_path / "crashes")
    new = read_tree(project)
    for place in crashes:
        found = read_tree(place)
        if found["zerodrift.toml"] == b"new" and found["build/history.json"] == b"old history":
            return place, old, new
    raise AssertionError("no crash between the two")


def test_what_was_cut_off_is_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    place, _, new = cut_off(tmp_path)
    settle_project(place)
    assert "a command that was cut off was changing 5 files; that is done now" in (
        capsys.readouterr().err
    )
    _hold(place)
    assert read_tree(place) == new


def test_a_file_edited_since_the_kill_is_kept_and_the_rest_taken_back(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    place, old, _ = cut_off(tmp_path)
    (place / "build" / "history.json").write_bytes(b"by hand")
    settle_project(place)
    told = capsys.readouterr().err
    assert "taken back" in told and "history.json was edited since and stays" in told
    _hold(place)
    assert read_tree(place) == {**old, "build/history.json": b"by hand"}


def test_damaged_new_contents_are_not_put_in_place(tmp_path: Path) -> None:
    place, old, _ = cut_off(tmp_path)
    for path in place.rglob("*.zd-new"):
        path.write_bytes(b"torn")
    _hold(place)
    assert read_tree(place) == old


def test_a_reader_refuses_a_project_that_it_cannot_settle(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    place, _, _ = cut_off(tmp_path)

    def refuse(_: Path) -> None:
        raise OSError(errno.EROFS, os.strerror(errno.EROFS))

    monkeypatch.setattr("zerodrift.base.journal.try_lock", refuse)
    with pytest.raises(InputError, match="holds an unfinished change"):
        settle_project(place)


def test_changes_are_gathered_and_written_together_or_not_at_all(tmp_path: Path) -> None:
    make_project(tmp_path)
    old = read_tree(tmp_path)
    with pytest.raises(RuntimeError), change_together(tmp_path):
        write_all(tmp_path, {tmp_path / "zerodrift.toml": b"new"})
        raise RuntimeError
    assert read_tree(tmp_path) == old
    with change_together(tmp_path):
        write_all(tmp_path, {tmp_path / "zerodrift.toml": b"new"})
        assert read_tree(tmp_path) == old
        write_all(tmp_path, {tmp_path / "build" / "history.json": None})
    assert read_tree(tmp_path) == {"zerodrift.toml": b"new", "build/rehearsal.npz": b"checkpoint"}


def test_the_record_has_no_place_of_the_machine_in_it(tmp_path: Path) -> None:
    """So that a project which is moved, or mounted elsewhere, is settled where it lies."""
    place, _, _ = cut_off(tmp_path)
    (record,) = (place / STATE).glob("*.forward")
    assert str(tmp_path) not in record.read_text()
    assert json.loads(record.read_text())["steps"][0]["path"] == "zerodrift.toml"


def test_permissions_of_a_replaced_file_stay(tmp_path: Path) -> None:
    change = make_project(tmp_path)
    (tmp_path / "zerodrift.toml").chmod(0o640)
    write_all(tmp_path, change)
    assert (tmp_path / "zerodrift.toml").stat().st_mode & 0o777 == 0o640


def test_a_linked_file_is_changed_where_it_lies(tmp_path: Path) -> None:
    change = make_project(tmp_path / "project")
    elsewhere = tmp_path / "elsewhere.toml"
    (tmp_path / "project" / "zerodrift.toml").rename(elsewhere)
    (tmp_path / "project" / "zerodrift.toml").symlink_to(elsewhere)
    write_all(tmp_path / "project", change)
    assert elsewhere.read_bytes() == b"new"
    assert (tmp_path / "project" / "zerodrift.toml").is_symlink()
