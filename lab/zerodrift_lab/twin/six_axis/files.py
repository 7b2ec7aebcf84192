"""Recordings as files: logs at force or converter level, CAN frames, config, truth, README."""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import polars as pl

from zerodrift_lab.twin.disturbances import DISTURBANCES
from zerodrift_lab.twin.project import CHANNEL_COLUMNS, name_outputs
from zerodrift_lab.twin.sensor import OUTPUTS, UNITS
from zerodrift_lab.twin.six_axis.can import render_candump, render_dbc
from zerodrift_lab.twin.six_axis.heat import NODES
from zerodrift_lab.twin.six_axis.project import render_config
from zerodrift_lab.twin.six_axis.record import Recording
from zerodrift_lab.twin.six_axis.specimen import Sensor

LEVELS = ("force", "adc", "can")
ADC_COLUMNS = tuple(f"adc_{number}" for number in range(1, 7))

_README = """\
# Simulated logs of the six-axis twin

Written by `zerodrift twin --six-axis` (specimen {sensor}). **No sensor was measured**: every
number here is simulated, after the six-axis photo-coupler sensor of arXiv 2502.17528.

{body}- `truth.json`: what the simulated sensor is in fact. No command reads it.

{next}
"""
_BODY = {
    "force": "- `zerodrift.toml` and `logs/`: {count} runs at {period:g} s per sample.\n",
    "adc": (
        "- `adc/`: {count} runs at {period:g} s per sample, as converter codes with references.\n"
        "- `zerodrift.toml`: reads forces from `logs/`, which the next command makes.\n"
    ),
    "can": (
        "- `zerodrift.toml` and `logs/`: {count} runs at {period:g} s per sample.\n"
        "- `can/`: the same runs as CAN frames (candump text), decoded by `sensor.dbc`.\n"
    ),
}
_NEXT = {
    "force": "Next: `zerodrift compare`, `zerodrift diagnose`, `zerodrift train`.",
    "adc": "Next: `zerodrift calibrate adc/weights_1.csv --apply adc --out logs`.",
    "can": "Next: `zerodrift compare`, `zerodrift diagnose`, `zerodrift train`.",
}


@dataclass(frozen=True)
class Campaign:
    """The recordings of one specimen by their use."""

    sensor: Sensor
    train: tuple[Recording, ...]
    test: tuple[Recording, ...] = ()
    dwell: tuple[Recording, ...] = ()
    weights: tuple[Recording, ...] = ()
    """Test weights at room temperature, for a calibration from converter codes."""

    @property
    def runs(self) -> tuple[Recording, ...]:
        """All recordings."""
        return self.train + self.test + self.dwell + self.weights


def render_log(run: Recording, channels: Sequence[str], *, codes: bool = False) -> bytes:
    """Return one run as CSV: raw forces, or with `codes` the converter's, and references."""
    columns: dict[str, Any] = {
        "time_s": run.time_s,
        "temperature_degC": run.temperature_degC,
    }
    if codes:
        columns |= {name: run.adc[:, k] for k, name in enumerate(ADC_COLUMNS)}
    else:
        columns |= {name: run.measured[:, k] for k, name in enumerate(name_outputs())}
    columns |= {f"ref_{name}": run.reference[:, k] for k, name in enumerate(name_outputs())}
    available = {**run.channels, "body_temperature": run.body_temperature_degC}
    columns |= {CHANNEL_COLUMNS[name]: available[name] for name in channels}
    return pl.DataFrame(columns).write_csv().encode()


def _name(values: Sequence[float]) -> dict[str, float]:
    return dict(zip(OUTPUTS, values, strict=True))


