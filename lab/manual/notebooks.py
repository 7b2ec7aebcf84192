"""The tutorials that are notebooks: run when the site is built, shown with what they gave."""

import json
import os
import re
import subprocess
import sys
import tempfile
from pathlib import Path

from manual.cells import Bundle, CellAnswer, read_cells

DOCS = Path(__file__).parents[2] / "docs"
SECONDS = 1200
"""For one notebook, on a busy machine."""
HTML, TEXT = "text/html", "text/plain"
CONTROL = re.compile(r"\x1b\[[0-9;?]*[A-Za-z]")
TITLE = re.compile(r"# .+\n")


def list_notebooks() -> list[Path]:
    """Return the notebooks of the manual."""
    return sorted(DOCS.rglob("*.ipynb"))


class CellError(RuntimeError):
    """A cell of a notebook fails."""


def render_notebook(path: Path) -> str:
    """Return a notebook as a page: its text, its code, and what each cell gives when it is run now.

    Raises:
        CellError: a cell fails.
    """
    answers = iter(run_notebook(path))
    cells = [
        _render_cell(source, next(answers)) if kind == "code" else source
        for kind, source in read_cells(path)
    ]
    body = "\n\n".join(cells)
    title = TITLE.match(body)
    assert title, f"{path}: begins without a title"
    link = f"\n*[This notebook]({path.name}), run when the manual was built.*\n"
    return body[: title.end()] + link + body[title.end() :] + "\n"


def run_notebook(path: Path) -> list[CellAnswer]:
    """Return what a notebook's code cells give, run in a process and a folder of their own.

    Raises:
        CellError: a cell fails.
    """
    with tempfile.TemporaryDirectory(prefix="zerodrift-notebook-", ignore_cleanup_errors=True) as a:
        own = Path(a) / "cells"
        own.mkdir()
        answers = Path(a) / "answers.json"
        setting = {
            **os.environ,
            "PYTHONPATH": _put_before(str(DOCS.parent), "PYTHONPATH"),
            "PATH": _put_before(str(Path(sys.executable).parent), "PATH"),
            "IPYTHONDIR": str(Path(a) / "ipython"),
        }
        subprocess.run(
            [sys.executable, "-m", "manual.cells", path.resolve(), answers],
            cwd=own,
            env=setting,
            check=True,
            timeout=SECONDS,
        )
        given = [CellAnswer(**each) for each in json.loads(answers.read_text("utf-8"))]
    if given and given[-1].failed:
        raise CellError(f"{path.name}, code cell {len(given)}: {given[-1].failed}")
    return given


def _put_before(folder: str, variable: str) -> str:
    """Return the folders of an environment variable, with one more in front."""
    return os.pathsep.join(filter(None, (folder, os.environ.get(variable))))


def _render_cell(source: str, answer: CellAnswer) -> str:
    shown = [f"```python\n{source}\n```"]
    if answer.printed:
        shown.append(f"```text\n{CONTROL.sub('', answer.printed).rstrip()}\n```")
    shown += [_render_data(each) for each in answer.shown]
    return "\n\n".join(each for each in shown if each)


def _render_data(data: Bundle) -> str:
    """Return one output in the richest form that a page can show without fetching anything."""
    if HTML in data:
        lines = (line.strip() for line in str(data[HTML]).splitlines())
        return f'<div class="output">{"".join(line for line in lines if line)}</div>'
    return f"```text\n{data[TEXT]}\n```" if data[TEXT] else ""
