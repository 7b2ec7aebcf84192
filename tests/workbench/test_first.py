"""What the page holds when it is sent."""

import json

import pytest

pytest.importorskip("dash", reason="dash is not installed; `make setup` installs it")

from tests.workbench.conftest import serve
from tests.workbench.test_security import ask
from tests.workbench.test_workplace import settle

from zerodrift.workbench.app import lay_out_first

pytestmark = pytest.mark.long


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
        shown = page["main"].to_plotly_json()["props"]["data-shown"]
        assert "thermal_lag" in shown


def test_page_of_a_directory_without_a_project_is_the_start_page(tmp_path):
    with serve(tmp_path) as bench:
        page = lay_out_first(bench.place)
        assert page["bench"].hidden
        assert "A new project" in str(page["start"].children)
        assert "data-shown" not in page["main"].to_plotly_json()["props"]


def test_page_loads_no_plotting_code(project):
    with serve(project.directory) as bench:
        _, text = ask(bench, f"/?token={bench.token}")
        assert b"plotly.min.js" not in text
        assert b"async-graph" not in text
