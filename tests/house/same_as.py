"""Holds what this tree does against what another tree does: nothing may differ.

    python -m tests.house.same_as OLD_TREE [--only PROJECT] [--jobs N]

Small simulated projects are written once, by the other tree where a command is needed, and copied
for each tree. The same commands run in both copies, each tree's own `.venv/bin/zerodrift`; nothing
of zerodrift is imported here. Compared are exit codes, what is printed, and every file that a
command wrote: JSON by keys with numbers to 1e-9, all else byte for byte, and so all of `firmware/`,
`model.json`, `certificate.json` and the manifest. What a second run of one tree would change is
exempt, and stands in EXEMPT and EXEMPT_FILES with its reason. Exit code 1: something differs.
"""

import argparse
import json
import math
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from fnmatch import fnmatch
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[2]
TOLERANCE = 1e-9
"""Of a number in JSON, relative to the larger of the two."""
LIMIT_S = 300.0
"""Seconds that one command may take."""
ROWS = 480
"""Of a simulated log, one a second."""

EXEMPT = {
    "*cpu_s": "processor seconds",
    "*seconds": "how long it took",
    "*.at": "time of day of what the registry enters",
    "*_at": "the same",
}
"""Keys in JSON whose values no two runs share, and why."""
EXEMPT_FILES = {
    "*.lock": "empty, there while a command runs",
    "*.sqlite*": "times of day; `registry list` and `registry history` tell what it holds",
    "build/recordings/*": "named by where the log lies, with the process and times of day",
}
"""Files whose bytes no two runs share, and why."""
TIME_OF_DAY = re.compile(rb"20\d\d-\d\d-\d\d[T ]\d\d:\d\d(:\d\d(\.\d+)?)?(\+00:00| UTC|Z)?")
"""What the registry's times are replaced by; no log here has one."""
NOT_RUN = {
    "workbench": "serves a page until it is stopped; the page runs the commands that are run here",
    "paper": "a minute and more, even at its least; it fits by what `train` is made of",
}
"""Commands of which `--help` alone is compared, and why."""
TEXTS = ("firmware/*", "*/firmware/*", "*model.json", "*certificate.json", "*manifest.json")
"""JSON files that are compared byte for byte too."""


@dataclass(frozen=True)
class Step:
    """One command in the folder of a project."""

    arguments: tuple[str, ...]
    before: Callable[[Path], None] | None = None
    """What is done to the project first, in both copies."""
    program: str = "zerodrift"
    stdin: str = ""
    code: int = 0
    """What it ends with; another one says that the step does not show what it is there for."""
    counted_clock: bool = False
    """Processor time is replaced by a count, where the answer depends on how far a search came."""

    def __str__(self) -> str:
        """Return the command as it would be typed."""
        told = " ".join(a if " " not in a and "\n" not in a else repr(a) for a in self.arguments)
        return told if self.program == "zerodrift" else f"{self.program} {told}"


def step(command: str, before: Callable[[Path], None] | None = None, code: int = 0) -> Step:
    """Return the step of a command whose arguments hold no spaces."""
    return Step(tuple(command.split()), before, code=code)


Run = Callable[[Path, str], None]
"""(folder, command): runs a command of the other tree, while a project is written."""


@dataclass(frozen=True)
class Project:
    """What is written once, and what is run in both copies of it."""

    write: Callable[[Path, Run], None]
    steps: tuple[Step, ...]


@dataclass(frozen=True)
class Outcome:
    """What a command left behind; the names of the two trees and of the copy are taken out."""

    code: int
    out: str
    err: str
    files: dict[str, bytes | None] = field(default_factory=dict)
    """Path from the project's folder -> what was written; None = removed."""


# --- comparing


def compare_outcomes(old: Outcome, new: Outcome) -> str | None:
    """Return the first difference of two outcomes in words, or None."""
    if old.code != new.code:
        return f"exit code {old.code} is now {new.code}: {last_line(new.err) or last_line(old.err)}"
    for name, before, after in (("stdout", old.out, new.out), ("stderr", old.err, new.err)):
        found = compare_texts(before, after)
        if found:
            return f"{name}: {found}"
    for path in sorted({*old.files, *new.files}):
        found = compare_files(path, old.files.get(path, b""), new.files.get(path, b""))
        if path not in new.files or path not in old.files:
            found = f"written by the {'old' if path in old.files else 'new'} tree alone"
        if found:
            return f"{path}: {found}"
    return None


