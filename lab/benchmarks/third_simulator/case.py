"""A case: its logs as a user would have them, and the truth, which no log holds."""

import json
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import polars as pl

from benchmarks.third_simulator.families import INPUTS, Family
from benchmarks.third_simulator.heat import Array, Flags


@dataclass(frozen=True, eq=False)
class Log:
    """One run as it was recorded.

    Attributes:
        name: of its file.
        use: train, test or dwell.
        columns: column -> shape (rows,).
        drift: shape (rows, outputs), true and free of noise.
        wild: shape (rows, outputs), rows that the recorder spoilt.
    """

    name: str
    use: str
    columns: dict[str, Array]
    drift: Array
    wild: Flags


@dataclass(frozen=True)
class Size:
    """How large one hidden effect is, in RMS of the noise, at the output that feels it most.

    Attributes:
        raw: RMS about its mean, training runs.
        train: RMS that the base model leaves, fitted to all training runs together.
        test: RMS that the same fit leaves on the test runs.
        per_run: RMS left where every run may have a polynomial of temperature of its own.
        taken_up: share of `raw` that the base model takes as its own.
    """

    raw: float
    train: float
    test: float
    per_run: float
    taken_up: float


@dataclass(frozen=True)
class Truth:
    """What is known because it was simulated.

    Attributes:
        seed: of the case.
        family: of the sensor.
        effects: hidden, by the catalogue's name or that of an effect outside it.
        name: the catalogue's name of the one hidden effect, "outside", or None.
        sizes: effect -> its size.
        noise_rms: per output, of what is neither load nor drift on the test runs, wild rows apart.
        noise_expected: the same by the recorder's design, of which sizes are multiples.
        base_left: per output, RMS that the base model leaves of the nominal drift alone over the
            noise: what a complete model lacks all the same.
        noise: kind.
        outliers: share of wild rows asked for.
    """

    seed: int
    family: str
    effects: tuple[str, ...]
    name: str | None
    sizes: dict[str, Size]
    noise_rms: tuple[float, ...]
    noise_expected: float
    base_left: tuple[float, ...]
    noise: str
    outliers: float


@dataclass(frozen=True, eq=False)
class Case:
    """One sensor, its logs, the model that its user begins with, and the truth.

    Attributes:
        family: of the sensor.
        outputs: names, in the order of the arrays.
        full_scale: in the family's unit.
        period_s: of rows.
        loaded: whether loads are applied and a reference is logged.
        base: [[effect]] tables: kind, and its options.
        inputs: names of [inputs] that are logged.
        logs: every run.
        truth: what is known.
    """

    family: Family
    outputs: tuple[str, ...]
    full_scale: float
    period_s: float
    loaded: bool
    base: tuple[dict[str, str | int], ...]
    inputs: tuple[str, ...]
    logs: tuple[Log, ...]
    truth: Truth

    @property
    def test_drift(self) -> dict[str, Array]:
        """True drift of each test run, shape (rows, outputs), row by row as in its log."""
        return {log.name: log.drift for log in self.logs if log.use == "test"}

    def render_toml(self) -> str:
        """Return zerodrift.toml."""
        uses = {log.use for log in self.logs}
        lines = [
            "# Simulated: the third simulator.",
            "[sensor]",
            f'name = "{self.family.name}"',
            'time = "time_s"',
            'temperature = "temperature_degC"',
            f"sample_period_s = {self.period_s}",
        ]
        for name in self.outputs:
            lines += ["", f"[outputs.{name}]", f'measured = "{name}_measured"']
            lines += [f'reference = "{name}_reference"'] * self.loaded
            lines += [f'unit = "{self.family.unit}"', f"full_scale = {self.full_scale}"]
        if self.inputs:
            lines += ["", "[inputs]", *(f'{name} = "{INPUTS[name]}"' for name in self.inputs)]
        lines += ["", "[logs]"]
        lines += [
            f'{use} = ["logs/{use}*.csv"]' for use in ("train", "test", "dwell") if use in uses
        ]
        for effect in self.base:
            lines += ["", "[[effect]]"]
            lines += [f"{key} = {json.dumps(value)}" for key, value in effect.items()]
        return "\n".join(lines) + "\n"

    def write(self, folder: Path) -> None:
        """Write zerodrift.toml, logs/RUN.csv, and beside them truth/: truth.json, RUN.csv."""
        (folder / "logs").mkdir(parents=True, exist_ok=True)
        (folder / "truth").mkdir(exist_ok=True)
        (folder / "zerodrift.toml").write_text(self.render_toml(), encoding="utf-8")
        for log in self.logs:
            pl.DataFrame(log.columns).write_csv(folder / "logs" / f"{log.name}.csv")
            drift = {f"{name}_drift": log.drift[:, n] for n, name in enumerate(self.outputs)}
            drift["time_s"] = log.columns["time_s"]
            pl.DataFrame(drift).write_csv(folder / "truth" / f"{log.name}.csv")
        told = json.dumps(asdict(self.truth), indent=2) + "\n"
        (folder / "truth" / "truth.json").write_text(told, encoding="utf-8")

    def measure_error(self, predicted: dict[str, Array]) -> tuple[float, ...]:
        """Return RMS of predicted less true drift on the test runs, over the noise, per output.

        Args:
            predicted: test run -> shape (rows, outputs), row by row as in its log.
        """
        missed = np.concatenate([predicted[name] - true for name, true in self.test_drift.items()])
        rms = np.sqrt(np.mean(missed**2, axis=0))
        return tuple(
            float(one / noise) for one, noise in zip(rms, self.truth.noise_rms, strict=True)
        )
