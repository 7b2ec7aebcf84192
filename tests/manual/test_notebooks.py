"""The manual's notebooks: kept without answers, run when the site is built, shown as they ran."""

import ast
import json

import pytest
from manual.notebooks import DOCS, CellError, list_notebooks, render_notebook

NOTEBOOKS = list_notebooks()


def read_cells(path):
    return json.loads(path.read_text("utf-8"))["cells"]


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_is_kept_without_what_it_gave(path):
    assert path.is_relative_to(DOCS / "tutorial")
    cells = read_cells(path)
    assert "".join(cells[0]["source"]).startswith("# ")
    for cell in cells:
        if cell["cell_type"] == "code":
            assert cell["outputs"] == [] and cell["execution_count"] is None
            source = "".join(cell["source"])
            if not source.startswith("%%"):
                ast.parse(source)


def test_there_are_the_three_that_the_contents_promise():
    assert [path.stem for path in NOTEBOOKS] == [
        "notebook-fleet",
        "notebook-own-effect",
        "notebook-raw-log",
    ]


def write_notebook(path, *sources):
    """Write a notebook of a title and code cells."""
    cells = [{"cell_type": "markdown", "metadata": {}, "source": ["# Title\n", "\n", "Text."]}]
    empty = {"cell_type": "code", "execution_count": None, "metadata": {}, "outputs": []}
    cells += [{**empty, "source": source.splitlines(keepends=True)} for source in sources]
    path.write_text(json.dumps({"cells": cells, "nbformat": 4, "nbformat_minor": 5}))
    return path


def test_a_page_shows_what_the_cells_give(tmp_path):
    pytest.importorskip("IPython", reason="`make docs` installs what runs notebooks")
    path = write_notebook(
        tmp_path / "some.ipynb",
        "print('\\x1b[1mbold\\x1b[0m')\n6 * 7",
        "from zerodrift.report.svg import Picture\nPicture(40.0, 30.0, (), 'a picture')",
        "import polars as pl\npl.DataFrame({'a': [1.5]})",
        "%%writefile kept.txt\nof this notebook",
        "from pathlib import Path\nfrom IPython.display import display\n"
        "display(Path('kept.txt').read_text())",
    )
    page = render_notebook(path)
    assert page.startswith("# Title\n\n*[This notebook](some.ipynb)")
    assert "```text\nbold\n```" in page and "```text\n42\n```" in page
    assert '<div class="output"><svg' in page and 'aria-label="a picture"' in page
    assert '<div class="output">' in page and "<td>1.5</td>" in page
    assert "Traceback" not in page
    assert "'of this notebook" in page
    assert not (tmp_path / "kept.txt").exists()


def test_a_cell_that_fails_stops_the_build(tmp_path):
    pytest.importorskip("IPython", reason="`make docs` installs what runs notebooks")
    path = write_notebook(tmp_path / "bad.ipynb", "1", "1 / 0", "2")
    with pytest.raises(CellError, match=r"bad.ipynb, code cell 2: ZeroDivisionError"):
        render_notebook(path)
