"""What the page holds when it is sent."""

import json
import sys
from types import SimpleNamespace

import pytest

pytest.importorskip("dash", reason="dash is not installed; `make setup` installs it")

from dash import no_update
from plotly.offline import get_plotlyjs_version
from tests.workbench.conftest import serve
from tests.workbench.test_security import ask
from tests.workbench.test_workplace import settle

from zerodrift.workbench.app import make_app
from zerodrift.workbench.bundle import BASIC
from zerodrift.workbench.chart import draw_main
from zerodrift.workbench.first import lay_out_first


def test_page_of_a_known_project_comes_with_verdict_choices_and_chart(project):
    with serve(project.directory) as bench:
        settle(bench.place)
        page = lay_out_first(bench.place)
        assert "thermal_lag" in str(page["verdict"].children)
        assert page["version"].data == bench.place.version
        assert not page["bench"].hidden
        assert page["start"].hidden
        first = {
            name: json.loads(page[name].to_plotly_json()["props"]["data-choices"])["first"]
            for name in ("output", "run")
        }
        worst = bench.place.findings.comparison.worst[0]
        assert first == {"output": worst.output, "run": worst.run}
        assert len(page["main"].figure.data) > 2

        # What the page's script tells at once is what is drawn: nothing is drawn twice.
        view = {**first, "ghost": None, "part": None}
        again = draw_main(bench.place, view, {}, None, page["drawn"].data)
        assert all(part is no_update for part in again)


def test_page_of_a_directory_without_a_project_is_the_start_page(tmp_path):
    with serve(tmp_path) as bench:
        page = lay_out_first(bench.place)
        assert page["bench"].hidden
        assert "A new project" in str(page["start"].children)
        with pytest.raises(AttributeError):
            _ = page["main"].figure


@pytest.fixture
def installed(tmp_path, monkeypatch):
    """Return a function that installs a small Plotly of some version."""

    def install(version):
        path = tmp_path / "environment" / BASIC
        path.parent.mkdir(parents=True)
        path.write_text(f"/**\n* plotly.js (basic - minified) v{version}\n*/\n")
        monkeypatch.setattr(sys, "prefix", str(tmp_path / "environment"))
        return path

    return install


def test_small_plotly_is_loaded_where_it_is_installed(installed, tmp_path):
    path = installed(get_plotlyjs_version())
    with serve(tmp_path) as bench:
        assert ask(bench, f"/?token={bench.token}")[1].count(b"/plotly-basic.min.js") == 2
        answer, text = ask(bench, f"/plotly-basic.min.js?token={bench.token}")
        assert text == path.read_bytes()
        assert answer.getheader("Content-Type").startswith("text/javascript")
        assert ask(bench, "/plotly-basic.min.js")[0].status == 403


@pytest.mark.parametrize("version", [None, "1.2.3", get_plotlyjs_version() + "0"])
def test_small_plotly_that_is_absent_or_of_another_version_is_not(installed, tmp_path, version):
    if version is not None:
        installed(version)
    else:
        installed("")
        (tmp_path / "environment" / BASIC).unlink()
    app = make_app(SimpleNamespace(directory=tmp_path))
    assert app.index_string.count("/plotly/package_data/plotly.min.js") == 2
