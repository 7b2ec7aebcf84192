"""Small simulated pressure sensors, good and spoiled, and what the gate says of each."""

import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from zerodrift.base.config import load_config
from zerodrift.c_runtime.host import HostModel
from zerodrift.codegen.generate import generate
from zerodrift.dataset.load import load_dataset
from zerodrift.export.compose import compose_integer_model, describe_compensator
from zerodrift.operations.lowpass import lowpass
from zerodrift.train.training import train
from zerodrift.verify.gate import GateVerdict, judge_firmware
from zerodrift.verify.left_out import leave_out

Array = NDArray[np.float64]

TOML = """\
[sensor]
name = "p10"
time = "time_s"
temperature = "temperature_degC"
sample_period_s = 1.0

[outputs.p]
measured = "p_bar"
unit = "bar"
full_scale = {full_scale}

[logs]
train = ["train_*.csv"]
{test}

[[effect]]
kind = "zero_tempco"
order = 2

[network]
kind = "{network}"
"""
ROWS = 900
WANDER_STEPS = 300.0
"""In which a random drift is lost."""


@dataclass(frozen=True)
class Program:
    """One simulated run."""

    name: str
    low_degC: float = 10.0
    high_degC: float = 40.0
    logged_add: float = 0.0
    """Added to the logged temperature: 273.15 for a log in kelvin."""
    logged_times: float = 1.0
    """Factor on the logged output: 1000 for a log in mbar."""
    offset: float = 0.0
    """Of the run's own, bar: what a tare leaves."""
    rows: int = ROWS


TRAIN = (Program("train_1"), Program("train_2"), Program("train_3"), Program("train_4"))
TESTS = (Program("test_1", 14, 36), Program("test_2", 12, 38), Program("test_3", 15, 35))


def heat(program: Program) -> Program:
    """Return a run at 220 to 380 degC."""
    low, high = (
        220.0 + (end - 10.0) * 160.0 / 30.0 for end in (program.low_degC, program.high_degC)
    )
    return replace(program, low_degC=low, high_degC=high)


def write_sensor(
    directory: Path,
    programs: Sequence[Program],
    *,
    full_scale: float = 10.0,
    network: str = "none",
    noise: float = 0.002,
    span_degC: float = 15.0,
    lag_s: float = 0.0,
    wander: float = 0.0,
    seed: int = 1,
) -> Path:
    """Write zerodrift.toml and logs of a sensor that drifts with the square of temperature.

    Args:
        directory: made if missing.
        programs: its runs.
        full_scale: as the user states it.
        network: [network] kind.
        noise: RMS in bar.
        span_degC: temperature about the first run's middle at which the drift is 0.5 bar.
        lag_s: of the element behind the thermometer.
        wander: RMS in bar of a slow random drift that no compensator can know, beside that of
            temperature.
        seed: of noise and programmes.
    """
    directory.mkdir(parents=True, exist_ok=True)
    tested = any(program.name.startswith("test") for program in programs)
    text = TOML.format(
        full_scale=full_scale, network=network, test='test = ["test_*.csv"]' if tested else ""
    )
    (directory / "zerodrift.toml").write_text(text)
    middle = 0.5 * (programs[0].low_degC + programs[0].high_degC)
    rng = np.random.default_rng(seed)
    for program in programs:
        time_s = np.arange(program.rows, dtype=np.float64)
        phase, cycles = rng.uniform(0.0, 2.0 * np.pi), rng.uniform(1.2, 2.5)
        wave = 0.5 - 0.5 * np.cos(2.0 * np.pi * cycles * time_s / program.rows + phase)
        celsius = program.low_degC + (program.high_degC - program.low_degC) * wave
        celsius = np.round(celsius / 2.0**-7) * 2.0**-7
        u = (lowpass(celsius, 1.0, lag_s) - middle) / span_degC
        drift = program.offset + 0.3 * u + 0.2 * u**2 + rng.normal(0.0, noise, program.rows)
        if wander:
            kicks = rng.normal(0.0, wander * np.sqrt(2.0 / WANDER_STEPS), 2 * program.rows)
            drift += lfilter([1.0], [1.0, 1.0 / WANDER_STEPS - 1.0], kicks)[program.rows :]
        rows = zip(time_s, celsius + program.logged_add, drift * program.logged_times, strict=True)
        lines = [f"{t:g},{c:.7f},{p:.6f}" for t, c, p in rows]
        (directory / f"{program.name}.csv").write_text(
            "\n".join(["time_s,temperature_degC,p_bar", *lines]) + "\n"
        )
    return directory


def ask_gate(directory: Path) -> GateVerdict:
    """Return the gate's verdict on a project, trained and compiled for this host."""
    config = load_config(directory)
    dataset = load_dataset(config)
    compensator = train(config, dataset).compensator
    described = describe_compensator(compensator, config, dataset.train)
    model = compose_integer_model(described, config, dataset)
    with tempfile.TemporaryDirectory() as scratch:
        host = HostModel(model, generate(model), Path(scratch), observe=False)
        left_out = leave_out(config, dataset, compensator)
        return judge_firmware(described, host, dataset, left_out)[0]


def list_kinds(verdict: GateVerdict) -> set[str]:
    """Return the kinds of the refusals."""
    return {statement.kind for statement in verdict.refused}
