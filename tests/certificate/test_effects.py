"""Every effect of the catalogue in C: its certificate holds, and its error budget adds up."""

import json
from pathlib import Path

import numpy as np
import pytest

from tests.certificate.test_check import build_files, count_claims
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
    calibrate,
    compose_integer_model,
    describe_compensator,
    predict_integer,
)
from zerodrift.physics.catalogue import load_catalogue
from zerodrift.verify.chip_error import measure_budget
from zerodrift_proof.certificate.check import compare

pytestmark = pytest.mark.long

WITH = (EffectConfig("zero_tempco", {"order": 2}), EffectConfig("dark_current"))
VARIANTS = [(kind, dict(v)) for kind, effect in load_catalogue().items() for v in effect.variants]


@pytest.mark.parametrize("first", range(0, len(VARIANTS), 8))
def test_certificate_of_every_effect_is_derived_again(first: int) -> None:
    for kind, variant in VARIANTS[first : first + 8]:
        others = [effect for effect in WITH if effect.kind != kind]
        physics = make_physics([*others, EffectConfig(kind, variant)], draw_runs())
        compensator, runs = make_compensator(physics, draw_runs())
        described = describe_compensator(compensator, make_config(), runs)
        model = compose_integer_model(described, make_config(), make_dataset(runs))
        certificate, texts = build_files(model)
        claims = json.loads(certificate)
        outcome = compare(claims, texts)
        assert outcome.failures == (), f"{kind} {variant}"
        assert outcome.holds == count_claims(claims)


@pytest.mark.parametrize("kind", ["span_tempco", "creep", "warm_up"])
def test_budget_adds_up_with_loads_and_time(kind: str, tmp_path: Path) -> None:
    """Where the drift feeds back into the load, too."""
    physics = make_physics([*WITH, EffectConfig(kind)], draw_runs())
    compensator, runs = make_compensator(physics, draw_runs())
    config, dataset = make_config(), make_dataset(runs)
    described = describe_compensator(compensator, config, dataset.train)
    model = compose_integer_model(described, config, dataset)
    calibration = calibrate(described, dataset.train)
    host = HostModel(model, generate(model), tmp_path, flags=("-O1",))
    budget = measure_budget(described, calibration, host, runs, steps=1000)
    errors = [predict_integer(model, run) - described.predict_on_chip(run) for run in runs]
    measured = np.sqrt(np.mean(np.concatenate(errors) ** 2, axis=0))
    np.testing.assert_allclose(budget.total, measured, rtol=0.01)
