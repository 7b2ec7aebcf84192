"""What the page holds when it is sent."""

import json

import pytest

pytest.importorskip("dash", reason="dash is not installed; `make setup` installs it")

from dash import no_update
from tests.workbench.conftest import serve
from tests.workbench.test_workplace import settle

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
        worst = bench.place.findings.told["compare"]["worst"][0]
        assert first == {name: worst[name] for name in first}
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
