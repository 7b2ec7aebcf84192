"""A project's own Python is run for whoever agreed to it, and for nobody else."""

import json
import shutil
from pathlib import Path

import pytest
from tests.surroundings.conftest import REST, Command, Run, assert_one_message, write_project
from tests.verify.conftest import write_firmware
from tests.verify.test_verify import forge

from zerodrift.c_runtime.host import render_sources
from zerodrift.export.model_files import load_model
from zerodrift.tasks.trust import remember_code
from zerodrift.verify import folder_check
from zerodrift.verify.replay import read_code


@pytest.fixture
def stranger(tmp_path: Path) -> Path:
    """Return a project whose file of effects leaves a mark wherever it is run."""
    folder = write_project(tmp_path / "p", REST + '\n[plugins]\nfiles = ["own.py"]\n')
    source = (Path(__file__).parents[2] / "docs/how-to/write-an-effect.md").read_text("utf-8")
    declaration = source.split("```python\n")[1].split("```")[0]
    mark = f"open({str(tmp_path / 'was_run')!r}, 'w').close()\n"
    (folder / "own.py").write_text(declaration + mark, encoding="utf-8")
    return folder


@pytest.mark.long
def test_report_asks_before_it_runs_a_strangers_effects(
    stranger: Path, tmp_path: Path, run: Run
) -> None:
    done = run("report", "-C", stranger, "--no-diagnose")
    assert_one_message(done, 2, "own.py", "--trust")
    assert not (tmp_path / "was_run").exists()
    assert not (stranger / "report.html").exists()


@pytest.mark.long
def test_report_asks_once_for_each_content(stranger: Path, tmp_path: Path, run: Run) -> None:
    assert run("report", "-C", stranger, "--no-diagnose", "--trust").returncode == 0
    assert (tmp_path / "was_run").exists()
    assert run("report", "-C", stranger, "--no-diagnose").returncode == 0
    own = stranger / "own.py"
    own.write_text(own.read_text("utf-8") + "# changed\n", encoding="utf-8")
    assert_one_message(run("report", "-C", stranger, "--no-diagnose"), 2, "--trust")


LOOKING = (
    ("compare",),
    ("diagnose",),
    ("effects",),
    ("plan", "--hours", "1", "--budget", "1"),
    ("propose",),
)


@pytest.mark.parametrize("arguments", LOOKING, ids=lambda words: words[0])
def test_commands_that_look_ask_before_they_run_a_strangers_effects(
    arguments: tuple[str, ...], stranger: Path, tmp_path: Path, zerodrift: Command
) -> None:
    done = zerodrift(*arguments, "-C", stranger)
    assert_one_message(done, 2, "own.py", "--trust")
    assert not (tmp_path / "was_run").exists()


def test_diff_asks_before_it_runs_a_strangers_effects(
    stranger: Path, tmp_path: Path, zerodrift: Command
) -> None:
    (stranger / "build").mkdir()
    shutil.copy(Path(__file__).parents[1] / "golden/ordinary.model.json", stranger / "build")
    (stranger / "build/ordinary.model.json").rename(stranger / "build/model.json")
    (stranger / "build/compensator.json").write_text("{}")
    done = zerodrift("diff", stranger, stranger)
    assert_one_message(done, 2, "own.py", "--trust")
    assert not (tmp_path / "was_run").exists()


@pytest.mark.long
def test_a_project_that_its_author_works_on_is_not_asked_about(stranger: Path, run: Run) -> None:
    """Not even where a file of effects was edited since."""
    assert run("train", "-C", stranger).returncode == 0
    own = stranger / "own.py"
    own.write_text(own.read_text("utf-8") + "# changed\n", encoding="utf-8")
    assert run("compare", "-C", stranger).returncode == 0
    assert run("report", "-C", stranger, "--no-diagnose").returncode == 0


