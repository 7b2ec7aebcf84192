"""The page's sessions run, on the limits that it shows."""

import json
import re
import shlex
from pathlib import Path

import pytest

from tests.plan.projects import HEAD

pytestmark = pytest.mark.long

PAGE = Path(__file__).parents[2] / "docs/how-to/plan-an-experiment.md"


def write_project(folder: Path) -> list[str]:
    """Write the page's limits as a project without logs, and return the page's sessions."""
    text = PAGE.read_text(encoding="utf-8")
    (limits,) = re.findall(r"```toml\n(.*?)```", text, re.DOTALL)
    (folder / "zerodrift.toml").write_text(HEAD + limits, encoding="utf-8")
    sessions: list[str] = re.findall(r"```sh\n(.*?)```", text, re.DOTALL)
    return sessions


def test_the_pages_session_runs(tmp_path, zerodrift, monkeypatch):
    session, _ = write_project(tmp_path)
    monkeypatch.chdir(tmp_path)
    for line in session.splitlines():
        _, *words = shlex.split(line)
        told = zerodrift(*words, "--json")
        assert told.code == 0, told.err
        plan = json.loads(told.out)
        assert plan["separates"][0]["effects"] == ["creep", "load_hysteresis"]
        assert (tmp_path / "plan.csv").is_file() and (tmp_path / "plan_1.txt").is_file()
        assert all(0.0 <= s["loads"]["Fz"] <= 400.0 for s in plan["programme"])


def test_the_pages_questions_before_any_log_run(tmp_path, zerodrift, monkeypatch):
    _, questions = write_project(tmp_path)
    monkeypatch.chdir(tmp_path)
    plans = []
    for line in filter(None, (shlex.split(line, comments=True) for line in questions.splitlines())):
        told = zerodrift(*line[1:], "--budget", "3", "--json")
        assert told.code == 0, told.err
        plans.append(json.loads(told.out))
    error, effects, units = plans
    for plan in (error, units):
        assert plan["aimed"] == {"Fz": 2.0}
        assert 0.0 < plan["errors"]["Fz"] <= plan["aimed"]["Fz"]
    assert "aimed" not in effects and effects["outlooks"]
    assert units["hours"] < error["hours"]
