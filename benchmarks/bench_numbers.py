"""One number, one place: what page, report, terminal and JSON say of the same project, compared.

python -m benchmarks.bench_numbers [--quick]

Each project is simulated (`tests.loop.conftest.write_project`): other lags, other numbers of runs,
with and without a dwell. A number is held against the JSON of the command that finds it, digit by
digit as it is written.
"""

import html
import json
import re
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from tests.loop.conftest import write_project

from zerodrift.app.commands.survey import survey_project
from zerodrift.base.records import from_json
from zerodrift.report.findings import Findings
from zerodrift.report.report import render_report
from zerodrift.report.results import CompareResult, DiagnoseResult
from zerodrift.report.tables import write_number
from zerodrift.report.verdict import write_headline
from zerodrift.workbench import panels, verdicts

PROJECTS, QUICK = 20, 5
TAUS_S = (60.0, 20.0, 150.0, 40.0, 90.0)


@dataclass(frozen=True)
class ShownNumber:
    """A number where it is shown."""

    where: str
    """page | report | terminal."""
    what: str
    expected: str
    """As the JSON has it, written with the digits of the surface."""
    row: str
    """What is shown there."""

    @property
    def differs(self) -> bool:
        """Whether the number is not among what is shown."""
        return self.expected not in re.split(r"[\s|]+", self.row)


def ask(directory: Path, *arguments: str) -> str:
    """Return what a command prints."""
    command = [sys.executable, "-m", "zerodrift", *arguments, "-C", str(directory)]
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout


def list_numbers(directory: Path) -> Iterator[ShownNumber]:
    """Yield every number that is compared, where it is shown."""
    compared = from_json(CompareResult, json.loads(ask(directory, "compare", "--json")))
    diagnosed = from_json(DiagnoseResult, json.loads(ask(directory, "diagnose", "--json")))
    findings = survey_project(directory)
    rows = {
        "terminal": _read_terminal(ask(directory, "compare")),
        "page": _read_page(findings),
        "report": _read_report(render_report(findings)),
    }
    for where, lines in rows.items():
        for name, told in compared.outputs.items():
            error = told.rmse if told.rmse_heldout is None else told.rmse_heldout
            row = next((line for line in lines if line.startswith(f"{name} ")), "")
            for what, value in (
                ("uncompensated", told.rmse_uncompensated),
                ("error", error),
                ("noise floor", told.noise_floor),
            ):
                yield ShownNumber(where, f"{what} of {name}", write_number(value), row)
    ratio = f"{diagnosed.floor_ratio_before:.2f}"
    assert findings.diagnosed is not None
    headline = write_headline(findings.diagnosed.diagnosis, findings.titles).sentence
    page = _read_text(verdicts.show_verdict(findings, diagnosing=False, hides=False)[1])
    for where, text in (
        ("terminal", ask(directory, "diagnose")),
        ("page", page),
        ("report", _strip(render_report(findings))),
    ):
        if where != "terminal":
            yield ShownNumber(where, "verdict", "yes", "yes" if headline in text else text[:200])
        yield ShownNumber(where, "error over the floor", ratio, text.replace(";", " "))


def _read_terminal(text: str) -> list[str]:
    table = text.partition("RMSE per run")[0]
    return [" ".join(line.split()) for line in table.splitlines()]


def _read_page(findings: Findings) -> list[str]:
    told = json.dumps(
        [part.to_plotly_json() for part in panels.show_errors(findings)],
        default=lambda part: part.to_plotly_json(),
    )
    tables = [
        json.loads(json.loads(f'"{text}"'))
        for text in re.findall(r'"data-table": "((?:[^"\\]|\\.)*)"', told)
    ]
    return [" ".join(row) for row in tables[0]["rows"]]


def _read_text(parts: object) -> str:
    return json.dumps(parts, default=lambda part: part.to_plotly_json(), ensure_ascii=False)


def _read_report(text: str) -> list[str]:
    table = text.partition("<h2>Errors</h2>")[2].partition("</table>")[0]
    rows = re.findall(r"<tr>(.*?)</tr>", table, re.DOTALL)
    return [" ".join(_strip(row).split()) for row in rows]


def _strip(text: str) -> str:
    return html.unescape(re.sub(r"<[^>]+>", " ", text))


def write_case(directory: Path, number: int) -> None:
    """Write one of the projects."""
    write_project(
        directory,
        runs=4 + number % 3,
        dwell=number % 2 == 0,
        tau_s=TAUS_S[number % len(TAUS_S)] * (1.0 + 0.1 * (number // len(TAUS_S))),
    )


def main(quick: bool) -> None:
    """Print how many numbers were compared, and those that differ."""
    count = QUICK if quick else PROJECTS
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
                told = f"{one.where}, {one.what}: {one.expected} is not in: {one.row[:160]}"
                print(f"project {number}: {told}")
    print(f"{count} projects, {total} numbers on terminal, page and report: {wrong} differ")


if __name__ == "__main__":
    main("--quick" in sys.argv)
