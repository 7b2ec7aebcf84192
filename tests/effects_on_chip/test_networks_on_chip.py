"""Every kind of `[network]` goes to C and computes what the float computed, bit for bit."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.effects_on_chip.bench import draw_runs, make_config, make_dataset

from zerodrift.base.config import Config, EffectConfig, NetworkConfig
from zerodrift.c_runtime.host import HostModel
from zerodrift.codegen.generate import generate
from zerodrift.dataset.runs import Run
from zerodrift.export.compose import (
    compose_integer_model,
    describe_compensator,
    encode_inputs,
    predict_integer,
)
from zerodrift.operations.lowpass import lowpass
from zerodrift.train.compensator import Compensator
from zerodrift.train.lag_bank import units
from zerodrift.train.lag_bank.units import Trial, list_trials
from zerodrift.train.training import train
from zerodrift.verify.certificate import certify
from zerodrift.verify.firmware import recheck
from zerodrift.verify.firmware_check import check_onnx
from zerodrift.verify.host_check import check_host
from zerodrift.verify.onnx_model import OnnxModel
from zerodrift.verify.vectors import draw_sequences

pytestmark = pytest.mark.long

LARGEST_ERROR_PCT = {"lag_bank": 0.02, "many units": 0.1, "mlp": 0.3, "mlp_seq": 0.3, "tcn": 0.3}
"""Of the drift's RMS; int16 weights and copies of three layers, against powers in 32 bits."""
LENGTH = 1500
SPAN = 0.002
"""Of the load, per kelvin."""
CURVE = 0.02
"""Of the load at its largest, as a share of it."""
NETWORKS = {
    "lag_bank": NetworkConfig(kind="lag_bank", hidden=6, lags_s=(45.0, 400.0)),
    "many units": NetworkConfig(kind="lag_bank", hidden=16, lags_s=(45.0, 400.0)),
    "mlp": NetworkConfig(kind="mlp", hidden=6, lags_s=(30.0,)),
    "mlp_seq": NetworkConfig(kind="mlp_seq", hidden=6, memory=4, lags_s=(30.0,)),
    "tcn": NetworkConfig(
        kind="tcn", hidden=4, memory=6, lags_s=(30.0,), options={"spacing_s": 3.0}
    ),
}


def add_drift(run: Run, *, loaded: bool) -> Run:
    """Return the run with the drift of a sensor whose body lags behind its thermometer."""
    body = lowpass(run.temperature_degC, run.sample_period_s, 45.0) - 25.0
    other = lowpass(run.temperature_degC, run.sample_period_s, 400.0) - 25.0
    rng = np.random.default_rng(len(run.name) + int(run.temperature_degC[0] * 128))
    drift = np.stack(
        [
            0.4 * body + 2.0 * np.tanh(body / 2.0) - 0.1 * other,
            0.01 * body - 0.03 * 2.0 ** (body / 9.0),
        ],
        axis=1,
    )
    reference = run.reference if loaded else np.zeros_like(run.reference)
    drift = drift + SPAN * (run.temperature_degC - 25.0)[:, None] * reference
    largest = np.maximum(np.abs(reference).max(axis=0), 1e-300)
    drift = drift + CURVE * reference**2 / largest
    noise = rng.normal(size=drift.shape) * np.array([0.02, 0.0005])
    return replace(run, reference=reference, measured=reference + drift + noise)


def train_network(
    kind: str, folder: Path, *, loaded: bool = False, epochs: int = 120
) -> tuple[Compensator, Config]:
    """Return a compensator with a small network of a kind, trained for a moment."""
    runs = tuple(add_drift(run, loaded=loaded) for run in draw_runs(4, LENGTH))
    config = replace(
        make_config(),
        path=folder / "zerodrift.toml",
        network=NETWORKS[kind],
        effects=(EffectConfig("zero_tempco"),),
    )
    trained = train(config, make_dataset(runs), epochs=epochs, starts=1)
    return trained.compensator, config


@pytest.mark.parametrize("kind", NETWORKS)
def test_network_is_the_same_on_the_chip(
    kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def list_many(*arguments: Any, **options: Any) -> list[Trial]:
        return list_trials(*arguments, **options)[1:]

    if kind == "many units":  # whatever the logs ask for
        monkeypatch.setattr(units, "list_trials", list_many)
    compensator, config = train_network(kind, tmp_path)
    runs = tuple(add_drift(run, loaded=False) for run in draw_runs(4, LENGTH))
    assert compensator.network is not None
    if kind == "many units":
        assert compensator.bank is not None
        assert compensator.bank.degree == 1
    compare(compensator, config, runs, LARGEST_ERROR_PCT[kind], tmp_path)


def test_loads_of_a_lag_bank_are_the_same_on_the_chip(tmp_path: Path) -> None:
    compensator, config = train_network("lag_bank", tmp_path, loaded=True)
    runs = tuple(add_drift(run, loaded=True) for run in draw_runs(4, LENGTH))
    assert compensator.bank is not None
    assert {names for names, _ in compensator.bank.loads} >= {("Fz",), ("Mx",), ("Fz", "Fz")}
    compare(compensator, config, runs, LARGEST_ERROR_PCT["lag_bank"], tmp_path)


def compare(
    compensator: Compensator, config: Config, runs: tuple[Run, ...], largest: float, folder: Path
) -> None:
    """Compare float, reference, host C, integer ONNX; check the certificate against the C."""
    described = describe_compensator(compensator, config, runs)
    model = compose_integer_model(described, config, make_dataset(runs))
    for run in runs[:2]:
        wanted = described.predict_on_chip(run)
        error = predict_integer(model, run) - wanted
        share = np.sqrt(np.mean(error**2, axis=0) / np.mean(wanted**2, axis=0))
        assert (100.0 * share).max() < largest
    code = generate(model)
    host = HostModel(model, code, folder / "host", flags=("-O1",))
    assert host.selftest() == 0
    sequences = {"log": encode_inputs(model, runs[0])[:1000], **draw_sequences(model, 600)}
    for settled, (name, codes) in enumerate(sequences.items()):
        outcome = check_host(host, codes, settled=settled % 2 == 0)
        assert outcome.mismatch is None, f"{name}: {outcome.mismatch}"
    onnx = check_onnx(OnnxModel(model, observe=True), host, sequences["log"][:200])
    assert onnx.mismatch is None, onnx.mismatch
    assert recheck(code, certify(model, code), folder).holds > 0


@pytest.mark.parametrize("kind", ["lag_bank", "many units", "tcn"])
def test_saved_compensator_predicts_the_same(kind: str, tmp_path: Path) -> None:
    compensator, _ = train_network(kind, tmp_path, epochs=60)
    run = add_drift(draw_runs(1, LENGTH)[0], loaded=False)
    compensator.save(tmp_path, tmp_path / "build")
    again = Compensator.load(tmp_path / "build")
    assert np.array_equal(again.predict(run), compensator.predict(run))
    assert (again.parameters, again.macs_per_step) == (
        compensator.parameters,
        compensator.macs_per_step,
    )
