"""One number, one place: what page, report, terminal and JSON say of the same project, compared.

python -m benchmarks.bench_numbers [--quick]

The projects are simulated: sensors of one output and of up to six, in several units, with and
without hidden effects, test logs, a dwell and firmware. Each number is held against the JSON of the
command that finds it, digit by digit as it is written; and quantities that two commands tell are
held against each other, bit by bit.
"""

import json
import os
import re
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from tests.loop.conftest import write_project

from benchmarks.shown_tables import (
    ShownTable,
    list_annex,
    list_page,
    list_report,
    list_terminal,
    read_text,
)
from zerodrift.base.records import from_json
from zerodrift.diagnosis.diagnosis import write_probability
from zerodrift.report.findings import Findings
from zerodrift.report.report import render_report
from zerodrift.report.results import AddResult, CompareResult, DiagnoseResult
from zerodrift.tasks.project import ProjectFolder
from zerodrift.tasks.survey import SurveyRequest, survey
from zerodrift.workbench import panels, views

QUICK = 5
TAUS_S = (60.0, 20.0, 150.0, 40.0, 90.0)
LISTED = 8
"""Candidates that the terminal lists."""
CARDS = 4
"""Candidates that the page tells in full."""


@dataclass(frozen=True)
class Case:
    """A project."""

    seed: int = 0
    told: str = "zero_tempco"
    hidden: str = ""
    test: str = "none"
    dwell: bool = True
    runs: int = 5
    outputs: tuple[str, ...] = ()
    """Of the six-axis sensor; empty: the sensor of one output in `tests.loop`."""
    units: Mapping[str, str] | None = None
    """Unit of the simulation -> what the project calls it."""
    firmware: bool = False


SIX = ("Fx", "Fy", "Fz", "Mx", "My", "Mz")
CASES = (
    Case(0, firmware=True),
    Case(1, hidden="thermal_lag", outputs=("Fz",), test="walking", firmware=True),
    Case(2, hidden="creep", outputs=("Fx", "Mz"), test="chamber,walking"),
    Case(3, hidden="none", outputs=SIX, firmware=True),
    Case(4, dwell=False, runs=6),
    Case(5, hidden="thermal_lag", outputs=SIX, dwell=False),
    Case(6, hidden="humidity", outputs=("Mx", "My"), units={"Nm": "mV"}, test="heating"),
    Case(7, hidden="supply_sensitivity", outputs=("Fy",), units={"N": "ppm"}, runs=7),
    Case(8, told="none", hidden="none", outputs=("Fz",), test="cooling", dwell=False),
    Case(9, told="none", hidden="thermal_lag", outputs=("Fx", "Fy", "Fz"), runs=6),
    Case(10, runs=4),
    Case(11, hidden="thermal_gradient", outputs=SIX, test="walking,cooling", firmware=True),
    Case(12, hidden="dark_current", outputs=("Fz", "Mz"), units={"N": "kg"}),
    Case(13, hidden="thermal_hysteresis", outputs=("Fz",), test="chamber", runs=8),
    Case(14, dwell=False, runs=7),
    Case(15, told="zero_tempco", hidden="ambient_light", outputs=("Fx", "Fy"), dwell=False),
    Case(16, hidden="none", outputs=("Mz",), test="heating,cooling", firmware=True),
    Case(17, hidden="thermal_lag", outputs=("Fx", "Mx"), units={"N": "nT", "Nm": "uV"}),
    Case(18, hidden="ageing", outputs=("Fy", "Fz"), test="walking", dwell=False),
    Case(19, runs=5, dwell=False, firmware=True),
)


@dataclass(frozen=True)
class ShownNumber:
    """A number where it is shown."""

    where: str
    """page | report | terminal | JSON."""
    what: str
    expected: str
    """As the JSON has it, written with the digits of the surface."""
    found: str
    """What is shown there; empty where it is not shown at all."""

    @property
    def differs(self) -> bool:
        """Whether something else is shown."""
        return self.expected != self.found.replace("−", "-")


def ask(directory: Path, *arguments: str) -> str:
    """Return what a command prints, in lines that are not broken."""
    command = [sys.executable, "-m", "zerodrift", *arguments, "-C", str(directory)]
    surroundings = os.environ | {"COLUMNS": "400"}
    done = subprocess.run(command, check=True, capture_output=True, text=True, env=surroundings)
    return done.stdout


