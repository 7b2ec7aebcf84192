"""A fit that is asked for again is not made again, and no other is taken for it."""

import gc
import weakref
from dataclasses import replace

import numpy as np
from tests.physics.conftest import FULL_SCALE, OUTPUTS, UNITS, linear, make_dataset

from zerodrift.base.config import EffectConfig
from zerodrift.physics.catalogue import load_catalogue
from zerodrift.physics.fit import fit

NAMES = {"outputs": OUTPUTS, "units": UNITS, "full_scale": FULL_SCALE}


def test_fit_asked_for_again_is_the_known_one_and_that_of_equal_runs_is_not():
    dataset = make_dataset(linear, runs=3, length=200)
    catalogue, effects = load_catalogue(), [EffectConfig("zero_tempco")]
    first = fit(effects, dataset.train, **NAMES, catalogue=catalogue)
    line = [replace(effects[0])]
    assert fit(line, dataset.train, **NAMES, catalogue=catalogue) is first
    equal = tuple(replace(run) for run in dataset.train)
    again = fit(effects, equal, **NAMES, catalogue=catalogue)
    assert again is not first
    assert np.array_equal(again.coefficients, first.coefficients)


def test_fit_of_other_effects_scales_catalogue_or_fewer_runs_is_another():
    dataset = make_dataset(linear, runs=3, length=200)
    catalogue, effects = load_catalogue(), [EffectConfig("zero_tempco")]
    first = fit(effects, dataset.train, **NAMES, catalogue=catalogue)
    held = [EffectConfig("zero_tempco", held={"order": 1.0})]
    scales = {**NAMES, "full_scale": (1000.0, 14.0)}
    others = [
        fit([], dataset.train, **NAMES, catalogue=catalogue),
        fit(held, dataset.train, **NAMES, catalogue=catalogue),
        fit(effects, dataset.train[:2], **NAMES, catalogue=catalogue),
        fit(effects, dataset.train, **scales, catalogue=catalogue),
        fit(effects, dataset.train, **NAMES, catalogue=load_catalogue()),
        fit(effects, dataset.train, **NAMES, catalogue=catalogue, start=first),
    ]
    assert all(other is not first for other in others)


def test_known_fit_keeps_no_run_alive():
    dataset = make_dataset(linear, runs=3, length=200)
    fit([EffectConfig("zero_tempco")], dataset.train, **NAMES, catalogue=load_catalogue())
    run = weakref.ref(dataset.train[0])
    del dataset
    gc.collect()
    assert run() is None
