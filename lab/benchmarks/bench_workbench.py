"""The page's marks: first page, ready, interactions, cause, axe; the report's time and size.

python -m benchmarks.bench_workbench [--quick]

Logs are simulated: `zerodrift twin` writes the 11-run project; the long one is written here. Needs
`make setup-browser`.
"""

import json
import os
import re
import resource
import shutil
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np
import polars

from benchmarks.page_marks import CASES, count_faults, list_marks, measure_first, see_cause
from zerodrift.base.records import to_dict
from zerodrift.workbench.chart import draw_wish
from zerodrift.workbench.jobs import DIAGNOSED, EVENT_MARK
from zerodrift.workbench.server import Workbench
from zerodrift.workbench.state import PictureWish
from zerodrift.workbench.workplace import CHILD

DRAWN = "#main .sheet svg .line"
TWIN = ("twin", "--runs", "6", "--told", "zero_tempco", "--hidden", "thermal_lag", "--seed", "3")
TOML = """\
# SIMULATED
[sensor]
name = "long"
time = "time_s"
temperature = "temperature_degC"
sample_period_s = 1.0
[outputs.Fz]
measured = "Fz_N"
reference = "ref_Fz_N"
unit = "N"
full_scale = 200
[logs]
train = ["logs/*.parquet"]
[[effect]]
kind = "zero_tempco"
"""
ZOOMS = 12
TRUTH = "truth.json"
"""What the twin hid; without it a project is no practice case."""
TWELVE = ("twin", "--runs", "12", "--told", "zero_tempco", "--hidden", "thermal_lag", "--seed", "3")
BEFORE = {
    "html_bytes": 6_876_457,
    "pdf_pages": 76,
    "with the diagnosis": {"cpu_s": 10.1},
    "diagnosis kept": {"cpu_s": 7.5},
    "printed": {"cpu_s": 10.6},
}
"""Of `TWELVE` at commit 8b89d2d on two cores of an x86-64 machine that did other things, too."""
ASK = """(wish) => new Promise((resolve) => {
  const main = document.getElementById('main'), begun = performance.now();
  const observer = new MutationObserver(() => {
    observer.disconnect();
    resolve(performance.now() - begun);
  });
  observer.observe(main, { attributes: true, attributeFilter: ['data-drawn'] });
  window.zd.wish(wish);
})"""
"""Asks for a picture as the page's lists do; resolves with the milliseconds until it is there."""


def keep_bytecode(folder: Path) -> None:
    """Have every process keep its compiled modules there, as those of an installed package are."""
    os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
    os.environ["PYTHONPYCACHEPREFIX"] = str(folder)


def run_command(*arguments: str) -> dict[str, float]:
    """Return the seconds that a command takes, its process included: by the clock, and of CPU."""
    begun, used = time.perf_counter(), resource.getrusage(resource.RUSAGE_CHILDREN)
    command = [sys.executable, "-m", "zerodrift", *arguments]
    subprocess.run(command, check=True, capture_output=True)
    now = resource.getrusage(resource.RUSAGE_CHILDREN)
    cpu_s = now.ru_utime + now.ru_stime - used.ru_utime - used.ru_stime
    return {"wall_s": time.perf_counter() - begun, "cpu_s": cpu_s}