def list_numbers(directory: Path) -> Iterator[ShownNumber]:
    """Yield every number that is compared, where it is shown."""
    compared = from_json(CompareResult, json.loads(ask(directory, "compare", "--json")))
    diagnosed = from_json(DiagnoseResult, json.loads(ask(directory, "diagnose", "--json")))
    findings = survey(SurveyRequest(ProjectFolder(directory)))
    report = render_report(findings)
    page = [
        *panels.show_tiles(findings),
        *panels.show_errors(findings),
        *panels.show_segments(findings),
        *panels.show_verdict(findings, diagnosing=False, hides=False)[1],
        *panels.show_candidates(findings, ()),
        *views.show_firmware(findings),
    ]
    terminal = {name: ask(directory, name) for name in ("compare", "diagnose")}
    tables = {
        "terminal": list_terminal(terminal["compare"]) + list_terminal(terminal["diagnose"]),
        "page": list_page(page),
        "report": list_report(report) + list_annex(report),
    }
    texts = {
        "terminal": terminal["diagnose"],
        "page": read_text(page),
        "report": read_text(report),
    }
    yield from _check_between(compared, diagnosed)
    for where, shown in tables.items():
        yield from _check_errors(where, shown, compared)
        yield from _check_candidates(where, shown, diagnosed)
    yield from _check_output_errors(tables["terminal"], diagnosed)
    for where, text in texts.items():
        yield from _check_verdict(where, text, diagnosed)
    yield from _check_cards(texts, diagnosed)
    yield from _check_tiles(texts, compared, diagnosed, findings)
    if diagnosed.effect is not None:
        yield from _check_added(directory, compared, diagnosed)


def _check_added(
    directory: Path, compared: CompareResult, diagnosed: DiagnoseResult
) -> Iterator[ShownNumber]:
    """Yield what `diagnose` promises of the effect that it names, and what `add` finds."""
    assert diagnosed.effect is not None
    added = from_json(
        AddResult, json.loads(ask(directory, "add", diagnosed.effect, "--force", "--json"))
    )
    again = from_json(
        CompareResult, json.loads(ask(directory, "compare", "--model", "physics", "--json"))
    )
    for name, told in compared.outputs.items():
        now = again.outputs[name]
        pairs = [("floor", told.noise_floor, added.noise_floor[name])]
        output = diagnosed.outputs[name]
        assert added.before.rmse_left_out is not None and added.after.rmse_left_out is not None
        now_left_out = added.after.rmse_left_out[name]
        pairs += [
            ("left out before", output.rmse_left_out, added.before.rmse_left_out[name]),
            ("left out, promised", output.rmse_left_out_after, now_left_out),
        ]
        if now.rmse_left_out is not None:
            pairs.append(("left out after", now.rmse_left_out, now_left_out))
        if added.before.rmse_test is not None and added.after.rmse_test is not None:
            pairs += [
                ("test before", told.rmse_test, added.before.rmse_test[name]),
                ("test after", now.rmse_test, added.after.rmse_test[name]),
            ]
        for what, one, two in pairs:
            yield ShownNumber("JSON", f"{what} of {name}, add", repr(one), repr(two))


def _write(value: float | None, digits: int = 4) -> str:
    return "–" if value is None else f"{value:.{digits}g}"


def _check_between(compared: CompareResult, diagnosed: DiagnoseResult) -> Iterator[ShownNumber]:
    """Yield what `compare` and `diagnose` both tell."""
    for name, told in compared.outputs.items():
        other = diagnosed.outputs[name]
        pairs = [("noise floor", told.noise_floor, other.noise_floor)]
        if told.rmse_left_out is not None:
            pairs.append(("RMSE left out", told.rmse_left_out, other.rmse_left_out))
        for what, one, two in pairs:
            yield ShownNumber("JSON", f"{what} of {name}, diagnose", repr(one), repr(two))
    told = next(iter(compared.outputs.values()))
    if len(compared.outputs) == 1 and told.rmse_left_out is not None:
        ratio = f"{told.rmse_left_out / told.noise_floor:.2f}"
        over = f"{diagnosed.floor_ratio_before:.2f}"
        yield ShownNumber("JSON", "error over the floor, diagnose", ratio, over)


