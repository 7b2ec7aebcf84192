"""What the pictures show, and that nothing in them can be taken for something else."""

import re
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from zerodrift.base.errors import InputError
from zerodrift.report.browser import find_browser, write_pictures
from zerodrift.report.svg import AxisScale, Curve, Panel, Picture
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
    clouds = [(number, c) for number, p in enumerate(figure.panels) for c in p.clouds]
    assert len({(c.ink, c.mark) for _, c in clouds}) == 2
    assert sum(bool(c.name) for _, c in clouds) == 2
    ticks = figure.panels[0].y.ticks
    assert ticks is not None and [words for _, words in ticks] == [CHAMBER, BENCH, SECOND]
    shown = [x for _, c in clouds for x in c.x]
    told = [s.median for spreads in heat.errors.values() for s in spreads.values()]
    assert sorted(shown) == sorted(told)
    places = [(number, y) for number, c in clouds for y in c.y]
    assert len(set(places)) == len(places)
    assert {round(y) for _, y in places} == {0, 1, 2}


def has_browser() -> bool:
    try:
        return bool(find_browser())
    except InputError:
        return False


@pytest.mark.skipif(not has_browser(), reason="neither Chromium nor Chrome is installed")
def test_a_picture_comes_as_vectors_and_as_pixels(tmp_path: Path) -> None:
    line = Curve(np.arange(3.0), np.array([1.0, 3.0, 2.0]), "model")
    axis = AxisScale(0.0, 3.0)
    panel = Panel(60.0, 30.0, 300.0, 200.0, axis, axis, 'Fz < Fx & "both", µm', (line,))
    picture = Picture(400.0, 300.0, (panel,), "a line")
    kinds = ("svg", "pdf", "png")
    made = write_pictures({"fit of Fz": picture}, tmp_path / "pictures", tmp_path, kinds)
    assert [path.name for path in made] == [f"fit_of_Fz.{kind}" for kind in kinds]
    svg, pdf, png = (path.read_bytes() for path in made)
    drawn = ElementTree.fromstring(svg)
    assert 'Fz < Fx & "both", µm' in "".join(drawn.itertext())
    assert drawn.findall(".//{http://www.w3.org/2000/svg}path")
    assert not drawn.findall(".//{http://www.w3.org/2000/svg}image")
    assert pdf.startswith(b"%PDF") and len(re.findall(rb"/Type /Page\b", pdf)) == 1
    assert b"/Font" in pdf and png.startswith(b"\x89PNG")
