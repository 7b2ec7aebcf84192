"""A project's own Python is run for whoever agreed to it, and for nobody else."""

from pathlib import Path

import pytest
from tests.surroundings.conftest import REST, Run, assert_one_message, write_project


@pytest.fixture
def stranger(tmp_path: Path) -> Path:
    """Return a project whose file of effects leaves a mark wherever it is run."""
    folder = write_project(tmp_path / "p", REST + '\n[plugins]\nfiles = ["own.py"]\n')
    source = (Path(__file__).parents[2] / "docs/how-to/write-an-effect.md").read_text("utf-8")
    declaration = source.split("```python\n")[1].split("```")[0]
    mark = f"open({str(tmp_path / 'was_run')!r}, 'w').close()\n"
    (folder / "own.py").write_text(declaration + mark, encoding="utf-8")
    return folder


def test_report_asks_before_it_runs_a_strangers_effects(
    stranger: Path, tmp_path: Path, run: Run
) -> None:
    done = run("report", "-C", stranger, "--no-diagnose")
    assert_one_message(done, 2, "own.py", "--trust")
    assert not (tmp_path / "was_run").exists()
    assert not (stranger / "report.html").exists()


def test_report_asks_once_for_each_content(stranger: Path, tmp_path: Path, run: Run) -> None:
    assert run("report", "-C", stranger, "--no-diagnose", "--trust").returncode == 0
    assert (tmp_path / "was_run").exists()
    assert run("report", "-C", stranger, "--no-diagnose").returncode == 0
    own = stranger / "own.py"
    own.write_text(own.read_text("utf-8") + "# changed\n", encoding="utf-8")
    assert_one_message(run("report", "-C", stranger, "--no-diagnose"), 2, "--trust")


def test_the_authors_own_commands_do_not_ask(stranger: Path, run: Run) -> None:
    assert run("compare", "-C", stranger).returncode == 0
    assert run("report", "-C", stranger, "--no-diagnose").returncode == 0


def test_verify_runs_no_effects(stranger: Path, tmp_path: Path, run: Run) -> None:
    assert run("firmware", "-C", stranger).returncode == 0
    (tmp_path / "was_run").unlink()
    assert run("verify", "-C", stranger).returncode == 0
    assert not (tmp_path / "was_run").exists()


def test_the_page_asks_too(stranger: Path, tmp_path: Path, run: Run) -> None:
    done = run("workbench", "-C", stranger, "--no-browser")
    assert_one_message(done, 2, "own.py", "--trust")
    assert not (tmp_path / "was_run").exists()
