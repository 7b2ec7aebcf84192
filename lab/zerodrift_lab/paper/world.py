"""The simulated logs of the paper's experiments: which runs there are, and who may see them.

Training and test runs are different draws of the same protocols; a test run is never trained on.
"""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np

from zerodrift.base.arrays import Array
from zerodrift.dataset.runs import Run
from zerodrift_lab.twin.six_axis import (
    draw_sensor,
    load_protocol,
    record,
    to_run,
)

BODY = "body_temperature"
"""The second thermometer, on the elastic body."""
PERIOD_S = 2.0
STILL = Path(__file__).parent / "walking_still.txt"
"""The walk's plates without strides: the drift of walking alone."""

CHAMBER_CYCLES = 6
VARIED = (
    ("heating", 2),
    ("cooling", 2),
    ("walking_still", 4),
    ("standing", 2),
    ("lamp_steps", 2),
)
"""Twelve bench logs, every protocol of the tests among them in draws of its own."""
UNWALKED = (("heating", 2), ("cooling", 2), ("standing", 4), ("lamp_steps", 4))
"""Twelve bench logs, none of which stands on the plates of the walk."""
LOADED_CYCLES = 3

TESTS: dict[str, tuple[str, int]] = {
    "chamber": ("chamber", 2),
    "heating": ("heating", 2),
    "cooling": ("cooling", 2),
    "walking": ("walking", 2),
    "walking_still": (str(STILL), 2),
    "chamber_loaded": ("chamber_loaded", 2),
}
"""Test -> protocol, and how many draws of it. Two walks stand for two feet."""

TRAIN_SEED, TEST_SEED = 1, 2
"""Of the runs' draws; the specimen has a seed of its own."""


@dataclass(frozen=True)
class Trial:
    """A run with what only the simulation knows of it."""

    run: Run
    floor: Array
    """[K] RMSE of a model without error: noise, steps, and the reference's own."""


def _record(sensor: int, protocol: str, name: str, seed: int, body: bool) -> Trial:
    recording = record(
        draw_sensor(sensor), load_protocol(protocol), name=name, seed=seed, period_s=PERIOD_S
    )
    return Trial(to_run(recording, (BODY,) if body else ()), recording.floor)


@lru_cache(maxsize=64)
def record_training(sensor: int, logs: str, body: bool) -> tuple[Run, ...]:
    """Return the training runs of a specimen.

    Args:
        sensor: the specimen's seed.
        logs: chamber | varied (chamber and bench logs) | unwalked (likewise, but none of the
            walk's plates) | loaded (varied, and chamber cycles with test weights).
        body: whether the logs hold the second thermometer.
    """
    wanted = [("chamber", CHAMBER_CYCLES)]
    if logs in ("varied", "loaded"):
        wanted += VARIED
    if logs == "unwalked":
        wanted += UNWALKED
    if logs == "loaded":
        wanted.append(("chamber_loaded", LOADED_CYCLES))
    return tuple(
        _record(
            sensor, TESTS.get(protocol, (protocol, 0))[0], f"{protocol}_{number}", TRAIN_SEED, body
        ).run
        for protocol, count in wanted
        for number in range(1, count + 1)
    )


@lru_cache(maxsize=64)
def record_test(sensor: int, test: str, body: bool) -> tuple[Trial, ...]:
    """Return the runs of a test, which no training has seen."""
    protocol, count = TESTS[test]
    return tuple(
        _record(sensor, protocol, f"test_{test}_{number}", TEST_SEED, body)
        for number in range(1, count + 1)
    )


def pool_floor(trials: Sequence[Trial]) -> Array:
    """Return the noise floor [K] of several runs together."""
    samples = np.array([len(trial.run) for trial in trials], dtype=np.float64)
    squares = np.stack([trial.floor**2 for trial in trials])
    return np.asarray(np.sqrt(samples @ squares / samples.sum()))


@lru_cache(maxsize=64)
def digest_logs(sensor: int, logs: str, body: bool) -> str:
    """Return the hash of all numbers that a fit and its tests read."""
    digest = hashlib.sha256()
    tests = [trial for test in TESTS for trial in record_test(sensor, test, body)]
    for run in (*record_training(sensor, logs, body), *(trial.run for trial in tests)):
        digest.update(run.name.encode() + b"\0")
        for values in (run.temperature_degC, run.measured, run.reference, *run.inputs.values()):
            digest.update(np.ascontiguousarray(values).tobytes())
    for trial in tests:
        digest.update(trial.floor.tobytes())
    return digest.hexdigest()