def compare_files(path: str, old: bytes | None, new: bytes | None) -> str | None:
    """Return the first difference of a file, or None; JSON by its keys, save TEXTS."""
    if old == new:
        return None
    if old is None or new is None:
        return f"removed by the {'new' if new is None else 'old'} tree alone"
    if path.endswith(".json") and not any(fnmatch(path, one) for one in TEXTS):
        return compare_texts(old.decode(), new.decode())
    try:
        before, after = old.decode(), new.decode()
    except UnicodeDecodeError:
        at = next((k for k, (a, b) in enumerate(zip(old, new, strict=False)) if a != b), None)
        where = "in length alone" if at is None else f"at byte {at}"
        return f"{len(old)} and {len(new)} bytes differ {where}"
    return compare_lines(before, after)


def compare_texts(old: str, new: str) -> str | None:
    """Return the first difference of two printed texts, by keys where both are JSON, or None."""
    try:
        before, after = json.loads(old), json.loads(new)
    except ValueError:
        return compare_lines(old, new)
    return compare_values(before, after)


def compare_lines(old: str, new: str) -> str | None:
    """Return the first line that differs, or None."""
    before, after = old.splitlines(keepends=True), new.splitlines(keepends=True)
    for number in range(max(len(before), len(after))):
        one = before[number] if number < len(before) else "(the end)"
        two = after[number] if number < len(after) else "(the end)"
        if one != two:
            at = next((k for k, (a, b) in enumerate(zip(one, two, strict=False)) if a != b), 0)
            start = max(0, at - 30)
            return f"line {number + 1}: {one[start : at + 60]!r} is now {two[start : at + 60]!r}"
    return None


def compare_values(old: object, new: object, where: str = "") -> str | None:
    """Return the first difference of two values from JSON, or None.

    The order of keys does not count; that of lists does. Numbers are equal within TOLERANCE, an
    integer and a float of one value too; true is no number.
    """
    if any(fnmatch(where, pattern) for pattern in EXEMPT):
        return None
    if isinstance(old, dict) and isinstance(new, dict):
        for key in [*old, *(k for k in new if k not in old)]:
            inner = f"{where}.{key}" if where else str(key)
            if key not in new or key not in old:
                return f"{inner} is {'gone' if key in old else 'new'}"
            found = compare_values(old[key], new[key], inner)
            if found:
                return found
        return None
    if isinstance(old, list) and isinstance(new, list):
        for number, (one, two) in enumerate(zip(old, new, strict=False)):
            found = compare_values(one, two, f"{where}[{number}]")
            if found:
                return found
        if len(old) != len(new):
            return f"{where} has {len(old)} items, now {len(new)}"
        return None
    if is_number(old) and is_number(new):
        same = old == new or math.isclose(old, new, rel_tol=TOLERANCE, abs_tol=0.0)
        same = same or (math.isnan(old) and math.isnan(new))
    else:
        same = type(old) is type(new) and old == new
    return None if same else f"{where}: {str(old)[:90]!r} is now {str(new)[:90]!r}"


def is_number(value: object) -> bool:
    """Tell whether a value from JSON is a number."""
    return isinstance(value, int | float) and not isinstance(value, bool)


def last_line(text: str) -> str:
    """Return the last line that is not empty."""
    return next((line for line in reversed(text.splitlines()) if line.strip()), "")


# --- running

CLOCK = '''\
"""Processor time that counts how often it is asked: 5 ms each time."""
import itertools, time
_asked = itertools.count()
time.process_time = lambda: 0.005 * next(_asked)
'''


