"""The five projects, their simulated logs, and how one becomes a model and C."""

import hashlib
import re
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np

from tests.projects import render_toml
from zerodrift.base.config import load_config
from zerodrift.codegen.generate import generate
from zerodrift.dataset.load import load_dataset
from zerodrift.export.compose import compose_integer_model, describe_compensator, describe_imported
from zerodrift.export.onnx_reader import read_imported
from zerodrift.physics.catalogue import load_catalogue
from zerodrift.train.compensator import Compensator
from zerodrift_lab.twin.example import ensure_example_logs

ROOT = Path(__file__).parents[2]
STORED = Path(__file__).parent / "stored"
EXPECTED = STORED / "expected.json"
IMPORTED = ROOT / "tests/onnx/exported/torch_dynamo_stream_two_layers.onnx"
LOGS = '[logs]\ntrain = ["logs/run[0-3].csv"]\ntest = ["logs/run4.csv"]\n'
PHYSICS = """
[[effect]]
kind = "zero_tempco"

[[effect]]
kind = "dark_current"

[[effect]]
kind = "thermal_lag"

[[effect]]
kind = "thermal_hysteresis"

[[effect]]
kind = "creep"
"""
OWN = """
[[effect]]
kind = "second_order_lag"

[plugins]
files = ["own.py"]
"""
EFFECT = """\
from zerodrift.physics.catalogue import register
from zerodrift.physics.effect import Effect, Feature, Parameter


def build(ops, signals, p):
    \"\"\"The temperature after two equal lags.\"\"\"
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
"""
INPUTS = '[inputs]\nsupply = "supply_V"\nhumidity = "humidity_pct"\n\n'
NONE, BANK = '\n[network]\nkind = "none"\n', '\n[network]\nkind = "lag_bank"\n'
TOMLS = {
    "physics": LOGS + PHYSICS + NONE,
    "lag_bank": LOGS + '\n[[effect]]\nkind = "zero_tempco"\n' + BANK,
    "own_effect": LOGS + OWN + NONE,
    "imported": INPUTS + LOGS + NONE,
}
NAMES = (*TOMLS, "ft40")


def write_project(name: str, folder: Path) -> Path:
    """Write a project with its logs, and the stored parameters where there are any."""
    if name == "ft40":
        folder.mkdir()
        for file in ("zerodrift.toml", "twin.json"):
            shutil.copy(ROOT / "examples/ft40" / file, folder)
        ensure_example_logs(folder)
    else:
        (folder / "logs").mkdir(parents=True)
        (folder / "zerodrift.toml").write_text(
            render_toml(TOMLS[name], name=f"frozen_{name}"), encoding="utf-8"
        )
        (folder / "own.py").write_text(EFFECT, encoding="utf-8")
        for number in range(5):
            write_log(folder / f"logs/run{number}.csv", number)
    kept = STORED / name
    if kept.is_dir():
        shutil.copytree(kept, folder / "build")
    return folder


def write_log(path: Path, seed: int) -> None:
    """Write a simulated log of a lagging, hysteretic, creeping sensor, rounded to fixed digits."""
    rng = np.random.default_rng(seed)
    time_s = np.arange(1500.0)
    swing = 15.0 * np.sin(2 * np.pi * time_s / (500.0 + 130.0 * seed) + seed)
    temperature = 25.0 + swing + rng.normal(0.0, 0.01, time_s.size)
    load = 200.0 * (np.sin(time_s / 170.0 + seed) > 0.3)
    lagged, crept = np.empty_like(time_s), np.empty_like(time_s)
    body, slow = temperature[0], load[0]
    for i, (now, force) in enumerate(zip(temperature, load, strict=True)):
        body += (now - body) / 60.0
        slow += (force - slow) / 200.0
        lagged[i], crept[i] = body, slow
    drift = 0.8 * (lagged - 25.0) + 0.3 * 2.0 ** ((lagged - 25.0) / 10.0) + 0.004 * crept
    columns = {
        "time_s": (time_s, 0),
        "temperature_degC": (temperature, 4),
        "Fz_N": (load + drift + rng.normal(0.0, 0.05, time_s.size), 4),
        "ref_Fz_N": (load, 1),
        "supply_V": (3.3 + 0.05 * np.sin(time_s / 90.0 + seed), 4),
        "humidity_pct": (45.0 + 10.0 * np.cos(time_s / 400.0 + seed), 2),
        "Mx_Nm": (0.02 * drift + rng.normal(0.0, 0.002, time_s.size), 6),
        "ref_Mx_Nm": (np.zeros_like(time_s), 1),
    }
    rows = zip(*([f"{v:.{d}f}" for v in x] for x, d in columns.values()), strict=True)
    text = "\n".join([",".join(columns), *(",".join(row) for row in rows)])
    path.write_text(text + "\n", encoding="utf-8")


def render_texts(name: str, folder: Path) -> dict[str, str]:
    """Return model.json, header and source of a project that `write_project` wrote."""
    config = load_config(folder)
    dataset = load_dataset(config)
    if name == "imported":
        described, _ = describe_imported(read_imported(IMPORTED), config, dataset.train)
    else:
        compensator = Compensator.load(folder / "build", load_catalogue(config.plugin_files))
        described = describe_compensator(compensator, config, dataset.train)
    model = compose_integer_model(described, config, dataset)
    code = generate(model)
    return {"model.json": model.to_text(), ".h": code.header, ".c": code.source}


def digest(text: str) -> str:
    """Return a text's hash, the line with the version apart."""
    plain = re.sub(r"generated by zerodrift \S+;", "generated by zerodrift;", text)
    return hashlib.sha256(plain.encode()).hexdigest()


Digests = dict[str, dict[str, str]]
Write = Callable[[str, Path], Path]
