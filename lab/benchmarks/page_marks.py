"""Marks of the page for people: its first sight, the way to the cause, and axe's faults."""

import signal
import subprocess
import sys
import time
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

from zerodrift.workbench.server import Workbench

CASES = {"lag": "thermal_lag", "creep": "creep", "hysteresis": "load_hysteresis"}
"""Name of simulated logs -> what is hidden in them."""
LIMITS = {
    "first_page_s": 1.5,
    "first_chart_s": 2.0,
    "page_ready_s": 1.5,
    "clicks": 2,
    "cause_s": 5.0,
    "interaction_ms": 200.0,
    "axe_serious": 0,
}
"""Mark -> the most that is accepted."""
DRAWN = "#main .sheet svg .line"
FIRST = "#early, #start h2, #bench:not([hidden])"
SEEN = """(effect) => {
  const svg = document.querySelector('#main svg');
  if (!svg || !svg.textContent.includes(effect + ' would explain')) { return false; }
  const box = svg.getBoundingClientRect();
  return box.top >= 0 && box.top < window.innerHeight - 200;
}"""
"""Whether what is left is drawn with the effect's part of it, where it can be seen."""
WINDOWS = ((1360, "light"), (1360, "dark"), (390, "light"))
SEVERE = ("serious", "critical")


@dataclass(frozen=True)
class PageMark:
    """One mark."""

    name: str
    of: str
    value: float
    limit: float

    @property
    def met(self) -> bool:
        """Whether it is met."""
        return self.value <= self.limit


def measure_first(directory: Path, browser: Any) -> dict[str, float]:
    """Return seconds from the start of `zerodrift workbench` to its address, page and charts.

    The first chart is of one log alone, the full one has model, residual and channels.
    """
    page = browser.new_page(viewport={"width": 1360, "height": 1000})
    page.set_default_timeout(1_800_000)
    command = [sys.executable, "-m", "zerodrift", "workbench", "--no-browser", "-C", str(directory)]
    begun = time.perf_counter()
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            url = process.stdout.readline().rpartition(": ")[2].strip()
            address_s = time.perf_counter() - begun
            page.goto(url)
            page.wait_for_selector(FIRST)
            first_s = time.perf_counter() - begun
            page.wait_for_selector(f".sketch svg .line, {DRAWN}")
            chart_s = time.perf_counter() - begun
            page.wait_for_selector(DRAWN)
            full_s = time.perf_counter() - begun
        finally:
            page.close()
            process.send_signal(signal.SIGINT)  # its own processes end with it
            process.communicate()
    return {
        "address_s": address_s,
        "first_page_s": first_s,
        "first_chart_s": chart_s,
        "full_chart_s": full_s,
    }


def see_cause(bench: Workbench, browser: Any, hidden: str) -> dict[str, object]:
    """Return clicks and seconds from the verdict on an open page until its cause is seen.

    Seen is a cause when what is left is in the window, with the part of it that the effect would
    explain. What a user would click is clicked, one after the other, until it is so.
    """
    page = browser.new_page(viewport={"width": 1360, "height": 1000})
    page.set_default_timeout(300_000)
    page.goto(bench.url)
    page.wait_for_selector("#verdict-sentence")
    begun = time.perf_counter()
    explained = bench.place.findings.diagnosed if bench.place.findings is not None else None
    named = explained.diagnosis.effect if explained is not None else None
    clicks = 0
    if named is not None:
        page.click("nav a[href='#measured']")
        clicks += 1
        page.wait_for_function(SEEN, arg=named)
    seconds = time.perf_counter() - begun
    page.close()
    return {"hidden": hidden, "named": named or "nothing", "clicks": clicks, "cause_s": seconds}


def count_faults(bench: Workbench, browser: Any) -> dict[str, object]:
    """Return what axe finds on the page, by the window's width and theme."""
    axe = import_module("axe_playwright_python.sync_playwright").Axe()
    found: dict[str, object] = {}
    for width, scheme in WINDOWS:
        page = browser.new_page(viewport={"width": width, "height": 1000}, color_scheme=scheme)
        page.set_default_timeout(120_000)
        page.goto(bench.url)
        page.wait_for_selector("#main .sheet svg .line")
        page.wait_for_selector("#verdict-sentence")
        page.wait_for_timeout(1500)
        violations = axe.run(page).response["violations"]
        told = [
            f"{one['id']} ({one['impact']}): {len(one['nodes'])}, {one['nodes'][0]['target']}"
            for one in violations
        ]
        severe = sum(len(v["nodes"]) for v in violations if v["impact"] in SEVERE)
        found[f"{width} {scheme}"] = {"serious": severe, "all": told}
        page.close()
    return found


def list_marks(told: dict[str, Any]) -> list[PageMark]:
    """Return the marks of what the benchmark measured."""
    marks = []
    for of, measured in told.items():
        if not isinstance(measured, dict):
            continue
        names = ("first_page_s", "first_chart_s", "page_ready_s", "clicks", "cause_s")
        known = [name for name in names if name in measured]
        marks += [PageMark(name, of, measured[name], LIMITS[name]) for name in known]
        for name in ("zoom", "driver", "mark"):
            if f"{name}_ms_worst" in measured:
                worst = measured[f"{name}_ms_worst"]
                limit = LIMITS["interaction_ms"]
                marks.append(PageMark("interaction_ms", f"{of}, {name}", worst, limit))
        for window, faults in measured.get("axe", {}).items():
            limit = LIMITS["axe_serious"]
            marks.append(PageMark("axe_serious", f"{of}, {window}", faults["serious"], limit))
    return marks
