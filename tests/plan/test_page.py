"""The page's session runs, on the limits that it shows."""

import json
import re
import shlex
from pathlib import Path

from tests.plan.projects import HEAD

PAGE = Path(__file__).parents[2] / "docs/how-to/plan-an-experiment.md"


def test_the_pages_session_runs(tmp_path, zerodrift, monkeypatch):
    text = PAGE.read_text(encoding="utf-8")
    (limits,) = re.findall(r"```toml\n(.*?)```", text, re.DOTALL)
    (session,) = re.findall(r"```sh\n(.*?)```", text, re.DOTALL)
    (tmp_path / "zerodrift.toml").write_text(HEAD + limits, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    for line in session.splitlines():
        _, *words = shlex.split(line)
        told = zerodrift(*words, "--json")
        assert told.code == 0, told.err
        plan = json.loads(told.out)
        assert plan["separates"][0]["effects"] == ["creep", "load_hysteresis"]
        assert (tmp_path / "plan.csv").is_file() and (tmp_path / "plan_1.txt").is_file()
        assert all(0.0 <= s["loads"]["Fz"] <= 400.0 for s in plan["programme"])
