"""Black boxes: what they learn carries over, noise does not, and no run teaches its own answer."""

from dataclasses import replace

import numpy as np
import pytest
from benchmarks.formula_cases import simulate

from zerodrift.physics.catalogue import load_catalogue
from zerodrift.physics.fit import fit_config
from zerodrift.train.black_box.compare import learn_bank, try_black_boxes
from zerodrift.train.black_box.signals import pose

pytestmark = pytest.mark.long


def open_case(kind, runs=5, seed=3):
    case = simulate(kind, 5.0, runs, seed)
    data = replace(case.dataset, test=())
    model = fit_config(case.config, data, load_catalogue())
    return data, model, pose(model, data, True)  # `measure` takes each run's mean off, too


def measure(lesson, added):
    left = []
    for run, rest in zip(lesson.runs, lesson.rests, strict=True):
        error = rest - added.get(run.name, 0.0)
        left.append(error - error.mean(axis=0))
    return np.sqrt(np.mean(np.concatenate(left) ** 2, axis=0))


@pytest.mark.parametrize("kind", ["play(humidity)", "load (LP(humidity) - b)"])
def test_a_bank_learns_what_a_signal_says(kind):
    _, _, lesson = open_case(kind)
    found = learn_bank(lesson)
    assert "humidity" in found.sees or found.sees == "all signals"
    assert (measure(lesson, found.added) < 0.5 * measure(lesson, {})).all()


def test_a_bank_learns_nothing_of_a_random_walk():
    _, _, lesson = open_case("random walk")
    assert (measure(lesson, learn_bank(lesson).added) > 0.95 * measure(lesson, {})).all()


def test_a_run_teaches_nothing_about_itself():
    _, _, lesson = open_case("play(humidity)")
    one = replace(lesson, rests=tuple(rest[:, :1] for rest in lesson.rests))
    rests = list(one.rests)
    rests[2] = np.random.default_rng(0).standard_normal(rests[2].shape)
    other = learn_bank(replace(one, rests=tuple(rests)))
    found, name = learn_bank(one), lesson.runs[2].name
    assert np.allclose(found.added[name], other.added[name], rtol=1e-6)
    elsewhere = lesson.runs[0].name
    assert not np.allclose(found.added[elsewhere], other.added[elsewhere], rtol=1e-2)


def test_long_logs_are_learnt_from_block_means(monkeypatch):
    _, _, lesson = open_case("play(humidity)")
    whole = measure(lesson, learn_bank(lesson).added)
    monkeypatch.setattr("zerodrift.train.black_box.compare.MOST_ROWS", 750)
    found = learn_bank(lesson).added
    assert all(one.shape == (1500, 2) for one in found.values())
    assert (measure(lesson, found) < 1.3 * whole).all()


def test_both_are_told_beside_the_model(monkeypatch):
    data, model, _ = open_case("play(humidity)", runs=4)
    found = try_black_boxes(model, None, data, model.tared)
    assert [box.name for box in found.boxes] == ["lag bank", "GRU"]
    assert found.after is None and found.note == ""
    for box in found.boxes:
        assert box.learns_more and box.rmse_beside is None
        assert (box.rmse < 0.7 * found.before).all()
    few = replace(data, train=data.train[:2])
    assert "3 training runs" in try_black_boxes(model, None, few, model.tared).note
    monkeypatch.setattr("zerodrift.train.black_box.compare.is_there", lambda package: False)
    without = try_black_boxes(model, None, data, model.tared)
    assert [box.name for box in without.boxes] == ["lag bank"] and "PyTorch" in without.note