@dataclass(frozen=True)
class Tree:
    """A checkout with a virtual environment of its own."""

    root: Path

    def check(self) -> None:
        """Refuse a tree whose virtual environment imports another one."""
        python = self.root / ".venv/bin/python"
        if not (self.root / ".venv/bin/zerodrift").is_file():
            sys.exit(f"{self.root}: .venv/bin/zerodrift is missing; `make setup` makes it")
        told = subprocess.run(
            [python, "-c", "import zerodrift; print(zerodrift.__file__)"],
            cwd=tempfile.gettempdir(),
            text=True,
            capture_output=True,
            check=False,
        )
        place = Path(told.stdout.strip() or "/").resolve()
        if self.root not in place.parents:
            sys.exit(
                f"{self.root}: its .venv imports {place}, not this tree;"
                " `.venv/bin/python -m pip install --no-deps --no-build-isolation -e .` does"
            )

    def run(self, folder: Path, step: Step, scratch: Path) -> subprocess.CompletedProcess[bytes]:
        """Run one command in a folder, with a configuration and a width of its own."""
        environment = {
            **{k: v for k, v in os.environ.items() if not k.startswith(("PYTHON", "ZD_"))},
            "XDG_CONFIG_HOME": str(scratch / "config"),
            "COLUMNS": "100",
            "TERM": "dumb",
            "OMP_NUM_THREADS": "1",
        }
        if step.counted_clock:
            (scratch / "clock").mkdir(exist_ok=True)
            (scratch / "clock/sitecustomize.py").write_text(CLOCK, encoding="utf-8")
            environment["PYTHONPATH"] = str(scratch / "clock")
        return subprocess.run(
            [self.root / ".venv/bin" / step.program, *step.arguments],
            cwd=folder,
            env=environment,
            input=step.stdin.encode(),
            capture_output=True,
            timeout=LIMIT_S,
            check=False,
        )


def read_files(folder: Path) -> dict[str, bytes]:
    """Return the content of every file in a folder that is not exempt."""
    files = {str(p.relative_to(folder)): p for p in sorted(folder.rglob("*")) if p.is_file()}
    return {
        name: path.read_bytes()
        for name, path in files.items()
        if not any(fnmatch(name, pattern) for pattern in EXEMPT_FILES)
    }


def run_steps(tree: Tree, steps: tuple[Step, ...], scratch: Path) -> list[Outcome]:
    """Run a project's commands in its copy, one after the other."""
    folder = scratch / "project"
    outcomes = []

    def plain(data: bytes) -> bytes:
        for path, name in ((scratch, b"SCRATCH"), (tree.root, b"TREE")):
            data = data.replace(str(path).encode(), name)
        return TIME_OF_DAY.sub(b"TIME", data)

    for one in steps:
        if one.before:
            one.before(folder)
        before = read_files(folder)
        try:
            done = tree.run(folder, one, scratch)
        except subprocess.TimeoutExpired:
            outcomes.append(Outcome(-1, "", f"took more than {LIMIT_S:g} s"))
            continue
        after = read_files(folder)
        changed = {name: plain(data) for name, data in after.items() if before.get(name) != data}
        gone = dict.fromkeys(before.keys() - after.keys())
        out, err = (plain(text).decode(errors="replace") for text in (done.stdout, done.stderr))
        outcomes.append(Outcome(done.returncode, out, err, {**changed, **gone}))
    return outcomes


def run_helps(tree: Tree, scratch: Path) -> dict[tuple[str, ...], Outcome]:
    """Return what `--help` of every command prints, and of every command in a command."""
    found: dict[tuple[str, ...], Outcome] = {}
    waiting: list[tuple[str, ...]] = [()]
    while waiting:
        command = waiting.pop(0)
        (found[command],) = run_steps(tree, (Step((*command, "--help")),), scratch)
        _, _, listed = found[command].out.partition("\nCommands:\n")
        names = re.findall(r"^  ([a-z][a-z-]*)", listed, flags=re.MULTILINE)
        waiting += [(*command, name) for name in names]
    return found


# --- the projects

