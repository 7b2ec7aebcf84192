"""What stands above the chart is there before it: a chart never moves under the pointer."""

import json
import signal

import pytest
from tests.workbench.pages import DRAWN, open_page, wait_for_job
from tests.workbench.test_early import start

pytestmark = pytest.mark.long

WATCH = """
window.places = [];
(function watch() {
  const chart = document.querySelector('#main svg');
  if (chart) {
    const place = chart.getBoundingClientRect().y + window.scrollY;
    if (window.places.at(-1) !== place) { window.places.push(place); }
  }
  requestAnimationFrame(watch);
})();
"""


def test_the_chart_stays_where_it_was_drawn(page, bench):
    open_page(page, bench)
    wait_for_job(page, bench)
    page.add_init_script(WATCH)
    page.reload()
    page.wait_for_selector("#errors table")  # the last that comes, far below
    page.wait_for_timeout(500)
    assert len(page.evaluate("window.places")) == 1


PLACES = """
(function () {
  const shown = ["#sensor", "#verdict", "#way", "#tiles", "#measured h2", "#main"];
  let last = "";
  (function watch() {
    const bench = document.querySelector("#bench");
    if (bench && bench.clientWidth) {
      const tops = shown.map((place) => document.querySelector(place)?.getBoundingClientRect().y);
      const chart = document.querySelector("#main svg")?.getBoundingClientRect().height ?? null;
      const told = JSON.stringify([tops, chart, Boolean(document.querySelector("#early"))]);
      if (told !== last) { last = told; window.tellPlaces(told); }
    }
    requestAnimationFrame(watch);
  })();
  new PerformanceObserver((list) => list.getEntries().forEach((entry) => {
    const moved = entry.sources.map((one) => one.node?.id || one.node?.nodeName);
    window.tellShift(entry.value, moved);
  })).observe({ type: "layout-shift", buffered: true });
})();
"""


@pytest.mark.parametrize("width", [1360, 390])
def test_nothing_moves_from_the_first_page_to_the_verdict(page, project, width):
    places, shifts = [], []
    page.set_viewport_size({"width": width, "height": 1000})
    page.expose_function("tellPlaces", lambda told: places.append(json.loads(told)))
    page.expose_function("tellShift", lambda value, moved: shifts.append((value, moved)))
    page.add_init_script(PLACES)
    process, url = start(project)
    try:
        page.goto(url)
        page.wait_for_selector(DRAWN)
        page.wait_for_selector("#verdict-sentence")
        page.wait_for_timeout(1500)
    finally:
        process.send_signal(signal.SIGINT)
        assert process.wait(60) == 0
    assert {early for _, _, early in places} == {True, False}
    assert len({json.dumps(tops) for tops, _, _ in places}) == 1, places
    assert len({height for _, height, _ in places if height}) == 1, places
    assert shifts == []
