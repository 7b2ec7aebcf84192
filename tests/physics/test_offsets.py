"""Offsets of runs, times of power-on and rests at power-on, as logs of all kinds have them."""

from dataclasses import replace

import numpy as np
import pytest
from tests.physics.conftest import SLOPE, linear, make_dataset

from zerodrift.diagnosis.case import lay_out_runs
from zerodrift.diagnosis.changes import list_extensions
from zerodrift.diagnosis.diagnose import diagnose
from zerodrift.diagnosis.revision import try_extension
from zerodrift.physics.campaign import Campaign
from zerodrift.physics.catalogue import load_catalogue
from zerodrift.physics.fit import fit
from zerodrift.physics.signals import plan_signals, read_signals
from zerodrift.physics.terms import start_term

DAY_S = 86400.0


def with_clock(dataset, days_apart=1.0):
    """Return the dataset with a clock, the runs days apart."""
    train = [
        replace(run, inputs={**run.inputs, "clock": run.time_s + DAY_S * days_apart * i})
        for i, run in enumerate(dataset.train)
    ]
    dwell = [
        replace(run, inputs={**run.inputs, "clock": run.time_s + DAY_S * 30})
        for run in dataset.dwell
    ]
    return replace(dataset, train=tuple(train), dwell=tuple(dwell))


def shifted(dataset, offsets):
    """Return the dataset with these offsets [R] added to its runs, in noise units."""
    train = [
        replace(run, measured=run.measured + offset * np.array([0.5, 0.004]))
        for run, offset in zip(dataset.train, offsets, strict=True)
    ]
    return replace(dataset, train=tuple(train))


def lay_out(effects, dataset) -> Campaign:
    plan = plan_signals(dataset.train, dataset.outputs, dataset.full_scale)
    catalogue = load_catalogue()
    terms = [start_term(catalogue, effect) for effect in effects]
    return lay_out_runs(dataset.train, plan, catalogue, terms).campaign


def test_offsets_without_a_cause_are_a_tare(tempco):
    dataset = with_clock(make_dataset(linear, length=300, tared=False))
    assert not lay_out(tempco, dataset).tared
    assert lay_out(tempco, shifted(dataset, [3, -9, 7, -2, -8, 9, 1, -5])).tared


def test_offsets_that_follow_the_clock_are_ageing_and_no_tare(tempco):
    age = 6.0 * np.arange(8.0) ** 0.7
    dataset = shifted(with_clock(make_dataset(linear, length=300, tared=False)), age)
    assert not lay_out(tempco, dataset).tared
    diagnosis = diagnose(tempco, dataset)
    assert (diagnosis.verdict, diagnosis.effect) == ("missing", "ageing")


def warming(bench):
    return linear(bench) + 3.0 * (1.0 - np.exp(-bench.time_s / 60.0))[:, None] * SLOPE


def late(dataset, starts):
    train = [
        replace(run, time_s=run.time_s + start)
        for run, start in zip(dataset.train, starts, strict=True)
    ]
    return replace(dataset, train=tuple(train))


@pytest.mark.long
def test_warm_up_is_found_where_no_log_begins_at_zero(tempco):
    dataset = late(make_dataset(warming, length=300), [4096.0] * 8)
    diagnosis = diagnose(tempco, dataset)
    assert (diagnosis.verdict, diagnosis.effect) == ("missing", "warm_up")
    assert abs(diagnosis.parameters["tau_s"] - 60.0) < 10.0


def test_power_came_on_at_zero_where_some_log_begins_there(tempco):
    dataset = late(make_dataset(linear, length=300), [0.0, 7200.0] + [0.0] * 6)
    plan = plan_signals(dataset.train, dataset.outputs, dataset.full_scale)
    assert read_signals(dataset.train[1], plan).elapsed_s[0] == 7200.0


def test_clock_that_runs_on_from_run_to_run_tells_nothing_of_power_on(tempco):
    dataset = late(make_dataset(linear, length=300), 1000.0 * np.arange(8))
    plan = plan_signals(dataset.train, dataset.outputs, dataset.full_scale)
    assert read_signals(dataset.train[3], plan).elapsed_s[0] == 0.0


def test_stretch_after_a_gap_counts_from_the_runs_first_row(tempco):
    dataset = late(make_dataset(linear, length=300), [4096.0] * 8)
    plan = plan_signals(dataset.train, dataset.outputs, dataset.full_scale)
    after = replace(dataset.train[0], start_s=4000.0)
    assert read_signals(after, plan).elapsed_s[0] == 96.0


@pytest.mark.parametrize("said", [True, False])
def test_what_the_project_says_of_a_tare_holds(tempco, said):
    dataset = make_dataset(linear, length=300, tared=not said)
    assert lay_out(tempco, dataset).tared is not said
    runs = tuple(replace(run, tared=said) for run in dataset.train)
    told = replace(dataset, train=runs)
    assert lay_out(tempco, told).tared is said
    model = fit(
        tempco, runs, outputs=dataset.outputs, units=dataset.units, full_scale=dataset.full_scale
    )
    assert model.tared is said
    remarks = diagnose(tempco, told).remarks
    assert any("own offset is taken off, as [logs] tared says so" in r for r in remarks) is said
    assert not any("set [logs] tared = false" in r for r in remarks), "what is stated is not asked"


@pytest.mark.spread(1, "runs", [3, 4, 5])
def test_few_offsets_on_a_line_over_the_clock_are_ageing(tempco, runs):
    apart = np.array([0.0, 3.5, 1.0, 7.0, 4.0])[:runs]
    dataset = make_dataset(linear, length=300, runs=runs, tared=False)
    train = tuple(
        replace(run, inputs={**run.inputs, "clock": run.time_s + DAY_S * day})
        for run, day in zip(dataset.train, apart, strict=True)
    )
    dwell = replace(dataset.dwell[0], inputs=train[0].inputs)
    aged = shifted(replace(dataset, train=train, dwell=(dwell,)), 30.0 * apart)
    assert not lay_out(tempco, aged).tared
    diagnosis = diagnose(tempco, aged)
    assert (diagnosis.verdict, diagnosis.effect) == ("missing", "ageing")


@pytest.mark.spread(1, "runs", [3, 4, 5])
def test_few_offsets_drawn_at_random_are_a_tare(tempco, runs):
    dataset = with_clock(make_dataset(linear, length=300, runs=runs, tared=False))
    draws = np.random.default_rng(runs).normal(size=(8, runs)) * 20.0
    assert all(lay_out(tempco, shifted(dataset, offsets)).tared for offsets in draws)


@pytest.mark.long
def test_ageing_that_no_line_follows_is_kept_as_add_keeps_it(tempco):
    """By a straight line the offsets stay a tare; not by a power of time, which `add` tries."""
    age = 60.0 * np.arange(8.0) ** 0.5
    dataset = shifted(with_clock(make_dataset(linear, length=300, tared=False)), age)
    catalogue = load_catalogue()
    forms = list_extensions(tempco, catalogue, "ageing", {})
    assert [model[-1].held for model in forms] == [{}, {"power_law": 1}]
    assert try_extension(tempco, forms, dataset, catalogue)[0]
    diagnosis = diagnose(tempco, dataset)
    assert (diagnosis.verdict, diagnosis.effect) == ("missing", "ageing")