def describe_truth(campaign: Campaign) -> dict[str, Any]:
    """Return the truth about specimen and runs as plain data."""
    sensor = campaign.sensor
    couplers, structure = sensor.couplers, sensor.structure
    runs = [
        {
            "name": run.name,
            "protocol": run.protocol,
            "seconds": run.seconds,
            "temperature_degC": [
                float(run.temperature_degC.min()),
                float(run.temperature_degC.max()),
            ],
            "drift_rms": _name(np.sqrt(np.mean(run.drift**2, axis=0)).tolist()),
            "noise_floor": _name(run.floor.tolist()),
        }
        for run in campaign.runs
    ]
    effects = {
        hidden.name: {
            "parameters": dict(hidden.parameters),
            "size": hidden.size,
            "columns": []
            if hidden.coefficients is None
            else list(DISTURBANCES[hidden.name].terms[: hidden.coefficients.shape[1]]),
            "coefficients": None
            if hidden.coefficients is None
            else {
                output: row.tolist()
                for output, row in zip(OUTPUTS, hidden.coefficients, strict=True)
            },
        }
        for hidden in sensor.effects
    }
    return {
        "simulated": True,
        "note": "The truth behind simulated logs. No command of zerodrift reads this file.",
        "specimen": sensor.seed,
        "units": dict(zip(OUTPUTS, UNITS, strict=True)),
        "drift_from_-20_to_60_degC": _name(sensor.drift_span().tolist()),
        "noise_rms": _name(sensor.noise_rms.tolist()),
        "calibration": sensor.calibration.tolist(),
        "codes_without_load": sensor.zero.tolist(),
        "couplers": {
            "rest_distance_mm": couplers.rest_distance_mm.tolist(),
            "peak_distance_mm": couplers.peak_distance_mm.tolist(),
            "peak_current_nA": couplers.peak_current_na.tolist(),
            "dark_current_nA": couplers.dark_current_na.tolist(),
            "doubling_K": couplers.doubling_kelvin.tolist(),
            "light_ppm_per_K": couplers.light_ppm_per_k.tolist(),
            "open_loop_percent_per_K": couplers.open_loop_percent_per_k.tolist(),
        },
        "structure": {
            "gap_mm_per_load": structure.sensitivity.tolist(),
            "modulus_percent_per_K": structure.modulus_percent_per_k,
            "aluminium_ppm_per_K": structure.aluminium_ppm_per_k,
            "column_mm": structure.column_mm.tolist(),
            "side_lever_mm": structure.side_lever_mm.tolist(),
        },
        "heat": {
            "nodes": list(NODES),
            "capacity_J_per_K": sensor.network.capacity.tolist(),
            "conductance_W_per_K": sensor.network.inner.tolist(),
            "outer_area_m2": sensor.network.outer_area.tolist(),
            "plate_conductance_W_per_K": sensor.network.plate_conductance,
        },
        "effects": effects,
        "runs": runs,
    }


def render_files(
    campaign: Campaign, level: str = "force", channels: Sequence[str] = ()
) -> dict[str, bytes]:
    """Return every file by its name relative to the project directory.

    `level` is one of `LEVELS`: `force` is raw forces, `adc` converter codes in `adc/`, `can` raw
    forces and the CAN frames beside them.
    """
    files: dict[str, bytes] = {}
    for run in campaign.runs:
        if level == "adc":
            files[f"adc/{run.name}.csv"] = render_log(run, channels, codes=True)
        else:
            files[f"logs/{run.name}.csv"] = render_log(run, channels)
        if level == "can":
            files[f"can/{run.name}.log"] = render_candump(run).encode()
    if level == "can":
        files["sensor.dbc"] = render_dbc().encode()
    body = _BODY[level].format(count=len(campaign.runs), period=campaign.train[0].sample_period_s)
    readme = _README.format(sensor=campaign.sensor.name, body=body, next=_NEXT[level])
    config = render_config(campaign.train, campaign.test, campaign.dwell, channels=channels)
    truth = json.dumps(describe_truth(campaign), indent=1) + "\n"
    return files | {
        "README.md": readme.encode(),
        "truth.json": truth.encode(),
        "zerodrift.toml": config.encode(),
    }
