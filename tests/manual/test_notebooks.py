"""The manual's notebooks: kept without answers, run when the site is built, shown as they ran."""

import ast
import json

import pytest
from manual.notebooks import DOCS, list_notebooks, render_notebook

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


def test_a_page_shows_what_the_cells_give(tmp_path):
    nbformat = pytest.importorskip("nbformat", reason="`make docs` installs what runs notebooks")
    pytest.importorskip("nbclient")
    cells = [
        nbformat.v4.new_markdown_cell("# Title\n\nText."),
        nbformat.v4.new_code_cell("print('\\x1b[1mbold\\x1b[0m')\n6 * 7"),
        nbformat.v4.new_code_cell(
            "import plotly.graph_objects as go\ngo.Figure(go.Scatter(y=[1, 2]))"
        ),
        nbformat.v4.new_code_cell("import polars as pl\npl.DataFrame({'a': [1.5]})"),
    ]
    path = tmp_path / "some.ipynb"
    nbformat.write(nbformat.v4.new_notebook(cells=cells), path)
    page = render_notebook(path)
    assert page.startswith("# Title\n\n*[This notebook](some.ipynb)")
    assert "```text\nbold\n```" in page and "```text\n42\n```" in page
    assert '<div class="plot"' in page and '"y":[1,2]' in page
    assert '<div class="output">' in page and "<td>1.5</td>" in page


def test_a_cell_that_fails_stops_the_build(tmp_path):
    nbformat = pytest.importorskip("nbformat", reason="`make docs` installs what runs notebooks")
    client = pytest.importorskip("nbclient")
    path = tmp_path / "bad.ipynb"
    cells = [nbformat.v4.new_markdown_cell("# Bad"), nbformat.v4.new_code_cell("1 / 0")]
    nbformat.write(nbformat.v4.new_notebook(cells=cells), path)
    with pytest.raises(client.exceptions.CellExecutionError, match="ZeroDivisionError"):
        render_notebook(path)