def _check_errors(
    where: str, shown: list[ShownTable], compared: CompareResult
) -> Iterator[ShownNumber]:
    """Yield errors per output and per run, the worst segments, and uncertainties."""
    is_terminal = where == "terminal"
    title = "RMSE per output" if is_terminal else "Errors per output"
    outputs = next(table for table in shown if table.title == title)
    runs = next(table for table in shown if table.title == "RMSE per run")
    if is_terminal:
        error_column, largest, ratio = "held out", 4, "x floor"
    else:
        error_column = next(h for h in outputs.headings if h.startswith("RMSE, "))
        largest, ratio = 3, "× floor"
        source = "test logs" if next(iter(compared.outputs.values())).rmse_test is not None else ""
        if source:
            yield ShownNumber(where, "where errors are told", f"RMSE, {source}", error_column)
    for name, told in compared.outputs.items():
        error = next(x for x in (told.rmse_test, told.rmse_left_out, told.rmse) if x is not None)
        wanted = {
            "uncompensated": _write(told.rmse_uncompensated),
            error_column: _write(error),
            "noise floor": _write(told.noise_floor),
            ("largest" if is_terminal else "largest error"): _write(told.max_abs, largest),
            ("% FS" if is_terminal else "%FS"): _write(told.rmse_pct_fs, 3),
            ratio: f"{error / told.noise_floor:.2f}" if told.noise_floor > 0.0 else "–",
        }
        for heading, expected in wanted.items():
            found = outputs.find(name, heading)
            yield ShownNumber(where, f"{heading} of {name}", expected, found)
        for run, errors in compared.runs.items():
            gap = " " if is_terminal else ", "
            heading = f"{name}{gap}{told.unit}"
            found = runs.find(run, heading)
            wanted_rmse = _write(getattr(errors, "errors", errors)[name].rmse)
            yield ShownNumber(where, f"RMSE of {name} in {run}", wanted_rmse, found)
    for name, stated in (compared.uncertainty or {}).items():
        table = next((t for t in shown if t.title.startswith("Uncertainty of a comp")), None)
        found = "" if table is None else table.find(name, "expanded, k = 2")
        yield ShownNumber(where, f"uncertainty of {name}", _write(stated.expanded, 2), found)


def _check_candidates(
    where: str, shown: list[ShownTable], diagnosed: DiagnoseResult
) -> Iterator[ShownNumber]:
    """Yield gain, probability, p and excitation of the candidates in a table."""
    is_terminal = where == "terminal"
    title = "Effects that the model lacks" if is_terminal else "Effects that are not in"
    title = "candidates.csv" if where == "report" else title
    table = next((table for table in shown if table.title.startswith(title)), None)
    listed = diagnosed.candidates[:LISTED] if is_terminal else diagnosed.candidates
    for one in listed:
        ratio = one.rmse_left_out_ratio
        gain = f"{100.0 * ratio:.1f} %" if is_terminal else f"{ratio:.3f}"
        # From the right: fitted values may be empty, and a terminal shows no empty cell.
        wanted = (
            gain,
            write_probability(one.probability),
            f"{one.p_value:.2g}",
            f"{100.0 * one.excitation:.0f} %",
        )
        row = () if table is None else table.find_row(one.effect)
        names = ("gain", "probability", "p", "excitation")
        for what, expected, found in zip(names, wanted, row[-4:] or ("",) * 4, strict=True):
            yield ShownNumber(where, f"{what} of {one.effect}", expected, found)


def _check_output_errors(
    shown: list[ShownTable], diagnosed: DiagnoseResult
) -> Iterator[ShownNumber]:
    table = next(table for table in shown if table.title == "Error in runs left out")
    for name, told in diagnosed.outputs.items():
        found = table.find_row(name)
        wanted = [told.rmse_left_out, told.noise_floor]
        if told.rmse_left_out_after is not None:
            wanted.insert(1, told.rmse_left_out_after)
        cells = found[-len(wanted) :] or ("",) * len(wanted)
        for expected, cell in zip(wanted, cells, strict=True):
            yield ShownNumber("terminal", f"left out of {name}", _write(expected), cell)