SENSOR = """\
[sensor]
name = "cell"
time = "time_s"
temperature = "temperature_degC"
sample_period_s = 1.0

[outputs.Fz]
measured = "Fz_N"
reference = "ref_Fz_N"
unit = "N"
full_scale = 200

[outputs.Mx]
measured = "Mx_Nm"
unit = "Nm"
full_scale = 10

"""
LOGS = '[logs]\ntrain = ["logs/run_[0-3].csv"]\ntest = ["logs/run_4.csv"]\n'
PHYSICS = '\n[[effect]]\nkind = "zero_tempco"\n\n[[effect]]\nkind = "thermal_lag"\n'
NONE, BANK = '\n[network]\nkind = "none"\n', '\n[network]\nkind = "lag_bank"\n'
INPUTS = '[inputs]\nsupply = "supply_V"\nhumidity = "humidity_pct"\n\n'
OWN_TOML = '\n[[effect]]\nkind = "second_order_lag"\n\n[plugins]\nfiles = ["own.py"]\n'
OWN = '''\
from zerodrift.effects import Effect, Feature, Parameter, register


def build(ops, signals, p):
    """The temperature after two equal lags."""
    body = ops.lowpass(signals.temperature_degC, p["tau_s"])
    return [Feature("twice lagged", ops.lowpass(body, p["tau_s"]), "K")]


register(
    Effect(
        kind="second_order_lag",
        title="two thermal masses in a row",
        build=build,
        parameters=(Parameter("tau_s", "s", lower=1.0, upper=3000.0, typical=(10.0, 300.0)),),
        needs=("temperature",),
        equation="drift = k LP(LP(T, tau), tau)",
    )
)
'''
FLEET = """
[fleet]
folder = "fleet/{sensor}"

[firmware]
coefficients = "block"
calibrated = 2026-03-01
"""
UNITS = ("SN01", "SN02", "SN03")
FEATURES = "temperature,supply,humidity"
ONNX = ROOT / "tests/onnx/exported/plain_gru.onnx"
FACE = """\
import dataclasses, json
import zerodrift as zd

def plain(value):
    if dataclasses.is_dataclass(value):
        return {f.name: plain(getattr(value, f.name)) for f in dataclasses.fields(value)}
    if isinstance(value, dict):
        return {str(k): plain(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(v) for v in value]
    return value if isinstance(value, (str, int, float, bool, type(None))) else str(value)

project = zd.Project(".")
told = {"names": dir(zd), "effects": sorted(zd.effects.__all__)}
told["methods"] = sorted(name for name in dir(project) if not name.startswith("_"))
told["compare"] = plain(project.compare())
told["diagnose"] = plain(project.diagnose())
print(json.dumps(told))
"""


