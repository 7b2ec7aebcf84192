"""Every effect of the catalogue, in every variant, goes to C and computes what the float computed.

The float model and the integers see the same inputs; loads are what the compensator leaves of the
raw output in both.
"""

from pathlib import Path

import numpy as np
import pytest
from tests.effects_on_chip.bench import (
    draw_runs,
    make_compensator,
    make_config,
    make_dataset,
    make_physics,
)

from zerodrift.base.config import EffectConfig
from zerodrift.c_runtime.host import HostModel
from zerodrift.codegen.generate import generate
from zerodrift.export.compose import (
    compose_integer_model,
    describe_compensator,
    encode_inputs,
    predict_integer,
)
from zerodrift.physics.catalogue import Catalogue, load_catalogue
from zerodrift.verify.host_check import check_host
from zerodrift.verify.vectors import draw_sequences

LARGEST_ERROR_PCT = 0.01
"""Of the drift's RMS; most of it is the rounding to the output's counts."""
CASES = [
    pytest.param(kind, dict(variant), id=f"{kind}-{'-'.join(f'{v:g}' for v in variant.values())}")
    for kind, effect in load_catalogue().items()
    for variant in effect.forms
]
REWRITTEN = (EffectConfig("zero_tempco", {"order": 2}), EffectConfig("dark_current"))
"""What the effects that rewrite the temperature act on."""


@pytest.mark.spread(8, ("kind", "variant"), CASES)
def test_effect_is_the_same_on_the_chip(
    kind: str, variant: dict[str, float], tmp_path: Path
) -> None:
    others = [effect for effect in REWRITTEN if effect.kind != kind]
    check([*others, EffectConfig(kind, variant)], tmp_path)


@pytest.mark.spread(1, "delay_s", [-3.3, 0.25, 7.0, 7.6])
def test_clock_delay_by_any_time_is_the_same_on_the_chip(delay_s: float, tmp_path: Path) -> None:
    check([*REWRITTEN, EffectConfig("clock_delay", {"delay_s": delay_s})], tmp_path)


def test_effect_on_another_thermometer_is_the_same_on_the_chip(tmp_path: Path) -> None:
    lagged = EffectConfig("thermal_lag", {"tau_s": 40.0}, {"signal": "body_temperature"})
    seen = EffectConfig("dark_current", options={"signal": "body_temperature"})
    check([EffectConfig("zero_tempco"), lagged, seen], tmp_path)


EXTREMA = """
from zerodrift.physics.catalogue import register
from zerodrift.physics.effect import Effect, Feature


def build(ops, signals, p):
    rate = ops.difference(
        signals.temperature_degC, ops.lowpass(signals.temperature_degC, 200.0)
    )
    heating, cooling = ops.maximum(rate, ops.constant(0.0)), ops.minimum(rate, ops.constant(0.0))
    slower = ops.minimum(heating, ops.lowpass(heating, 50.0))
    return [Feature("heating", ops.maximum(slower, cooling), "K")]


register(Effect(kind="heating_alone", title="heating", build=build, parameters=(),
                needs=("temperature",), equation="drift = k max(rate, 0)"))
"""


def test_effect_of_a_user_with_extrema_is_the_same_on_the_chip(tmp_path: Path) -> None:
    (tmp_path / "my_effects.py").write_text(EXTREMA, encoding="utf-8")
    catalogue = load_catalogue([tmp_path / "my_effects.py"])
    check([EffectConfig("heating_alone")], tmp_path, catalogue)


def check(effects: list[EffectConfig], folder: Path, catalogue: Catalogue | None = None) -> None:
    """Build a compensator of these effects; compare float, reference and host C."""
    compensator, runs = make_compensator(make_physics(effects, draw_runs(), catalogue), draw_runs())
    described = describe_compensator(compensator, make_config(), runs)
    model = compose_integer_model(described, make_config(), make_dataset(runs))
    for run in runs:
        wanted = described.predict_on_chip(run)
        error = predict_integer(model, run) - wanted
        share = np.sqrt(np.mean(error**2, axis=0) / np.mean(wanted**2, axis=0))
        assert (100.0 * share).max() < LARGEST_ERROR_PCT
    host = HostModel(model, generate(model), folder, flags=("-O1",))
    assert host.selftest() == 0
    sequences = {"log": encode_inputs(model, runs[0])[:1500], **draw_sequences(model, 1500)}
    for settled, (name, codes) in enumerate(sequences.items()):
        outcome = check_host(host, codes, settled=settled % 2 == 0)
        assert outcome.mismatch is None, f"{name}: {outcome.mismatch}"