def _check_verdict(where: str, text: str, diagnosed: DiagnoseResult) -> Iterator[ShownNumber]:
    """Yield the error over the floor, before and after, as the verdict's sentence has it."""
    sentence = " ".join(text.split())
    before = f"{diagnosed.floor_ratio_before:.2f}"
    if diagnosed.verdict != "missing":
        found = re.search(r"(\S+) times the noise floor", sentence)
        yield ShownNumber(where, "error over the floor", before, found.group(1) if found else "")
        return
    pattern = r"falls from (\S+) to (\S+) times the noise floor"
    if where == "terminal":
        pattern = r"(\S+) times the noise floor(?: \(estimated\))? now, (\S+) times with it"
    match = re.search(pattern, sentence)
    cells = match.groups() if match else ("", "")
    after = f"{diagnosed.floor_ratio_after:.2f}"
    yield ShownNumber(where, "error over the floor", before, cells[0])
    yield ShownNumber(where, "error over the floor with it", after, cells[1])
    if diagnosed.lookalikes:
        return
    chosen = next(c for c in diagnosed.candidates if c.effect == diagnosed.effect)
    likely = write_probability(chosen.probability)
    told = re.search(r"(?:MISSING|The model lacks)[^;.]*?((?:[<>] )?\d+ %)", sentence)
    yield ShownNumber(where, "probability in the verdict", likely, told.group(1) if told else "")


def _check_cards(texts: Mapping[str, str], diagnosed: DiagnoseResult) -> Iterator[ShownNumber]:
    """Yield the gain of each candidate that page and report explain in words."""
    for where in ("page", "report"):
        text = " ".join(texts[where].split())
        for one in diagnosed.candidates[:CARDS]:
            expected = f"{100.0 * one.rmse_left_out_ratio:.1f} %"
            others = "|".join(c.effect for c in diagnosed.candidates if c is not one) or "-"
            match = re.search(
                rf"\b{one.effect}\b(?:(?!\b(?:{others})\b).)*?with it (\S+ %) of the held-out RMSE",
                text,
            )
            found = match.group(1) if match else ""
            yield ShownNumber(where, f"gain of {one.effect} in words", expected, found)


def _check_tiles(
    texts: Mapping[str, str],
    compared: CompareResult,
    diagnosed: DiagnoseResult,
    findings: Findings,
) -> Iterator[ShownNumber]:
    worst = max(told.rmse_pct_fs for told in compared.outputs.values())
    least = min(told.explained for told in compared.outputs.values())
    wanted = {
        r"(\S+) %FS\s+largest RMSE": f"{worst:.2g}",
        r"(\S+) %\s+explained in the worst output": f"{100.0 * least:.1f}",
        r"(\S+) ×\s+error of the effects on runs left out": f"{diagnosed.floor_ratio_before:.2f}",
        r"(\d+)\s+runs shown": str(len(findings.traces)),
    }
    for where in ("page", "report"):
        for pattern, expected in wanted.items():
            match = re.search(pattern, texts[where])
            yield ShownNumber(where, f"tile {pattern}", expected, match.group(1) if match else "")


def write_case(directory: Path, number: int) -> None:
    """Write one of the projects."""
    case = CASES[number]
    if not case.outputs:
        tau_s = TAUS_S[number % len(TAUS_S)] * (1.0 + 0.1 * (number // len(TAUS_S)))
        write_project(directory, runs=case.runs, dwell=case.dwell, tau_s=tau_s)
    else:
        words = ["--runs", str(case.runs), "--told", case.told, "--seed", str(case.seed)]
        words += ["--hidden", case.hidden] if case.hidden not in ("", "none") else []
        words += ["--test", case.test, "--duration", "900", "--period", "2"]
        words += [] if case.dwell else ["--no-dwell"]
        ask(directory, "twin", *words, "--force")
        _keep(directory / "zerodrift.toml", case)
    if case.firmware:
        ask(directory, "firmware", "--force")


def _keep(toml: Path, case: Case) -> None:
    """Keep some of the outputs, in other units."""
    text = toml.read_text(encoding="utf-8")
    for name in set(SIX) - set(case.outputs):
        text = re.sub(rf"\[outputs\.{name}\]\n(?:.+\n)+\n", "", text)
    for old, new in (case.units or {}).items():
        text = text.replace(f'unit = "{old}"', f'unit = "{new}"')
    toml.write_text(text, encoding="utf-8")


def main(quick: bool) -> None:
    """Print how many numbers were compared, and those that differ."""
    count = QUICK if quick else len(CASES)
    total, wrong = 0, 0
    for number in range(count):
        with tempfile.TemporaryDirectory() as name:
            directory = Path(name)
            write_case(directory, number)
            shown = list(list_numbers(directory))
        total += len(shown)
        for one in shown:
            if one.differs:
                wrong += 1
                told = f"{one.where}, {one.what}: {one.found!r}, not {one.expected!r}"
                print(f"project {number}: {told}", flush=True)
    print(f"{count} projects, {total} numbers on terminal, page and report: {wrong} differ")


if __name__ == "__main__":
    main("--quick" in sys.argv)
