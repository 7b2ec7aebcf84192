"""What stands above the chart is there before it: a chart never moves under the pointer."""

from tests.workbench.pages import open_page, wait_for_job

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