def test_the_answer_on_the_terminal_is_taken(
    stranger: Path, tmp_path: Path, zerodrift: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    answers = [False, True]
    monkeypatch.setattr("zerodrift.cli.console.is_somebody_there", lambda: True)
    monkeypatch.setattr("click.confirm", lambda *_, **__: answers.pop(0))
    done = zerodrift("effects", "-C", stranger)
    assert_one_message(done, 2, "not run, as you asked")
    assert not (tmp_path / "was_run").exists()
    assert zerodrift("effects", "-C", stranger).code == 0
    assert (tmp_path / "was_run").exists()
    assert zerodrift("effects", "-C", stranger).code == 0, "asked once"


@pytest.mark.long
def test_verify_runs_no_effects(stranger: Path, tmp_path: Path, run: Run) -> None:
    assert run("firmware", "-C", stranger).returncode == 0
    (tmp_path / "was_run").unlink()
    assert run("verify", "-C", stranger).returncode == 0
    assert not (tmp_path / "was_run").exists()


@pytest.mark.long
def test_the_page_asks_too(stranger: Path, tmp_path: Path, run: Run) -> None:
    done = run("workbench", "-C", stranger, "--no-browser")
    assert_one_message(done, 2, "own.py", "--trust")
    assert not (tmp_path / "was_run").exists()


@pytest.fixture
def foreign(tmp_path: Path) -> Path:
    """Return a project whose C leaves a mark wherever it is run, manifest and all in order."""
    folder = write_firmware(tmp_path / "p")
    source = folder / "firmware" / "front_end.c"
    mark = str(tmp_path / "was_run")
    source.write_text(
        source.read_text()
        + "#include <stdio.h>\n__attribute__((constructor)) static void zd_own(void)\n"
        + f'{{ FILE *file = fopen("{mark}", "w"); if (file) {{ fclose(file); }} }}\n'
    )
    return folder


def test_verify_builds_nothing_of_files_that_differ_from_the_manifest(
    foreign: Path, tmp_path: Path, zerodrift: Command
) -> None:
    done = zerodrift("verify", "-C", foreign)
    assert_one_message(done, 1, "front_end.c: was changed", "front_end.c:", "nothing was built")
    assert not (tmp_path / "was_run").exists()
    told = json.loads(zerodrift("verify", "-C", foreign, "--json").out)
    assert told["backends"] == [] and [n["what"] for n in told["not_checked"]] == ["host"]
    assert told["changed"] and told["failures"]
    assert not (tmp_path / "was_run").exists()


def test_verify_asks_before_it_runs_c_that_zerodrift_did_not_write(
    foreign: Path, tmp_path: Path, zerodrift: Command
) -> None:
    forge(foreign)
    done = zerodrift("verify", "-C", foreign)
    assert_one_message(done, 2, "firmware: C that differs", "--trust")
    assert not (tmp_path / "was_run").exists()


@pytest.fixture
def quick_verify(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leave out the other layouts and the cores."""
    for function in ("list_host_ways", "list_core_ways"):
        monkeypatch.setattr(folder_check, function, lambda model: ())
    monkeypatch.setattr("zerodrift.verify.replay.RANDOM_STEPS", 1000)


@pytest.mark.long
def test_verify_runs_foreign_c_that_the_user_agreed_to(
    foreign: Path, tmp_path: Path, zerodrift: Command, quick_verify: None
) -> None:
    forge(foreign)
    assert zerodrift("verify", "-C", foreign, "--trust").code == 1, "its lines are not ours"
    assert (tmp_path / "was_run").exists()
    assert "--trust" not in zerodrift("verify", "-C", foreign).err, "asked once for each content"


def test_an_unknown_file_beside_the_c_is_asked_about(tmp_path: Path, zerodrift: Command) -> None:
    folder = write_firmware(tmp_path / "p")
    (folder / "firmware" / "zd_more.h").write_text("/* not in the manifest */\n")
    assert_one_message(zerodrift("verify", "-C", folder), 2, "C that differs", "--trust")


@pytest.mark.long
def test_what_firmware_wrote_is_known_to_a_later_version(
    tmp_path: Path, zerodrift: Command, quick_verify: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = write_firmware(tmp_path / "p")
    model = load_model(folder / "build/model.json")
    remember_code(render_sources(read_code(model, folder / "firmware")))
    monkeypatch.setattr("zerodrift.verify.replay.is_generated", lambda *_: False)
    assert zerodrift("verify", "-C", folder).code == 0
