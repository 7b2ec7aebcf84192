"""What is run under faults: every command that writes, on small projects."""

import re
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from tests.faults.projects import (
    FLEET,
    TWIN,
    Run,
    prepare_added,
    prepare_block,
    prepare_codes,
    prepare_codes_of_units,
    prepare_fleet,
    prepare_formula,
    prepare_old,
    prepare_output,
    prepare_package,
    prepare_registry,
    prepare_toml,
    prepare_twin,
)


@dataclass(frozen=True)
class Scenario:
    """One command, and the project that it finds."""

    name: str
    arguments: tuple[str, ...]
    """Of zerodrift; {} stands for the project's directory."""
    prepare: Callable[[Path, Run], None]
    """Makes the project in an empty directory."""
    codes: tuple[int, ...] = (0,)
    """Exit codes without faults, also of the command done again."""
    next_command: tuple[str, ...] = ("history", "-C", "{}")
    """One that changes nothing, after which no set is mixed."""
    grows: str = ""
    """A log of which the first rows are as good as all, once `next_command` has put it right."""
    report: str = ""
    """The file that tells which units failed, where others go on and the exit code is 1."""


REPORT = ("report", "-C", "{}", "--no-diagnose")
CALIBRATE = (
    *("calibrate", "{}/codes.csv", "-C", "{}"),
    *(word for kind in ("toml", "json", "h") for word in ("--write", f"{{}}/cal.{kind}")),
)

APPLY = ("apply", "{}/logs/run_0.csv", "-C", "{}", "--out", "{}/applied.parquet")
PROPOSE = ("propose", "-C", "{}", "--write", "{}/my_effect.py")
PLAN = (
    *("plan", "-C", "{}", "--hours", "0.5", "--between", "thermal_lag", "creep", "--budget", "1"),
    *("--out", "{}/plan.csv", "--picture", "{}/plan.html"),
)
MONITOR = ("monitor", "{}/logs/run_2.csv", "-C", "{}", "--reset", "--metrics", "{}/unit.prom")
NEIGHBOUR = ("neighbour", "polynomial", "-C", "{}", "--out", "{}/polynomial.json")
ANNEX = ("report", "-C", "{}", "--no-diagnose", "--datasheet", "--annex", "{}/annex")
LIST = ("registry", "list", "-C", "{}")
RECORD = ("record", "command:cat {}/logs/run_0.csv", "-C", "{}", "--out", "{}/log.parquet")
RECOVER = ("record", "--recover", "{}/log.parquet", "-C", "{}")


SCENARIOS = (
    Scenario("init", ("init", "{}/logs", "-C", "{}", "--force"), prepare_toml),
    Scenario("add", ("add", "thermal_lag", "-C", "{}"), prepare_toml, (0, 1, 2)),
    Scenario("remove", ("remove", "thermal_lag", "-C", "{}"), prepare_added, (0, 2)),
    Scenario("train", ("train", "-C", "{}"), prepare_old(("train", "-C", "{}"))),
    Scenario("export", ("export", "-C", "{}"), prepare_old(("export", "-C", "{}"))),
    Scenario("firmware", ("firmware", "-C", "{}"), prepare_old(("firmware", "-C", "{}"))),
    Scenario("package", ("package", "cmake", "-C", "{}"), prepare_package),
    Scenario("report", REPORT, prepare_old(REPORT)),
    Scenario("history", ("history", "-C", "{}", "--html", "{}/history.html"), prepare_added),
    Scenario("calibrate", CALIBRATE, prepare_codes, next_command=CALIBRATE[:4]),
    Scenario("twin", (*TWIN, "--seed", "2", "--force"), prepare_twin),
    Scenario("fleet", FLEET, prepare_fleet, report="build/fleet/report.json"),
    Scenario("apply", APPLY, prepare_output(APPLY)),
    Scenario("propose", PROPOSE, prepare_formula, (0, 1)),
    Scenario("plan", PLAN, prepare_toml),
    Scenario("monitor", MONITOR, prepare_output(MONITOR)),
    Scenario("neighbour", NEIGHBOUR, prepare_output(NEIGHBOUR)),
    Scenario("annex", ANNEX, prepare_old(ANNEX)),
    Scenario("restore", ("history", "--restore", "0", "-C", "{}"), prepare_added, (0, 2)),
    Scenario("upgrade", ("init", "--upgrade", "-C", "{}"), prepare_codes_of_units),
    Scenario("registry", ("registry", "init", "-C", "{}"), prepare_toml, (0,), LIST),
    Scenario("unit", ("registry", "add", "SN2", "-C", "{}"), prepare_registry, (0, 2), LIST),
    Scenario("block", ("firmware", "-C", "{}"), prepare_block),
    Scenario("record", RECORD, prepare_toml, (0, 2), RECOVER, grows="log.parquet"),
)


FLEET_REPORT = "the fleet's report"
_FIRMWARE = re.compile(
    r"firmware/[^/]+|build/((model|certificate|firmware|refused)\.json|integer\.onnx|golden\.npz)"
)


def find_set(path: str) -> str:
    """Return the name of the files that are old or new together."""
    if path in ("zerodrift.toml", "build/history.json"):
        return "zerodrift.toml and its history"
    if path in ("build/compensator.json", "build/network.onnx"):
        return "what was trained"
    if path.startswith("firmware/packages/"):
        return "package"
    if _FIRMWARE.fullmatch(path):
        return "firmware"
    if path.startswith("build/fleet/report."):
        return FLEET_REPORT
    if path.startswith("cal."):
        return "calibration"
    return path


def copy_project(source: Path, target: Path) -> None:
    """Put a project where another was."""
    shutil.rmtree(target, ignore_errors=True)
    shutil.copytree(source, target)
