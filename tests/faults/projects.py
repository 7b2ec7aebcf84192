"""Small projects, as the commands under faults find them."""

from collections.abc import Callable
from pathlib import Path
from unittest import mock

import numpy as np
from benchmarks import formula_cases

from tests.fleet.test_upgrade import INPUTS, REST
from tests.loop.conftest import TOML, write_log
from tests.projects import FORCE, render_toml
from tests.propose.test_end_to_end import write_project as write_formula_project

Run = Callable[[Path, tuple[str, ...]], int]
"""(project, arguments of zerodrift) -> exit code, without faults."""

FLEET = ("fleet", "-C", "{}", "--jobs", "1", "--no-firmware")
TWIN = ("twin", "-C", "{}", "--runs", "1", "--duration", "300", "--test", "none", "--no-dwell")
BLOCK = '\n[firmware]\ncoefficients = "block"\nserial = "SN1"\ncalibrated = 2026-03-01\n'


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


def prepare_twin(project: Path, run: Run) -> None:
    """Write a simulation that another replaces."""
    project.mkdir(exist_ok=True)
    assert run(project, (*TWIN, "--seed", "1")) == 0


def prepare_block(project: Path, run: Run) -> None:
    """Make a firmware with its block, and change the unit."""
    prepare_toml(project)
    path = project / "zerodrift.toml"
    text = path.read_text(encoding="utf-8") + BLOCK
    path.write_text(text, encoding="utf-8")
    assert run(project, ("firmware", "-C", "{}")) == 0
    path.write_text(text.replace("2026-03-01", "2026-09-01"), encoding="utf-8")


def prepare_output(*commands: tuple[str, ...]) -> Callable[[Path, Run], None]:
    """Return what makes firmware, runs commands, and makes the firmware of another model."""

    def prepare(project: Path, run: Run) -> None:
        prepare_firmware(project, run)
        for arguments in commands:
            assert run(project, arguments) == 0, arguments
        change_model(project)
        assert run(project, ("firmware", "-C", "{}")) == 0

    return prepare


def prepare_registry(project: Path, run: Run) -> None:
    """Make a project and a registry with one unit."""
    prepare_toml(project)
    assert run(project, ("registry", "init", "-C", "{}")) == 0
    assert run(project, ("registry", "add", "SN1", "-C", "{}")) == 0


def prepare_formula(project: Path, _: Run) -> None:
    """Write simulated logs that follow a form outside the catalogue."""
    project.mkdir(exist_ok=True)
    with mock.patch.object(formula_cases, "ROWS", 400):
        write_formula_project(project, "sqrt(ambient_light)", runs=4)


def prepare_codes_of_units(project: Path, _: Run) -> None:
    """Make a fleet in which logs choose what a code of the supply is worth."""
    t = np.arange(60.0)
    for number, largest in enumerate((3.1, 5.2)):
        folder = project / f"SN{number}"
        folder.mkdir(parents=True)
        table = np.column_stack([t, 20 + t / 4, largest * t / 59, 40 + t / 10, 100 + t, t, 0 * t])
        names = "time_s,temperature_degC,supply_V,humidity_pct,p,Fz_N,ref_Fz_N"
        path = folder / "log.csv"
        np.savetxt(path, table, delimiter=",", header=names, comments="", fmt="%.9g")
    text = render_toml(INPUTS + REST, outputs=(FORCE,))
    (project / "zerodrift.toml").write_text(text, encoding="utf-8")
