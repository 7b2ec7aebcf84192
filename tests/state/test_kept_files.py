"""What is kept is believed only as it was written; else it is computed again, and that is said."""

import json
import os
import subprocess
import sys
import threading
import time
import tomllib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from tests.conftest import Result
from tests.loop.conftest import TOML, write_log
from tests.surroundings.conftest import REST, write_project
from zerodrift.base.errors import InputError
from zerodrift.base.files import REMAINDER
from zerodrift.base.lock import STATE, WAIT_VARIABLE, lock_project
from zerodrift.base.records import read_sealed, render_sealed
from zerodrift.diagnosis.history import load_history
from zerodrift.train.checkpoint import Checkpoint, load_checkpoint, save_checkpoint

Command = Callable[..., Result]


def scale_a_coefficient(text: str) -> str:
    kept = json.loads(text)
    kept["physics"]["coefficients"][-1][0] *= 1.5
    return json.dumps(kept)


def widen_the_range(text: str) -> str:
    kept = json.loads(text)
    kept["calibration"]["temperature_degC"] = [-1000, 1e9]
    return json.dumps(kept)


def put_nan(text: str) -> str:
    kept = json.loads(text)
    kept["physics"]["coefficients"][-1][0] = float("nan")
    return json.dumps(kept)


def change_the_shape(text: str) -> str:
    kept = json.loads(text)
    kept["physics"]["coefficients"] = [[1.0, 2.0, 3.0]]
    return json.dumps(kept)


