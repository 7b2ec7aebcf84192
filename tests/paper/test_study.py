import json
from dataclasses import replace

import numpy as np
import pytest

from zerodrift.base.errors import InputError
from zerodrift_lab.methods import METHODS
from zerodrift_lab.paper import study
from zerodrift_lab.paper.store import Cell, Store, digest_sources
from zerodrift_lab.paper.study import Outcome, run_study
from zerodrift_lab.paper.summary import Outcomes, compare_errors, summarise
from zerodrift_lab.paper.world import TESTS, record_test, record_training

CELLS = [Cell("lsm_linear", 1), Cell("lsm_cubic", 1)]


@pytest.mark.long
def test_test_runs_are_none_of_the_training_runs():
    for logs in ("chamber", "varied", "unwalked", "loaded"):
        train = record_training(1, logs, False)
        for test in TESTS:
            for trial in record_test(1, test, False):
                assert all(trial.run.name != run.name for run in train)
                assert all(
                    len(trial.run) != len(run)
                    or not np.array_equal(trial.run.temperature_degC, run.temperature_degC)
                    for run in train
                )


def test_varied_logs_hold_the_protocols_of_the_bench_and_no_strides():
    for logs, plates in (("varied", 4), ("unwalked", 0)):
        names = [run.name.rpartition("_")[0] for run in record_training(1, logs, False)]
        bench = [name for name in names if name != "chamber"]
        assert len(bench) == 12
        assert bench.count("walking_still") == plates
        assert {"heating", "cooling"} < set(bench)
        assert "walking" not in bench


def test_a_result_is_what_the_method_leaves_of_the_drift(tmp_path):
    outcome = run_study(CELLS[:1], Store(tmp_path))[0]
    fitted = METHODS["lsm_linear"].fit(record_training(1, "chamber", False))
    for test in TESTS:
        errors = [t.run.drift - fitted.predict(t.run) for t in record_test(1, test, False)]
        assert np.array_equal(
            outcome.rmse(test), np.sqrt(np.mean(np.concatenate(errors) ** 2, axis=0))
        )
        assert (outcome.floor(test) < outcome.rmse(test)).all()


def test_what_is_kept_is_not_fitted_again(tmp_path, monkeypatch):
    first = run_study(CELLS, Store(tmp_path))
    fits = []
    monkeypatch.setattr(study, "fit_cell", fits.append)
    again = run_study(CELLS, Store(tmp_path))
    assert fits == []
    assert [o.result["tests"] for o in again] == [o.result["tests"] for o in first]


def test_an_interruption_keeps_every_fit_that_was_done(tmp_path, monkeypatch):
    fit = study.fit_cell

    def stop_at_second(cell):
        if cell is CELLS[1]:
            raise KeyboardInterrupt
        return fit(cell)

    monkeypatch.setattr(study, "fit_cell", stop_at_second)
    with pytest.raises(KeyboardInterrupt):
        run_study(CELLS, Store(tmp_path))
    store = Store(tmp_path)
    assert store.load(CELLS[0], "linear") is not None
    assert store.load(CELLS[1], "linear") is None


def test_a_damaged_result_is_fitted_again(tmp_path):
    store = Store(tmp_path)
    first = run_study(CELLS[:1], store)[0]
    path = store.find_path(CELLS[0], "linear")
    for damage in (b"", b"{", b"[]", path.read_bytes()[:100]):
        path.write_bytes(damage)
        assert run_study(CELLS[:1], store)[0].result["tests"] == first.result["tests"]


def test_everything_that_decides_a_result_decides_its_place(tmp_path):
    store = Store(tmp_path)
    changes = [
        {"sensor": 2},
        {"seed": 1},
        {"logs": "varied"},
        {"body": True},
        {"spacing_s": 3.0},
        {"schedule": "recipe"},
        {"epochs": 3},
        {"effects": ("zero_tempco",)},
        {"course": True},
        {"method": "mlp"},
    ]
    paths = {store.find_path(replace(CELLS[0], **change), "linear") for change in changes}
    assert len(paths) == len(changes)
    assert store.find_path(CELLS[0], "linear") not in paths


def test_the_sources_of_every_family_are_there():
    for method in METHODS.values():
        assert len(digest_sources(method.family)) == 64


def test_a_folder_that_cannot_be_read_is_told(tmp_path):
    store = Store(tmp_path)
    store.find_path(CELLS[0], "linear").mkdir()
    with pytest.raises(InputError, match="cannot be read"):
        store.load(CELLS[0], "linear")


def test_a_method_without_seeds_stands_for_all_of_them():
    def make(sensor, seed, error):
        told = {"tests": {"chamber": {"rmse": [error]}}}
        return Outcome(Cell("lsm_linear", sensor, seed), told)

    ones = [make(1, 0, 8.0), make(2, 0, 9.0)]
    others = [make(1, 0, 1.0), make(1, 1, 2.0), make(2, 0, 3.0), make(2, 1, 4.5)]
    pairs = Outcomes([]).pair(ones, others)
    ratios = [compare_errors(a.rmse("chamber"), b.rmse("chamber")) for a, b in pairs]
    assert ratios == pytest.approx([8.0, 4.0, 3.0, 2.0])
    turned = Outcomes([]).pair(others, ones)
    assert [(a.rmse("chamber") / b.rmse("chamber"))[0] for a, b in turned] == pytest.approx(
        [1 / 8, 1 / 4, 1 / 3, 1 / 2]
    )


def test_median_and_quartiles():
    spread = summarise([1.0, 2.0, 3.0, 4.0, 10.0])
    assert (spread.median, spread.low, spread.high, spread.count) == (3.0, 2.0, 4.0, 5)
    assert spread.write() == "3 (2 to 4)"
    assert summarise([1.25]).write() == "1.25"


@pytest.mark.slow
def test_processes_find_the_same(tmp_path):
    one = run_study(CELLS, Store(tmp_path / "one"))
    two = run_study(CELLS, Store(tmp_path / "two"), jobs=2)
    assert [json.dumps(o.result["tests"]) for o in one] == [
        json.dumps(o.result["tests"]) for o in two
    ]
