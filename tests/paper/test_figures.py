"""What the pictures show, and that nothing in them can be taken for something else."""

import re
from pathlib import Path
from xml.etree import ElementTree

import plotly.graph_objects as go
import pytest

from zerodrift.base.errors import InputError
from zerodrift.report.browser import find_browser, picture_pages
from zerodrift_lab.paper.figures import draw_heat
from zerodrift_lab.paper.summary import Spread
from zerodrift_lab.paper.why import Heat

pytestmark = pytest.mark.long

CHAMBER, BENCH, SECOND = "the chamber alone", "the chamber and bench logs", "a second thermometer"


def test_heat_has_a_look_per_method_and_a_row_per_training_logs() -> None:
    def errors(base: float) -> dict[str, Spread]:
        tests = ("chamber", "heating", "walking_still")
        return {
            test: Spread(base + i, base + i - 0.5, base + i + 0.5, 3)
            for i, test in enumerate(tests)
        }

    pairs = [("mlp", CHAMBER), ("mlp", BENCH), ("lag_bank", CHAMBER), ("lag_bank", BENCH)]
    heat = Heat(
        {pair: errors(2.0 * i + 1.0) for i, pair in enumerate([*pairs, ("lag_bank", SECOND)])}
    )
    figure = draw_heat(heat)
    looks = {(trace.marker.color, trace.marker.symbol): set() for trace in figure.data}
    for trace in figure.data:
        looks[trace.marker.color, trace.marker.symbol].add(trace.name)
    assert sorted(map(len, looks.values())) == [1, 1]
    assert [trace.showlegend for trace in figure.data].count(True) == 2
    assert list(figure.layout.yaxis.ticktext) == [CHAMBER, BENCH, SECOND]
    shown = [x for trace in figure.data for x in trace.x]
    told = [s.median for spreads in heat.errors.values() for s in spreads.values()]
    assert sorted(shown) == sorted(told)
    places = [(trace.xaxis, y) for trace in figure.data for y in trace.y]
    assert len(set(places)) == len(places)
    assert {round(y) for _, y in places} == {0, 1, 2}


def has_browser() -> bool:
    try:
        return bool(find_browser())
    except InputError:
        return False


@pytest.mark.skipif(not has_browser(), reason="neither Chromium nor Chrome is installed")
def test_a_picture_comes_as_vectors_and_as_pixels(tmp_path: Path) -> None:
    figure = go.Figure(go.Scatter(y=[1.0, 3.0, 2.0]))
    figure.update_layout(title='Fz < Fx & "both", µm', height=300)
    made = picture_pages({"fit of Fz": figure}, tmp_path / "pictures", tmp_path)
    assert [path.name for path in made] == [f"fit_of_Fz.{kind}" for kind in ("svg", "pdf", "png")]
    svg, pdf, png = (path.read_bytes() for path in made)
    drawn = ElementTree.fromstring(svg)
    assert 'Fz < Fx & "both", µm' in "".join(drawn.itertext())
    assert drawn.findall(".//{http://www.w3.org/2000/svg}path")
    assert not drawn.findall(".//{http://www.w3.org/2000/svg}image")
    assert pdf.startswith(b"%PDF") and len(re.findall(rb"/Type /Page\b", pdf)) == 1
    assert b"/Font" in pdf and png.startswith(b"\x89PNG")