def write_log(path: Path, seed: int, scale: float = 1.0) -> None:
    """Write a simulated log: a lag of 40 s, loads hung on now and then, two further inputs."""
    rng = np.random.default_rng(seed)
    t = np.arange(float(ROWS))
    temperature = 25.0 + 15.0 * np.sin(2 * np.pi * t / (200.0 + 40.0 * seed) + seed)
    temperature += 0.004 * rng.standard_normal(ROWS)
    late = np.empty(ROWS)
    body = temperature[0]
    for i, now in enumerate(temperature):
        body += (now - body) / 40.0
        late[i] = body
    load = np.repeat(20.0 * rng.integers(0, 4, size=ROWS // 60 + 1), 60)[:ROWS]
    drift = scale * (0.2 * (late - 25.0) + 0.1 * (temperature - 25.0)) + 3.0
    columns = {
        "time_s": (t, 0),
        "temperature_degC": (temperature, 4),
        "Fz_N": (load + drift + 0.05 * rng.standard_normal(ROWS), 4),
        "ref_Fz_N": (load, 1),
        "Mx_Nm": (0.03 * drift + 0.004 * rng.standard_normal(ROWS), 5),
        "supply_V": (3.3 + 0.05 * np.sin(t / 31.0 + seed), 4),
        "humidity_pct": (45.0 + 10.0 * np.cos(t / 130.0 + seed), 2),
    }
    rows = zip(*([f"{v:.{d}f}" for v in x] for x, d in columns.values()), strict=True)
    path.parent.mkdir(parents=True, exist_ok=True)
    lines = [",".join(columns), *(",".join(row) for row in rows)]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def write_five(folder: Path, toml: str) -> None:
    """Write five logs and zerodrift.toml."""
    for seed in range(5):
        write_log(folder / f"logs/run_{seed}.csv", seed)
    (folder / "zerodrift.toml").write_text(toml, encoding="utf-8")


def write_physics(folder: Path, _: Run) -> None:
    """Physics alone."""
    write_five(folder, SENSOR + LOGS + PHYSICS + NONE)
    (folder / "face.py").write_text(FACE, encoding="utf-8")


def write_lag_bank(folder: Path, _: Run) -> None:
    """A lag bank on what one effect leaves."""
    write_five(folder, SENSOR + LOGS + '\n[[effect]]\nkind = "zero_tempco"\n' + BANK)


def write_onnx(folder: Path, _: Run) -> None:
    """No effect and no network; one comes from an ONNX file."""
    write_five(folder, SENSOR + INPUTS + LOGS + NONE)
    for path in (ONNX, ONNX.with_suffix(".onnx.data")):
        shutil.copy(path, folder)


def write_plugin(folder: Path, _: Run) -> None:
    """An effect of the user's own."""
    write_five(folder, SENSOR + LOGS + OWN_TOML + NONE)
    (folder / "own.py").write_text(OWN, encoding="utf-8")


def write_gru(folder: Path, run: Run) -> None:
    """The bundled example, with short logs, two outputs and a small GRU of few epochs."""
    folder.mkdir()
    for name in ("zerodrift.toml", "twin.json"):
        shutil.copy(ROOT / "examples/ft40" / name, folder)
    run(folder, "twin --example")
    for path in (folder / "logs").glob("*.csv"):
        lines = path.read_text(encoding="utf-8").splitlines(keepends=True)
        path.write_text("".join(lines[: ROWS + 1]), encoding="utf-8")
    toml = folder / "zerodrift.toml"
    text = toml.read_text(encoding="utf-8")
    for name in ("Fx", "Fy", "My", "Mz"):
        text = re.sub(rf"\[outputs\.{name}\].*?(?=\n\[)", "", text, flags=re.DOTALL)
    text = re.sub(r"epochs = \d+", "epochs = 4\nstarts = 1", text)
    toml.write_text(text.replace("hidden = 16", "hidden = 4"), encoding="utf-8")


def write_fleet(folder: Path, _: Run) -> None:
    """Three units of one design, whose coefficients lie in blocks."""
    for number, unit in enumerate(UNITS):
        for seed in range(3):
            path = folder / "fleet" / unit / f"run_{seed}.csv"
            write_log(path, 5 * number + seed, 1.0 + 0.2 * number)
    logs = '[logs]\ntrain = ["run_[01].csv"]\ntest = ["run_2.csv"]\n'
    effect = '\n[[effect]]\nkind = "zero_tempco"\n'
    (folder / "zerodrift.toml").write_text(SENSOR + logs + effect + FLEET, encoding="utf-8")


def write_nothing_yet(folder: Path, _: Run) -> None:
    """Logs without zerodrift.toml, and codes of a converter under test weights."""
    for seed in range(3):
        write_log(folder / f"logs/run_{seed}.csv", seed)
    rng = np.random.default_rng(5)
    loads = rng.uniform(-1.0, 1.0, (120, 6)) * (100.0, 100.0, 400.0, 2.0, 2.0, 3.0)
    forward = rng.normal(size=(6, 6)) + np.diag([30.0, 30.0, 8.0, 1500.0, 1500.0, 1000.0])
    names = [f"adc_{k}" for k in range(1, 7)]
    names += [f"ref_{name}" for name in ("Fx_N", "Fy_N", "Fz_N", "Mx_Nm", "My_Nm", "Mz_Nm")]
    table = np.column_stack([np.arange(120.0), 32768.0 + loads @ forward.T, loads])
    header = ",".join(["time_s", *names])
    np.savetxt(folder / "codes.csv", table, "%.9g", ",", header=header, comments="")


def replace(old: str, new: str, name: str = "zerodrift.toml") -> Callable[[Path], None]:
    """Return what replaces text in a file of a project."""

    def edit(folder: Path) -> None:
        path = folder / name
        text = path.read_text(encoding="utf-8")
        if old not in text:
            sys.exit(f"{path}: {old!r} is not in it")
        path.write_text(text.replace(old, new, 1), encoding="utf-8")

    return edit


def put(name: str, data: bytes) -> Callable[[Path], None]:
    """Return what writes a file of a project."""

    def write(folder: Path) -> None:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(data)

    return write


def spoil(folder: Path) -> None:
    """Mend the first log; in another the thermometer reads its reset value for two minutes."""
    write_log(folder / "logs/run_0.csv", 0)
    path = folder / "logs/run_1.csv"
    header, *rows = path.read_text(encoding="utf-8").splitlines()
    cells = [row.split(",") for row in rows]
    for row in cells[200:320]:
        row[1] = "85.0000"
    path.write_text("\n".join([header, *map(",".join, cells)]) + "\n", encoding="utf-8")


RECORDED = "time_s,temperature_degC,Fz_N,Mx_Nm\n" + "".join(
    f"{k},{20 + k / 4},{k / 10},{k / 100}\n" for k in range(40)
)
PLAN = ("plan", "--hours", "1", "--budget", "1", "--between", "creep", "thermal_lag", "--json")
PACKAGES = ("cmake", "zephyr", "arduino", "platformio", "esp-idf", "pico", "python", "ros2")
NEIGHBOURS = ("px4-accel", "px4-gyro", "ardupilot-accel", "ardupilot-gyro")

PROJECTS: dict[str, Project] = {
    "physics": Project(
        write_physics,
        (
            step("compare --json"),
            step("compare --html compare.html"),
            step("diagnose --json"),
            step("diagnose"),
            Step((*PLAN, "--out", "plan.csv"), counted_clock=True),
            step("propose --no-black-box --json"),
            step("train --json"),
            step("export --json"),
            step("firmware --json"),
            step("verify --json"),
            step("verify --certificate --json"),
            step("verify --prove --json"),
            step("compare --model c --json"),
            step("apply logs/run_4.csv --out applied.csv --json"),
            step("apply logs/run_4.csv --out float.csv --model float --json"),
            step("monitor logs/run_4.csv --block-hours 0.02 --json"),
            *(step(f"package {kind} --json") for kind in PACKAGES),
            *(step(f"neighbour {kind} --output Fz --json", code=2) for kind in NEIGHBOURS),
            step("neighbour polynomial --json"),
            step("report --json --datasheet --annex annex"),
            step("report --json --dcc dcc.xml", code=2),
            step("remove thermal_lag --json"),
            step("firmware --out other --force --json"),
            step("diff firmware other --json"),
            step("add thermal_lag --json"),
            step("history --json"),
            step("history --html history.html"),
            step("history --restore 0 --json"),
            Step(("face.py",), program="python"),
        ),
    ),
    "lag_bank": Project(
        write_lag_bank,
        (
            step("compare --json"),
            step("train --json"),
            step("firmware --json"),
            step("verify --json"),
            step("compare --model integer --json"),
            step("apply logs/run_4.csv --out applied.csv --json"),
            step("report --no-diagnose --json"),
            step("firmware --force --json", replace('"lag_bank"', '"lag_bank"\nmemory = 10'), 2),
        ),
    ),
    "gru": Project(
        write_gru,
        (
            step("train --json"),
            step("export --json"),
            step("firmware --force --no-uncertainty --json"),
            step("verify --json"),
            step("compare --model integer --json"),
            step("apply logs/test_walking_1.csv --out applied.csv --json"),
            step("report --no-diagnose --json"),
        ),
    ),
    "onnx": Project(
        write_onnx,
        (
            step(f"firmware --onnx {ONNX.name} --features {FEATURES} --force --json"),
            step("verify --json"),
            step("apply logs/run_4.csv --out applied.csv --json"),
            step("report --no-diagnose --json"),
        ),
    ),
    "plugin": Project(
        write_plugin,
        (
            step("effects second_order_lag --json", code=2),
            step("effects second_order_lag --trust --json"),
            step("compare --trust --json"),
            step("diagnose --trust --json"),
            step("firmware --json"),
            step("verify --json"),
            step("report --no-diagnose --trust --json"),
            step("firmware --json", replace("k LP(LP(T, tau), tau)", "k LP2(T, tau)", "own.py")),
        ),
    ),
    "fleet": Project(
        write_fleet,
        (
            step("registry init"),
            step("registry add SN09"),
            step("fleet --jobs 1 --force --json"),
            step("fleet --jobs 1 --force"),
            step("block show firmware/blocks/SN01.bin firmware/blocks/SN02.hex --json"),
            step("registry add SN01", code=2),
            step("registry block SN01 firmware/blocks/SN01.bin --loaded"),
            step("registry loaded SN01 0123abcd", code=2),
            step("registry list --json"),
            step("registry history SN01 --json"),
            step("compare --sensor SN02 --json"),
            step("diagnose --json"),
            step("apply fleet/SN01/run_2.csv --sensor SN01 --out applied.csv --json"),
            step("monitor fleet/SN01/run_2.csv --sensor SN01 --block-hours 0.02 --json"),
            step("verify --sensor SN01 --json", code=2),
        ),
    ),
    "begin": Project(
        write_nothing_yet,
        (
            step("init logs/run_0.csv logs/run_1.csv logs/run_2.csv --json"),
            step("init logs/run_0.csv", code=2),
            step("init --upgrade --json"),
            step("effects --json"),
            step("effects"),
            step("effects creep --json"),
            step("effects thermal_lag --html effect.html"),
            step("doctor --json"),
            step("calibrate codes.csv --write cal.toml --write cal.json --write cal.h --json"),
            Step(("record", "-", "--out", "recorded.parquet", "--json"), stdin=RECORDED),
            step("twin --out sim --runs 1 --duration 300 --test none --no-dwell --json"),
            step("twin --list"),
            step("twin --out six --six-axis --level adc --runs 1 --test none --no-dwell --json"),
        ),
    ),
    "bad": Project(
        write_physics,
        (
            step("compare", replace('"Fz_N"', '"Fzz_N"'), 2),
            step("compare --json", code=2),
            step("compare", replace('"Fzz_N"', '"Fz_N'), 2),
            step("compare", replace('"Fz_N', '"Fz_N"\nfull_scael = 3'), 2),
            step("add thermal_lga", replace("\nfull_scael = 3", ""), 2),
            step("add zero_tempco --hold order=x", code=2),
            step("verify --json", code=2),
            step("apply logs/run_0.csv --json", code=2),
            step("compare --modle c", code=2),
            step("comparre", code=2),
            step("compare -C nowhere", code=2),
            step("compare", put("logs/run_0.csv", bytes(range(256)) * 40), 2),
            step("compare", put("logs/run_0.csv", b""), 2),
            step("compare", put("logs/run_0.csv", b"time_s,temperature_degC\n0,1\n0,x\n"), 2),
            step("firmware --json", spoil, 1),
            step("block show zerodrift.toml", code=2),
            step("registry list", code=2),
            step("diff logs zerodrift.toml", code=2),
        ),
    ),
}
HELP = "help"
"""What stands in the place of a project for the help of every command."""
SIDES = ("old", "new")
"""Folders of the copies, named alike long, so that wrapped lines break alike."""


# --- all of it


@dataclass(frozen=True)
class Row:
    """A line of the table."""

    project: str
    command: str
    difference: str | None


def compare_project(
    name: str, steps: tuple[Step, ...], old: list[Outcome], new: list[Outcome]
) -> Iterator[Row]:
    """Yield a line of the table for every command of a project."""
    for one, before, after in zip(steps, old, new, strict=True):
        found = compare_outcomes(before, after)
        if before.code != one.code and not found:
            found = f"exit code {before.code}, expected {one.code}: {last_line(before.err)}"
        yield Row(name, str(one), found)


def compare_helps(
    old: dict[tuple[str, ...], Outcome], new: dict[tuple[str, ...], Outcome]
) -> Iterator[Row]:
    """Yield a line of the table for the help of every command of either tree."""
    for command in dict.fromkeys([*old, *new]):
        if command in old and command in new:
            found = compare_outcomes(old[command], new[command])
        else:
            found = f"of the {'old' if command in old else 'new'} tree alone"
        yield Row(HELP, " ".join((*command, "--help")), found)


def list_missed(names: Iterable[tuple[str, ...]]) -> Iterator[Row]:
    """Yield the commands that no project runs though NOT_RUN does not name them."""
    run = [one.arguments for project in PROJECTS.values() for one in project.steps]
    known = list(names)
    for name in known:
        group = any(other[: len(name)] == name and other != name for other in known)
        if group or name[0] in NOT_RUN:
            continue
        if not any(arguments[: len(name)] == name for arguments in run):
            yield Row(HELP, " ".join(name), "no project runs it, and NOT_RUN does not say why")


def write_copies(old: Tree, name: str, scratch: Path) -> None:
    """Write a project once, and copy it for each tree."""
    source = scratch / "source" / name

    def run(folder: Path, command: str) -> None:
        done = old.run(folder, step(command), scratch / "source")
        if done.returncode:
            sys.exit(f"{name}: {command}: {done.stderr.decode()}")

    PROJECTS[name].write(source, run)
    for side in SIDES:
        shutil.copytree(source, scratch / side / name / "project")


def run_all(old: Tree, new: Tree, names: list[str], jobs: int, scratch: Path) -> list[Row]:
    """Write the projects, run both trees in copies of them, and return the table."""
    trees = dict(zip(SIDES, (old, new), strict=True))
    projects = [name for name in names if name != HELP]
    for name in projects:
        write_copies(old, name, scratch)
    for side in SIDES:
        (scratch / side / HELP / "project").mkdir(parents=True)

    def go(name: str, side: str) -> list[Outcome]:
        began = time.monotonic()
        outcomes = run_steps(trees[side], PROJECTS[name].steps, scratch / side / name)
        print(f"{name}, {side}: {time.monotonic() - began:.0f} s", file=sys.stderr, flush=True)
        return outcomes

    rows: list[Row] = []
    with ThreadPoolExecutor(jobs) as pool:
        running = {(name, side): pool.submit(go, name, side) for name in projects for side in SIDES}
        helps = [
            pool.submit(run_helps, trees[side], scratch / side / HELP)
            for side in SIDES
            if HELP in names
        ]
        for name in projects:
            done = [running[name, side].result() for side in SIDES]
            rows += compare_project(name, PROJECTS[name].steps, *done)
        if helps:
            told = [future.result() for future in helps]
            rows += compare_helps(*told)
            rows += list_missed(told[1])
    return rows


def main() -> None:
    """Compare two trees and print a line for each command."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("old", type=Path, metavar="OLD_TREE", help="with its own .venv")
    parser.add_argument(
        "--only", action="append", choices=[*PROJECTS, HELP], help="repeat it for several"
    )
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--keep", type=Path, help="leave the copies in this new folder")
    told = parser.parse_args()
    old, new = Tree(told.old.resolve()), Tree(ROOT)
    if old == new:
        sys.exit(f"{old.root} is this tree itself")
    for tree in (old, new):
        tree.check()
    names = told.only or [*PROJECTS, HELP]
    if told.keep:
        told.keep.mkdir(parents=True)
        rows = run_all(old, new, names, told.jobs, told.keep.resolve())
    else:
        with tempfile.TemporaryDirectory(prefix="same_as_") as scratch:
            rows = run_all(old, new, names, told.jobs, Path(scratch).resolve())
    width = max(len(row.command) for row in rows)
    for row in rows:
        print(f"{row.project:9} {row.command:{min(width, 60)}} {row.difference or 'same'}")
    differ = sum(row.difference is not None for row in rows)
    print(f"{len(rows)} commands, {differ} differ")
    sys.exit(1 if differ else 0)


if __name__ == "__main__":
    main()
