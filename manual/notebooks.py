"""The tutorials that are notebooks: run when the site is built, shown with what they gave."""

import json
import re
import shutil
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

import plotly.graph_objects as go

from zerodrift.report.page import embed_figure

if TYPE_CHECKING:
    from nbformat import NotebookNode

DOCS = Path(__file__).parents[1] / "docs"
SECONDS = 600
"""For one cell, on a busy machine."""
FIGURE, HTML, TEXT = "application/vnd.plotly.v1+json", "text/html", "text/plain"
CONTROL = re.compile(r"\x1b\[[0-9;?]*[A-Za-z]")
TITLE = re.compile(r"# .+\n")


def list_notebooks() -> list[Path]:
    """Return the notebooks of the manual."""
    return sorted(DOCS.rglob("*.ipynb"))


def render_notebook(path: Path) -> str:
    """Return a notebook as a page: its text, its code, and what each cell gives when it is run now.

    Raises:
        CellExecutionError: of nbclient; a cell fails.
    """
    cells = run_notebook(path).cells
    body = "\n\n".join(_render_cell(cell, path) for cell in cells)
    title = TITLE.match(body)
    assert title, f"{path}: begins without a title"
    link = f"\n*[This notebook]({path.name}), run when the manual was built.*\n"
    return body[: title.end()] + link + body[title.end() :] + "\n"


def run_notebook(path: Path) -> "NotebookNode":
    """Return a notebook with what its cells give, run in a folder of its own."""
    import nbformat
    from nbclient import NotebookClient

    notebook = nbformat.read(path, as_version=4)
    folder = tempfile.mkdtemp(prefix="zerodrift-notebook-")
    try:
        where = {"metadata": {"path": folder}}
        NotebookClient(notebook, timeout=SECONDS, resources=where).execute()
    finally:
        shutil.rmtree(folder, ignore_errors=True)
    return notebook


def _render_cell(cell: "NotebookNode", path: Path) -> str:
    if cell.cell_type != "code":
        return str(cell.source)
    shown = [f"```python\n{cell.source}\n```"]
    printed = "".join(str(each.text) for each in cell.outputs if each.output_type == "stream")
    if printed:
        shown.append(f"```text\n{CONTROL.sub('', printed).rstrip()}\n```")
    shown += [_render_data(each.data, path) for each in cell.outputs if "data" in each]
    return "\n\n".join(each for each in shown if each)


def _render_data(data: dict[str, object], path: Path) -> str:
    """Return one output in the richest form that a page can show without fetching anything."""
    if FIGURE in data:
        figure = go.Figure(json.loads(json.dumps(data[FIGURE])), skip_invalid=True)
        return embed_figure(figure, f"{path.stem}: a figure that its cell draws")
    if HTML in data:
        lines = (line.strip() for line in str(data[HTML]).splitlines())
        return f'<div class="output">{"".join(line for line in lines if line)}</div>'
    return f"```text\n{data[TEXT]}\n```" if data[TEXT] else ""
