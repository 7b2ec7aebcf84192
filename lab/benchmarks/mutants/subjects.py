"""What is mutated: models of the golden kinds, as firmware folders and as whole projects."""

import json
import shutil
import subprocess
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from tests.golden.model_factory import Shape, draw_model
from tests.golden.models import CASES
from tests.operations.test_conversion import make_model
from tests.projects import render_toml
from tests.variable_step.models import make_model as make_asleep
from tests.verify.conftest import write_firmware

from benchmarks.mutants.driver import render_driver
from benchmarks.mutants.oracle import Oracle
from zerodrift.c_runtime.host import write_sources
from zerodrift.codegen.generate import generate
from zerodrift.export.integer_model import IntegerModel
from zerodrift.verify.certificate import certify

MODELS = (
    "front_end",
    "effects",
    "int8",
    "windowed",
    "reset_before",
    "odd_hidden",
    "physics",
    "stack",
    "guarded",
    "lstm",
    "lstm_int8",
    "layer_norm",
    "raw",
    "asleep",
)
_EXTRA = {
    "physics": Shape(
        inputs=2, hidden=0, outputs=2, code_limit=12000,
        front_end=("lowpass", "product", "late", "root", "exp2", "play", "clip", "power"),
    ),
    "stack": Shape(inputs=2, hidden=6, outputs=2, upper=(5,), dense=((4, "relu6"), (3, "tanh"))),
    "guarded": Shape(
        inputs=2, hidden=4, window=3, outputs=2, measured=(0,),
        front_end=("lowpass", "delay", "load"),
    ),
}  # fmt: skip
_STEPS = 100


@dataclass(frozen=True)
class Subject:
    """A firmware folder's files, all that lies in it."""

    name: str
    prefix: str
    files: dict[str, str]
    """The C that ships, by name."""
    certificate: dict[str, Any]
    folder: Path
    """Where all of it lies; never changed."""
    project: Path | None = None
    """The directory of zerodrift.toml, if it is a whole project."""

    def make_oracle(self, *, chips: bool = True, kept: Path | None = None) -> Oracle:
        """Return who says what a change of these files does."""
        header, source = f"{self.prefix}.h", f"{self.prefix}.c"
        driver = render_driver(
            self.files[header], self.files[source], self.prefix, self.certificate, _STEPS
        )
        return Oracle(self.files, driver, chips=chips, kept=kept)


def read_subject(name: str, folder: Path, project: Path | None = None) -> Subject:
    """Read a firmware folder."""
    files = {
        path.name: path.read_text(encoding="utf-8")
        for path in sorted(folder.iterdir())
        if path.suffix in (".c", ".h")
    }
    certificate = json.loads((folder / "certificate.json").read_text(encoding="utf-8"))
    return Subject(name, certificate["prefix"], files, certificate, folder, project)


def draw_subject(name: str) -> IntegerModel:
    """Return the integer model of one of `MODELS`."""
    if name == "raw":
        return make_model("ntc")
    if name == "asleep":
        return make_asleep(guarded=True)
    shape = _EXTRA[name] if name in _EXTRA else CASES[name].shape
    return replace(draw_model(shape, sum(name.encode())), guarded=name == "guarded")


def make_folder(name: str, folder: Path) -> Subject:
    """Write the firmware folder of a golden model, as `zerodrift firmware` does."""
    model = draw_subject(name)
    code = generate(model)
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    write_sources(code, folder)
    (folder / "certificate.json").write_text(certify(model, code), encoding="utf-8")
    return read_subject(name, folder)


def make_project(name: str, folder: Path) -> Subject:
    """Write a project whose firmware is a golden model's, as `zerodrift firmware` leaves it."""
    shutil.rmtree(folder, ignore_errors=True)
    write_firmware(folder, draw_subject(name))
    return read_subject(name, folder / "firmware", folder)


PROJECTS = {
    "gru": '[network]\nkind = "gru"\nhidden = 6\nepochs = 4\nstarts = 1\n',
    "lag_bank": '[network]\nkind = "lag_bank"\n',
    "int8": '[network]\nkind = "gru"\nhidden = 5\nepochs = 4\nstarts = 1\nmemory = 8\n\n'
    '[quantization]\nweights = "int8"\n',
    "physics": '[network]\nkind = "none"\n',
}
_LOGS = """\
[logs]
train = ["logs/train_*.csv"]
test = ["logs/test_*.csv"]

[[effect]]
kind = "zero_tempco"

"""


def write_logs_of_project(folder: Path, rows: int = 900) -> None:
    """Write four short simulated runs into a folder; the test run is within the others' range."""
    from zerodrift_lab.twin import Recipe, parse_choice, simulate, write_logs

    raw = folder.parent / "raw"
    shutil.rmtree(raw, ignore_errors=True)
    write_logs(simulate(Recipe(seed=3, hidden=(parse_choice("thermal_lag"),))), raw)
    runs = [p.read_text().splitlines(keepends=True) for p in sorted((raw / "logs").glob("*.csv"))]
    runs = [[run[0], *run[1:][:: max(len(run) // rows, 1)][:rows]] for run in runs[:4]]
    column = runs[0][0].split(",").index("temperature_degC")
    spans = [
        max(v) - min(v)
        for v in ([float(line.split(",")[column]) for line in run[1:]] for run in runs)
    ]
    order = sorted(range(4), key=lambda k: -spans[k])
    folder.mkdir(parents=True, exist_ok=True)
    for name, k in zip(("train_1", "train_2", "train_3", "test_1"), order, strict=True):
        (folder / f"{name}.csv").write_text("".join(runs[k]))
    shutil.rmtree(raw)


def train_project(name: str, folder: Path) -> Path:
    """Write a project and run `zerodrift firmware` in it, unless that was done before."""
    if not (folder / "firmware" / "certificate.json").is_file():
        shutil.rmtree(folder, ignore_errors=True)
        write_logs_of_project(folder / "logs")
        rest = _LOGS + PROJECTS[name] + '\n[firmware]\nout = "firmware"\n'
        (folder / "zerodrift.toml").write_text(render_toml(rest, period_s=5.0))
        done = subprocess.run(
            [sys.executable, "-m", "zerodrift", "firmware", "-C", str(folder)],
            capture_output=True, text=True, check=False,
        )  # fmt: skip
        if done.returncode != 0:
            raise SystemExit(f"{folder}: {done.stderr}")
    return folder