def write_long(directory: Path, rows: int, runs: int = 8) -> None:
    """Write a project of so many rows in all, whose sensor lags its thermometer."""
    from zerodrift.operations.lowpass import lowpass

    (directory / "logs").mkdir(parents=True)
    (directory / "zerodrift.toml").write_text(TOML)
    count = rows // runs
    time_s = np.arange(count, dtype=np.float64)
    for number in range(runs):
        rng = np.random.default_rng(number)
        knots = rng.uniform(0.0, 50.0, max(count // 2000, 4))
        temperature = np.interp(time_s, np.linspace(0.0, count, knots.size), knots)
        load = np.repeat(20.0 * rng.integers(0, 4, -(-count // 500)), 500)[:count]
        drift = 0.2 * lowpass(temperature, 1.0, 60.0) + 0.05 * rng.standard_normal(count)
        columns = {
            "time_s": time_s,
            "temperature_degC": temperature,
            "Fz_N": load + drift,
            "ref_Fz_N": load,
        }
        polars.DataFrame(columns).write_parquet(directory / "logs" / f"run_{number}.parquet")


def look(bench: Workbench, *, diagnoses: bool, timeout_s: float = 1800.0) -> dict[str, float]:
    """Return the seconds until the findings, and where wanted until the verdict, are there."""
    begun = time.perf_counter()
    found: dict[str, float] = {}
    while time.perf_counter() - begun < timeout_s:
        findings, job = bench.place.findings, bench.place.job
        if findings is not None:
            found.setdefault("surveyed_s", time.perf_counter() - begun)
            if not diagnoses:
                return found
            if findings.diagnosed is not None:
                found.setdefault("diagnosed_s", time.perf_counter() - begun)
                return found
        if job is not None and not job.running:
            raise SystemExit(f"the survey failed: {bench.place.message}")
        time.sleep(0.02)
    raise SystemExit(f"no verdict within {timeout_s:g} s: {found}")


def diagnose_as_the_page_does(directory: Path) -> dict[str, float]:
    """Return the seconds until the page's own process tells the verdict: by the clock, of CPU."""
    kept = directory / "build" / "diagnosis.json"
    kept.unlink(missing_ok=True)
    with tempfile.TemporaryDirectory() as result:
        begun = time.perf_counter()
        command = [sys.executable, "-P", "-m", CHILD, "diagnose", str(directory), result]
        with subprocess.Popen(
            command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
        ) as process:
            assert process.stdout is not None
            for line in process.stdout:
                if line.strip() == EVENT_MARK + DIAGNOSED:
                    wall_s, cpu_s = time.perf_counter() - begun, read_cpu(process.pid)
                    process.kill()  # what it would draw next is no part of the verdict
                    return {"wall_s": wall_s, "cpu_s": cpu_s}
    raise SystemExit("the page's process told no verdict")


def read_cpu(pid: int) -> float:
    """Return the CPU seconds that a process has used so far."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def compare_diagnoses(directory: Path, times: int) -> dict[str, Any]:
    """Return the seconds of `diagnose` and of the page's diagnosis, in turns, and their ratio."""
    command, page = [], []
    for _ in range(times):
        command.append(run_command("diagnose", "-C", str(directory), "--json"))
        page.append(diagnose_as_the_page_does(directory))
    used = [float(np.median([told["cpu_s"] for told in told_of])) for told_of in (command, page)]
    return {"command": command, "page": page, "page_over_command_cpu": used[1] / used[0]}


def measure_page(bench: Workbench, browser: Any) -> dict[str, float]:
    """Return seconds to a ready page, and milliseconds of interactions, by the clock, worst last.

    Of the ready page also the CPU seconds, the server's and those of the page's main thread, since
    a busy machine makes the clock's longer.
    """
    page = browser.new_page(viewport={"width": 1360, "height": 1000})
    page.set_default_timeout(60_000)
    metrics = page.context.new_cdp_session(page)
    metrics.send("Performance.enable", {"timeDomain": "threadTicks"})
    begun, used = time.perf_counter(), time.process_time()
    page.goto(bench.url)
    page.wait_for_selector(DRAWN)
    ready_s, server_s = time.perf_counter() - begun, time.process_time() - used
    told = {m["name"]: m["value"] for m in metrics.send("Performance.getMetrics")["metrics"]}
    page.wait_for_timeout(1500)
    findings = bench.place.findings
    assert findings is not None
    runs = [trace.run for trace in findings.traces]
    rng = np.random.default_rng(0)
    took: dict[str, list[float]] = {"zoom": [], "driver": [], "mark": []}
    for number in range(ZOOMS):
        first, last = (float(findings.find_trace(runs[0]).time_s[i]) for i in (0, -1))
        width = (last - first) * 10.0 ** rng.uniform(-2.0, -0.2)
        low = rng.uniform(first, last - width)
        wish = {"run": runs[0], "from_s": low, "to_s": low + width}
        took["zoom"].append(page.evaluate(ASK, wish))
        form = ("value", "rate", "lag")[number % 3]
        wish = {"run": runs[number % len(runs)], "against": f"{form}:{60 + number}:temperature"}
        took["driver"].append(page.evaluate(ASK, wish))
    for number in range(ZOOMS):
        # The chart may lie below the window, and moves with the length of the verdict above it.
        page.locator("#main svg").evaluate("chart => chart.scrollIntoView({behavior: 'instant'})")
        box = page.locator("#main svg").bounding_box()
        page.wait_for_selector("#main .over .mark", state="detached")
        x = box["x"] + 90.0 + 20.0 * number
        page.mouse.move(x, box["y"] + 60.0)
        page.mouse.down()
        begun = time.perf_counter()
        page.mouse.move(x + 100.0, box["y"] + 60.0)
        page.wait_for_selector("#main .over .mark", state="attached")
        took["mark"].append(1000.0 * (time.perf_counter() - begun))
        page.mouse.up()
        page.keyboard.press("Escape")
    page.close()
    found = {"page_ready_s": ready_s, "page_ready_cpu_s": server_s + told["TaskDuration"]}
    for name, values in took.items():
        found[f"{name}_ms"] = float(np.median(values))
        found[f"{name}_ms_worst"] = float(np.max(values))
    return found


def measure_zoom(bench: Workbench) -> float:
    """Return the median CPU milliseconds of drawing one part of a run, as the page gets it."""
    findings = bench.place.findings
    assert findings is not None
    trace = findings.traces[0]
    rng, first, last = np.random.default_rng(0), float(trace.time_s[0]), float(trace.time_s[-1])
    used = []
    for _ in range(ZOOMS):
        width = (last - first) * 10.0 ** rng.uniform(-2.0, -0.2)
        low = rng.uniform(first, last - width)
        begun = time.thread_time()
        wish = PictureWish(run=trace.run, from_s=low, to_s=low + width)
        json.dumps(to_dict(draw_wish(bench.place, wish, hides=False)))
        used.append(1000.0 * (time.thread_time() - begun))
    return float(np.median(used))


def count_pages(path: Path) -> int:
    """Return the pages of a PDF as Chromium writes it."""
    return len(re.findall(rb"/Type\s*/Page[^s]", path.read_bytes()))


def measure_report(directory: Path) -> dict[str, object]:
    """Return what the report of 12 training runs and 6 outputs takes, and how large it is.

    `before` is what the last version with Plotly in the report took of these very logs.
    """
    run_command(*TWELVE, "-C", str(directory))
    told: dict[str, object] = {"before": BEFORE}
    told["with the diagnosis"] = run_command("report", "-C", str(directory))
    told["diagnosis kept"] = run_command("report", "-C", str(directory))
    told["html_bytes"] = (directory / "report.html").stat().st_size
    told["printed"] = run_command("report", "--format", "pdf", "-C", str(directory))
    told["pdf_pages"] = count_pages(directory / "report.pdf")
    return told


def measure(directory: Path, browser: Any, *, diagnoses: bool = True) -> dict[str, Any]:
    """Return the marks of one project; with `diagnoses`, the time to the verdict too."""
    first = measure_first(directory, browser)
    bench = Workbench(directory)
    thread = threading.Thread(target=bench.serve, daemon=True)
    thread.start()
    try:
        found = look(bench, diagnoses=diagnoses)
        if not diagnoses:
            bench.place.cancel()
        marks: dict[str, Any] = {**first, **found, **measure_page(bench, browser)}
        marks["zoom_cpu_ms"] = measure_zoom(bench)
        if diagnoses:
            marks["axe"] = count_faults(bench, browser)
        return marks
    finally:
        bench.stop()
        thread.join(10.0)


def measure_cause(directory: Path, browser: Any, hidden: str) -> dict[str, object]:
    """Return clicks and seconds from the verdict to its cause, on logs with an effect hidden."""
    run_command(*TWIN[:5], "--hidden", hidden, "--seed", "3", "-C", str(directory))
    (directory / TRUTH).unlink()  # else the page asks for a guess before it tells the verdict
    bench = Workbench(directory)
    thread = threading.Thread(target=bench.serve, daemon=True)
    thread.start()
    try:
        look(bench, diagnoses=True)
        return see_cause(bench, browser, hidden)
    finally:
        bench.stop()
        thread.join(10.0)


def main(quick: bool) -> None:
    """Print the marks as JSON.

    Args:
        quick: leaves the ten million rows out.
    """
    from playwright.sync_api import sync_playwright

    told: dict[str, Any] = {"cpus": os.cpu_count(), "load_before": os.getloadavg()[0]}
    path = shutil.which("chromium") or shutil.which("google-chrome")
    options = ["--no-sandbox"] if os.geteuid() == 0 else []
    with tempfile.TemporaryDirectory() as name, sync_playwright() as driver:
        keep_bytecode(Path(name) / "bytecode")
        browser = driver.chromium.launch(executable_path=path, args=options)
        for case, hidden in CASES.items():
            told[case] = measure_cause(Path(name) / case, browser, hidden)
        eleven = Path(name) / "eleven"
        run_command(*TWIN, "-C", str(eleven))
        (eleven / TRUTH).unlink()
        told["report"] = measure_report(Path(name) / "twelve")
        told["diagnose"] = compare_diagnoses(eleven, 2 if quick else 5)
        told["eleven runs"] = measure(eleven, browser)
        print(json.dumps(told), file=sys.stderr, flush=True)
        for rows in (400_000,) if quick else (400_000, 10_000_000):
            directory = Path(name) / str(rows)
            write_long(directory, rows)
            told[f"{rows} rows"] = measure(directory, browser, diagnoses=rows < 1_000_000)
            print(f"{rows} rows: done", file=sys.stderr, flush=True)
            shutil.rmtree(directory)
        browser.close()
    marks = list_marks(told)
    for mark in marks:
        sign = "met" if mark.met else "MISSED"
        words = f"{mark.name:15} {mark.value:8.3g}  of {mark.limit:g}  {sign:6}  {mark.of}"
        print(words, file=sys.stderr, flush=True)
    told["marks"] = [{**vars(mark), "met": mark.met} for mark in marks]
    print(json.dumps(told, indent=1))


if __name__ == "__main__":
    main("--quick" in sys.argv)
