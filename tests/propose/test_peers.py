"""What the comparison gives other methods: offsets left open, and the same rows for all."""

import numpy as np
import pytest
from benchmarks.bench_peers import Trial, gather, run_trials, tell, try_peer
from benchmarks.bench_propose import RIGHT
from benchmarks.formula_cases import FORMS, simulate
from benchmarks.formula_peers import TrainingRows, centre, learn_forward, list_library, list_views


def test_forward_selection_finds_columns_whatever_the_offsets_of_runs():
    rng = np.random.default_rng(0)
    x = rng.standard_normal((900, 40))
    run = np.repeat(np.arange(3), 300)
    y = 2.0 * x[:, [7]] - x[:, [31]] + 50.0 * run[:, None] + 0.1 * rng.standard_normal((900, 1))
    predict = learn_forward(TrainingRows(x, y, run, 0))
    weights = predict(np.eye(40))[:, 0]
    assert abs(weights[7] - 2.0) < 0.02 and abs(weights[31] + 1.0) < 0.02
    assert np.abs(np.delete(weights, [7, 31])).max() < 0.02
    assert np.abs(centre(y, run)[run == 1].mean()) < 1e-9


def test_every_method_is_given_rows_of_one_scale():
    case = simulate("sqrt(ambient_light)", 5.0, 5, 1)
    for view in (list_views, list_library):
        rows, show = gather(case, np.zeros(2), view, 0)
        assert len(rows.x) == len(rows.y) == len(rows.run) <= 2000
        assert np.isfinite(rows.x).all()
        whole = np.concatenate([show(run) for run in case.dataset.train])
        assert np.allclose(whole.mean(axis=0), 0.0, atol=1e-9)


def test_a_form_of_the_library_is_found_nearly_to_the_noise():
    case = simulate("sqrt(ambient_light)", 8.0, 6, 2)
    assert 0.99 < try_peer("forward OLS", case, 2) < 1.15


@pytest.mark.long
def test_outcomes_are_kept_and_told(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("benchmarks.bench_peers.METHODS", {})
    monkeypatch.setattr("benchmarks.bench_peers.try_propose", lambda case: 1.01)
    file = tmp_path / "trials.jsonl"
    first = run_trials([7], file, 1.0)
    monkeypatch.setattr("benchmarks.bench_peers.try_propose", lambda case: 9.0)
    assert run_trials([7], file, 1.0) == first and len(first) == len(FORMS)
    others = [Trial("GP", one.kind, one.seed, 1.0, 1.0) for one in first]
    tell([*first, *others])
    assert "at most 5 % worse in 12 of 12" in capsys.readouterr().out


def test_every_form_has_its_words():
    assert set(RIGHT) == set(FORMS)
