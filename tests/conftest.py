"""What tests of every folder use."""

import json
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import pytest
from hypothesis import HealthCheck, settings

from tests.schemas import validate
from zerodrift.base.threads import use_one_thread

use_one_thread()
# a machine that is busy with other things is no failure
settings.register_profile("busy", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("busy")

PARAM = type(pytest.param())


def pytest_addoption(parser: pytest.Parser) -> None:
    """Let CI run a part of the long tests."""
    parser.addoption("--share", default="1/1", help="K/N: of every N tests the K-th alone")


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Leave out what is not of the share that was asked for."""
    place, count = map(int, config.getoption("--share").split("/"))
    left = [item for i, item in enumerate(items) if i % count != place - 1]
    if left:
        config.hook.pytest_deselected(items=left)
        items[:] = items[place - 1 :: count]


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """Parametrize by `spread(SHORT, NAMES, CASES)`: all but SHORT cases, spread, are long."""
    for mark in metafunc.definition.iter_markers("spread"):
        short, names, cases = mark.args
        alone = isinstance(names, str) and "," not in names
        sets = [c if isinstance(c, PARAM) else pytest.param(*([c] if alone else c)) for c in cases]
        free = [i for i, case in enumerate(sets) if not case.marks]
        kept = {free[i * len(free) // short] for i in range(short) if free}
        for i in set(free) - kept:
            sets[i] = pytest.param(*sets[i].values, marks=pytest.mark.long, id=sets[i].id)
        metafunc.parametrize(names, sets, **mark.kwargs)


@dataclass(frozen=True)
class Result:
    """What a command left behind."""

    code: int
    out: str
    err: str


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Say how many tests ran on QEMU's boards, and why the others did not."""
    found = {
        outcome: [
            report
            for report in terminalreporter.stats.get(outcome, [])
            if "board" in getattr(report, "keywords", ())
        ]
        for outcome in ("passed", "failed", "error", "skipped")
    }
    count = {outcome: len(reports) for outcome, reports in found.items()}
    if not any(count.values()):
        return
    ran = count["passed"] + count["failed"] + count["error"]
    reasons = sorted(
        {str(report.longrepr[2]).removeprefix("Skipped: ") for report in found["skipped"]}
    )
    told = f"boards: {ran} tests ran on QEMU, {ran - count['passed']} of them failed"
    if reasons:
        told += f"; {count['skipped']} did not run: {'; '.join(reasons)}"
    terminalreporter.write_line(told)


@pytest.fixture(autouse=True, scope="session")
def _own_configuration(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Keep what the commands remember of this user's agreements away from the user's own."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CONFIG_HOME", str(tmp_path_factory.mktemp("config")))
        yield


@pytest.fixture
def zerodrift(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> Callable[..., Result]:
    """Return a function that runs the command line in this process, as a shell would."""
    from zerodrift.cli.main import main

    def run(*arguments: object) -> Result:
        monkeypatch.setattr(sys, "argv", ["zerodrift", *map(str, arguments)])
        code = 0
        try:
            main()
        except SystemExit as end:
            code = int(end.code or 0)
        captured = capsys.readouterr()
        if "--json" in arguments and captured.out.startswith("{"):
            record = json.loads(captured.out)
            if "schema" in record:  # the laboratory's commands have none
                validate(record)
        return Result(code, captured.out, captured.err)

    return run