SPOILT: dict[str, Callable[[str], str]] = {
    "a coefficient times 1.5": scale_a_coefficient,
    "a range without end": widen_the_range,
    "nan": put_nan,
    "shape": change_the_shape,
    "cut": lambda text: text[: len(text) // 2],
    "empty": lambda text: "",
    "a list": lambda text: "[]",
    "another format": lambda text: text.replace('"format": ', '"format": 9'),
}


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> Path:
    project = write_project(tmp_path_factory.mktemp("trained") / "project")
    subprocess.run(
        [sys.executable, "-m", "zerodrift", "train", "-C", project], check=True, capture_output=True
    )
    return project


@pytest.mark.spread(2, "how", SPOILT)
def test_a_compensator_that_is_not_as_written_is_trained_again(
    how: str, trained: Path, zerodrift: Command
) -> None:
    kept = trained / "build" / "compensator.json"
    good = kept.read_bytes()
    kept.write_text(SPOILT[how](good.decode()), encoding="utf-8")
    assert zerodrift("compare", "-C", trained).code == 0
    done = zerodrift("export", "-C", trained)
    assert done.code == 0, done.err
    assert "It is trained again now" in " ".join(done.err.split())
    assert "Traceback" not in done.err
    assert kept.read_bytes() == good


def test_an_unspoilt_compensator_is_taken(trained: Path, zerodrift: Command) -> None:
    """The test above can fail: nothing is said where nothing is wrong."""
    told = zerodrift("export", "-C", trained).err
    assert "trained again" not in told and "not repeated" in told


def test_a_checkpoint_with_another_number_is_not_believed(tmp_path: Path) -> None:
    path = tmp_path / "rehearsal.npz"
    save_checkpoint(path, Checkpoint({"weights": np.ones(3)}, {"mark": "a"}))
    assert load_checkpoint(path) is not None
    with np.load(path) as stored:
        parts = {name: stored[name] for name in stored.files}
    np.savez(path, **{**parts, "weights": np.full(3, 1.5)})  # type: ignore[arg-type]
    with pytest.raises(InputError, match="not those that were written"):
        load_checkpoint(path)
    for content in (b"", path.read_bytes()[:100], b"PK"):
        path.write_bytes(content)
        with pytest.raises(InputError, match="no checkpoint"):
            load_checkpoint(path)


def test_an_edited_history_is_refused_and_not_touched(tmp_path: Path) -> None:
    """It cannot be computed again, so that it is not replaced either."""
    path = tmp_path / "history.json"
    body = {"format": 2, "entries": []}
    path.write_bytes(render_sealed(body))
    assert load_history(path) == ()
    path.write_text(json.dumps({**body, "sha256": "0"}))
    with pytest.raises(InputError, match="edited or damaged"):
        load_history(path)
    path.write_text(json.dumps({"format": 1, "entries": []}))  # as earlier versions wrote it
    assert load_history(path) == ()


@pytest.mark.parametrize("value", [1.5, "é\u2028", [1, None], {"a": {"b": -0.0}}])
def test_sealed_files_give_back_what_they_hold(value: object) -> None:
    content = render_sealed({"x": value})
    assert read_sealed(content) == {"x": value}
    with pytest.raises(ValueError, match="edited or damaged"):
        read_sealed(content.replace(b'"x"', b'"y"'))
    with pytest.raises(ValueError, match=r"nan|Out of range"):
        render_sealed({"x": float("nan")})


@pytest.mark.long
def test_files_of_the_user_are_never_replaced(tmp_path: Path, zerodrift: Command) -> None:
    rest = REST + '\n[firmware]\nout = "src"\n'
    project = write_project(tmp_path / "project", rest)
    text = (project / "zerodrift.toml").read_text(encoding="utf-8")
    (project / "zerodrift.toml").write_text(text.replace('"small"', '"app"'), encoding="utf-8")
    own = project / "src" / "app.c"
    own.parent.mkdir()
    own.write_text("int main(void) { return 0; }\n")
    for options in ((), ("--force",)):
        done = zerodrift("firmware", "-C", project, *options)
        assert done.code == 2
        assert "app.c: is there and was not written by zerodrift" in done.err
        assert "[firmware]" in done.err
    assert own.read_text() == "int main(void) { return 0; }\n"
    assert [path.name for path in own.parent.iterdir()] == ["app.c"]
    assert not (project / "build" / "model.json").exists()


def test_what_a_kill_left_is_removed_by_the_next_command(
    tmp_path: Path, zerodrift: Command
) -> None:
    project = write_project(tmp_path / "project")
    build = project / "build"
    scratch = project / STATE / "scratch-abc"
    scratch.mkdir(parents=True)
    (scratch / ".in-use").touch()
    earlier = [
        build / ".firmware-abcd1234",
        build / ".verify-abcd1234",
        project / ".report-abcd1234",
    ]
    for folder in earlier:
        folder.mkdir()
        (folder / "model.c").touch()
        os.utime(folder, (time.time() - 7200,) * 2)
    strays = [
        build / f".rehearsal.npz.1a2b3c4d{REMAINDER}",
        build / ".compensator.json.ab12cd34",
        project / ".zerodrift.toml.ab12cd34",
    ]
    users = [project / ".notes.original", project / ".editorconfig", build.parent / ".report-draft"]
    for path in (*strays, *users):
        path.touch()
    assert zerodrift("train", "-C", project).code == 0
    assert not [path for path in (scratch, *earlier, *strays) if path.exists()]
    assert all(path.exists() for path in users)


def test_a_second_writer_is_told_for_whom_it_waits(
    tmp_path: Path, zerodrift: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    project = write_project(tmp_path / "project")
    holder = subprocess.Popen(
        [sys.executable, "-c", HOLD, str(project)], stdout=subprocess.PIPE, text=True
    )
    assert holder.stdout is not None and holder.stdout.readline() == "held\n"
    try:
        monkeypatch.setenv(WAIT_VARIABLE, "0.3")
        done = zerodrift("train", "-C", project)
        assert done.code == 2
        assert f"process {holder.pid}" in done.err and "since" in done.err
        assert "waited 0.3 s" in done.err and "Nothing was changed" in done.err
        assert zerodrift("compare", "-C", project).code == 0, "readers wait for nobody"
    finally:
        holder.kill()
        holder.wait()
    assert zerodrift("train", "-C", project).code == 0, "a kill frees the lock"


HOLD = """
import sys, time
from pathlib import Path
from zerodrift.base.lock import lock_project
with lock_project(Path(sys.argv[1])):
    print("held", flush=True)
    time.sleep(600)
"""


def test_a_wait_that_is_no_number_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(WAIT_VARIABLE, "soon")
    with pytest.raises(InputError, match="ZERODRIFT_WAIT_S=soon"), lock_project(tmp_path):
        pass


@pytest.mark.long
def test_eight_adds_at_once_all_hold(tmp_path: Path) -> None:
    """Every effect that is said to be added is in zerodrift.toml and in the history."""
    project = tmp_path / "project"
    for seed in range(3):
        write_log(project / "logs" / f"run_{seed}.csv", seed, seconds=300)
    (project / "zerodrift.toml").write_text(TOML.format(more_logs=""), encoding="utf-8")
    kinds = (
        *("thermal_lag", "creep", "dark_current", "warm_up"),
        *("load_hysteresis", "span_tempco", "thermal_gradient", "load_nonlinearity"),
    )
    added: list[str] = []

    def add(kind: str) -> None:
        done = subprocess.run(
            [sys.executable, "-m", "zerodrift", "add", kind, "--force", "-C", project],
            check=False,
            capture_output=True,
            text=True,
        )
        assert "Traceback" not in done.stderr
        if done.returncode == 0:
            assert f"Added {kind}" in " ".join(done.stdout.split())
            added.append(kind)

    threads = [threading.Thread(target=add, args=(kind,)) for kind in kinds]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    text = (project / "zerodrift.toml").read_text(encoding="utf-8")
    effects = [effect["kind"] for effect in tomllib.loads(text)["effect"]]
    history = [entry.effect for entry in load_history(project / "build" / "history.json")]
    assert len(added) >= 3
    assert sorted(effects) == sorted(["zero_tempco", *added])
    assert sorted(history) == sorted(added)


def test_a_folder_that_can_only_be_read_can_be_read(trained: Path, tmp_path: Path) -> None:
    if os.geteuid() == 0:
        pytest.skip("root may write everywhere")
    for path in (trained, *trained.rglob("*")):
        path.chmod(path.stat().st_mode & ~0o222)
    try:
        for command in ("compare", "history"):
            subprocess.run([sys.executable, "-m", "zerodrift", command, "-C", trained], check=True)
    finally:
        for path in (trained, *trained.rglob("*")):
            path.chmod(path.stat().st_mode | 0o200)
