"""What is run under faults: every command that writes, on small projects."""

import re
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tests.loop.conftest import TOML, write_log

Run = Callable[[Path, tuple[str, ...]], int]
"""(project, arguments of zerodrift) -> exit code, without faults."""


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
    report: str = ""
    """The file that tells which units failed, where others go on and the exit code is 1."""


def prepare_logs(project: Path, _: Run | None = None) -> None:
    """Write three short runs."""
    for seed in range(3):
        write_log(project / "logs" / f"run_{seed}.csv", seed, seconds=400)


def prepare_toml(project: Path, run: Run | None = None) -> None:
    """Write the runs and zerodrift.toml."""
    prepare_logs(project, run)
    (project / "zerodrift.toml").write_text(TOML.format(more_logs=""), encoding="utf-8")


def change_model(project: Path) -> None:
    """Change what every generated file is made from."""
    path = project / "zerodrift.toml"
    text = path.read_text(encoding="utf-8")
    path.write_text(text.replace('kind = "zero_tempco"', 'kind = "zero_tempco"\norder = 2', 1))


def prepare_old(*commands: tuple[str, ...]) -> Callable[[Path, Run], None]:
    """Return what runs commands and then changes the model, so that all that they wrote is old."""

    def prepare(project: Path, run: Run) -> None:
        prepare_toml(project)
        for arguments in commands:
            assert run(project, arguments) == 0, arguments
        change_model(project)

    return prepare


def prepare_firmware(project: Path, run: Run) -> None:
    """Make a project with its firmware."""
    prepare_toml(project)
    assert run(project, ("firmware", "-C", "{}")) == 0


def prepare_added(project: Path, run: Run) -> None:
    """Make a project with an effect that was added."""
    prepare_toml(project)
    assert run(project, ("add", "thermal_lag", "-C", "{}")) == 0


def prepare_package(project: Path, run: Run) -> None:
    """Make a project with an old package and a new firmware."""
    prepare_firmware(project, run)
    assert run(project, ("package", "cmake", "-C", "{}")) == 0
    change_model(project)
    assert run(project, ("firmware", "-C", "{}")) == 0


def prepare_codes(project: Path, _: Run) -> None:
    """Write a log of converter codes under test weights."""
    rng = np.random.default_rng(5)
    loads = rng.uniform(-1.0, 1.0, (200, 6)) * (100.0, 100.0, 400.0, 2.0, 2.0, 3.0)
    forward = rng.normal(size=(6, 6)) + np.diag([30.0, 30.0, 8.0, 1500.0, 1500.0, 1000.0])
    codes = 32768.0 + loads @ forward.T
    names = [f"adc_{k}" for k in range(1, 7)]
    names += [f"ref_{name}" for name in ("Fx_N", "Fy_N", "Fz_N", "Mx_Nm", "My_Nm", "Mz_Nm")]
    table = np.column_stack([np.arange(200.0), codes, loads])
    header = ",".join(["time_s", *names])
    project.mkdir(exist_ok=True)
    np.savetxt(project / "codes.csv", table, delimiter=",", header=header, comments="", fmt="%.9g")
    for kind in ("toml", "json", "h"):
        (project / f"cal.{kind}").write_text("old\n")


def prepare_fleet(project: Path, run: Run) -> None:
    """Make a fleet of two sensors, calibrated, with another design since."""
    for number, sensor in enumerate(("SN1", "SN2")):
        for seed in range(3):
            path = project / "fleet" / sensor / f"run_{seed}.csv"
            write_log(path, 10 * number + seed, seconds=400)
    text = TOML.format(more_logs="").replace("logs/run_*.csv", "run_*.csv")
    text += '\n[fleet]\nfolder = "fleet/{sensor}"\n'
    (project / "zerodrift.toml").write_text(text, encoding="utf-8")
    assert run(project, FLEET) == 0
    change_model(project)


REPORT = ("report", "-C", "{}", "--no-diagnose")
CALIBRATE = (
    *("calibrate", "{}/codes.csv", "-C", "{}"),
    *(word for kind in ("toml", "json", "h") for word in ("--write", f"{{}}/cal.{kind}")),
)
FLEET = ("fleet", "-C", "{}", "--jobs", "1", "--no-firmware")
TWIN = ("twin", "-C", "{}", "--runs", "1", "--duration", "300", "--test", "none", "--no-dwell")


def prepare_twin(project: Path, run: Run) -> None:
    """Write a simulation that another replaces."""
    project.mkdir(exist_ok=True)
    assert run(project, (*TWIN, "--seed", "1")) == 0


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
