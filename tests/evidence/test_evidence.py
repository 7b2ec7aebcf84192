"""The command for public evidence: its cases, its bounds and bands, and that work goes on."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from itertools import islice

import numpy as np
import pytest
from benchmarks.evidence import __main__ as command
from benchmarks.evidence import store as store_module
from benchmarks.evidence import tables
from benchmarks.evidence.conditions import (
    CONDITIONS,
    Ask,
    Condition,
    draw_asks,
    list_asks,
    list_hidden,
    list_walks,
)
from benchmarks.evidence.judge import Row, Step, run_case
from benchmarks.evidence.sources import draw
from benchmarks.evidence.store import Store, hash_code

from zerodrift.base.errors import InputError
from zerodrift.diagnosis.diagnose import diagnose


def ask(**wanted) -> Ask:
    plain = Ask(3, "clean", "one", ("warm_up",), 3.0, 4, Condition(4, 4), 5)
    return replace(plain, **wanted)


def test_there_are_twelve_conditions_over_all_that_logs_differ_in() -> None:
    conditions = CONDITIONS.values()
    assert len(CONDITIONS) == 12
    assert {c.fewest_runs for c in conditions} >= {2, 3, 4, 5, 6}
    assert max(c.most_runs for c in conditions) == 12
    assert {c.dwell for c in conditions} == {True, False}
    assert len({c.noise for c in conditions}) > 3
    assert {c.outliers for c in conditions} >= {0.0, 0.002, 0.02}


@pytest.mark.parametrize("simulator", [1, 2, 3])
def test_every_effect_comes_once_before_any_comes_twice(simulator) -> None:
    names = list_hidden(simulator, "one")
    cases = list(islice(list_asks(simulator, "clean", "one", 3), len(names)))
    assert sorted(case.hidden[0] for case in cases) == sorted(names)
    assert cases == list(islice(list_asks(simulator, "clean", "one", 3), len(names)))
    other = list(islice(list_asks(simulator, "runs_2", "one", 3), len(names)))
    assert not {case.seed for case in cases} & {case.seed for case in other}


def test_drawn_cases_are_drawn_over_all_factors() -> None:
    cases = list(islice(draw_asks(3, 1), 400))
    assert {case.runs for case in cases} == set(range(2, 13))
    assert {case.purpose for case in cases} == {"one", "pair", "complete", "outside"}
    assert {case.logs.noise for case in cases} >= {"white", "walk", "coarse"}
    assert len({case.logs.dwell for case in cases}) == 2
    assert [case.purpose for case in islice(list_walks(3, 1), 4)] == ["one", "pair"] * 2


@pytest.mark.parametrize("noise", ["white", "flicker", "coarse"])
@pytest.mark.spread(2, "simulator", [1, 2, 3])
def test_a_condition_is_what_the_logs_are_like(simulator, noise) -> None:
    logs = Condition(4, 4, dwell=False, noise=noise, outliers=0.02)
    drawn = draw(ask(simulator=simulator, purpose="complete", hidden=(), size=0.0, logs=logs))
    assert len({run.group for run in drawn.dataset.train}) == 4
    assert len({run.group for run in drawn.test}) == 2
    assert not drawn.dataset.dwell
    assert not drawn.dataset.test
    assert drawn.noise.shape == (len(drawn.dataset.outputs),)


@pytest.mark.parametrize("simulator", [1, 3])
def test_the_true_drift_is_that_of_the_runs_that_are_judged(simulator) -> None:
    drawn = draw(ask(simulator=simulator))
    left = np.concatenate([run.drift - drawn.truth[run.name] for run in drawn.test])
    rms = np.sqrt(np.mean((left - left.mean(axis=0)) ** 2, axis=0))
    assert np.all(rms < 1.3 * drawn.noise)
    assert np.all(rms > 0.5 * drawn.noise)


@pytest.mark.long
def test_a_plain_case_is_named_and_kept() -> None:
    row = run_case(ask(simulator=3, hidden=("supply_sensitivity",), size=10.0, runs=6))
    assert (row.verdict, row.effect) == ("missing", "supply_sensitivity")
    assert row.right
    assert not row.wrong_name
    assert not row.refused_add
    assert 0.0 < row.probabilities["supply_sensitivity"] <= 1.0


@pytest.mark.long
def test_the_loop_tells_every_step() -> None:
    row = run_case(ask(condition="loop", hidden=("supply_sensitivity",), size=10.0, runs=6, seed=6))
    assert [step.added for step in row.steps][:2] == ["", "supply_sensitivity"]
    assert row.steps[0].error > 3.0 > row.steps[-1].error
    assert row.reachable < row.steps[0].error


def test_a_case_that_cannot_be_made_is_not_counted() -> None:
    row = run_case(ask(hidden=("crosstalk", "dark_current"), purpose="pair"))
    assert "no family has all of" in row.impossible
    assert not row.counts


def test_logs_that_the_loader_refuses_count_as_a_failure(monkeypatch) -> None:
    def refuse(one: Ask) -> None:
        raise InputError("train_1.csv and train_2.csv hold the same measurements")

    monkeypatch.setattr("benchmarks.evidence.judge.draw", refuse)
    row = run_case(ask())
    assert row.counts
    assert not row.right
    (told,) = tables.list_failures([row])
    assert "hold the same measurements" in told
    assert "errors 1" in tables.list_conditions([row])[0]


@pytest.mark.long
def test_an_effect_that_was_not_named_is_added_all_the_same(monkeypatch) -> None:
    def say_nothing(*given):
        return replace(diagnose(*given), verdict="unknown", effect=None, lookalikes=())

    case = ask(hidden=("supply_sensitivity",), size=10.0, runs=6)
    assert run_case(case).truth_errors == ()
    monkeypatch.setattr("benchmarks.evidence.judge.diagnose", say_nothing)
    row = run_case(case)
    assert row.truth_kept
    before, after = row.truth_errors
    assert before > 5.0 > 2.0 > after
    assert "add supply_sensitivity keeps it, error" in tables.list_failures([row])[0]


def test_what_went_wrong_is_run_again_on_the_code_as_it_is(tmp_path, monkeypatch) -> None:
    monkeypatch.setattr(store_module, "HOME", tmp_path)
    monkeypatch.setattr(command, "HOME", tmp_path)
    old = Store(tmp_path / "old" / "outcomes.jsonl")
    old.append(Row(ask(), verdict="missing", effect="warm_up"))
    old.append(Row(ask(seed=6), verdict="unknown"))
    ran = []
    monkeypatch.setattr(command, "work", lambda asks, *_: bool(ran.extend(asks) or True))
    assert command.main(["again", "--version", "old"]) == 0
    assert ran == [ask(seed=6)]


def test_outcomes_are_read_back_and_not_run_again(tmp_path, monkeypatch, capsys) -> None:
    ran = []

    def pretend(one: Ask) -> Row:
        ran.append(one)
        return Row(one, verdict="complete", steps=(Step("", 0.5, "complete"),))

    monkeypatch.setattr(command, "open_pool", ThreadPoolExecutor)
    monkeypatch.setattr(command, "run_case", pretend)
    monkeypatch.setattr(store_module, "HOME", tmp_path)
    line = ["conditions", "--condition", "clean", "--count", "3", "--seed", "8"]
    assert command.main(line) == 0
    assert len(ran) == 6
    assert command.main([*line[:-3], "4", *line[-2:]]) == 0
    assert len(ran) == 8
    told = capsys.readouterr().out
    assert "complete 4/4 100.0 % (at least 47.3 %)" in told
    assert command.main(["drawn", "--count", "3", "--minutes", "0"]) == 1
    (kept,) = tmp_path.glob("*/outcomes.jsonl")
    again = Store(kept)
    assert [row.ask for row in again.rows] == ran
    assert again.rows[0].steps == (Step("", 0.5, "complete"),)


def test_outcomes_lie_under_the_version_of_the_code(tmp_path) -> None:
    for folder in ("src/zerodrift/diagnosis", "lab/benchmarks/evidence"):
        (tmp_path / folder).mkdir(parents=True)
    rule = tmp_path / "src/zerodrift/diagnosis/rules.py"
    rule.write_text("LIMIT = 1\n")
    before = hash_code(tmp_path)
    (tmp_path / "lab/benchmarks/evidence/tables.py").write_text("how it is printed")
    assert hash_code(tmp_path) == before
    rule.write_text("LIMIT = 2\n")
    assert hash_code(tmp_path) != before


def test_rates_stand_beside_their_bounds() -> None:
    assert tables.tell_least(18, 18) == "18/18 100.0 % (at least 84.7 %)"
    assert tables.tell_most(0, 300) == "0/300 0.0 % (at most 1.0 %)"
    assert tables.tell_most(3, 300) == "3/300 1.0 % (at most 2.6 %)"


def test_bands_hold_two_hundred_and_find_what_is_off() -> None:
    rng = np.random.default_rng(1)
    told = rng.uniform(size=3000)
    honest = [(float(p), bool(rng.random() < p)) for p in told]
    bands = tables.cut_bands(honest)
    assert len(bands) == 10
    assert min(band.count for band in bands) >= tables.FEWEST_IN_A_BAND
    assert tables.measure_calibration(bands) < 0.04
    boastful = [(p, bool(rng.random() < p / 2)) for p, _ in honest]
    assert tables.measure_calibration(tables.cut_bands(boastful)) == pytest.approx(0.25, abs=0.03)
    assert len(tables.cut_bands(honest[:399])) == 1


def test_probabilities_are_held_against_what_is_hidden() -> None:
    row = Row(
        ask(condition="drawn", purpose="pair", hidden=("creep", "ageing")),
        verdict="missing",
        effect="creep",
        probabilities={"creep": 0.9, "ageing": 0.4, "humidity": 0.1},
        nothing_missing=0.05,
        something_else=0.6,
    )
    found = tables.list_entries([row])
    assert found["every candidate"] == [(0.9, True), (0.4, True), (0.1, False)]
    assert found["named effect"] == [(0.9, True)]
    assert found["nothing missing"] == [(0.05, False)]
    assert found["something else"] == [(0.6, True)]


def test_a_refused_add_is_counted_and_listed() -> None:
    good = Row(ask(), verdict="missing", effect="warm_up")
    refused = replace(good, ask=ask(seed=6), refused_add=True, reason="not better")
    (line, _) = tables.list_conditions([good, refused])
    assert "MISSING and add refused 1/2" in line
    (told,) = tables.list_failures([good, refused])
    assert "seed 6" in told
    assert "ADD REFUSED: not better" in told
    outside = ask(purpose="outside", hidden=("popcorn",))
    assert Row(outside, verdict="unknown").right
    assert Row(outside, verdict="missing", effect="creep").wrong_name


def test_simulator_two_has_no_loop(capsys) -> None:
    with pytest.raises(SystemExit):
        command.main(["loop", "--simulator", "2"])
    assert "no true drift" in capsys.readouterr().err


def test_what_a_form_of_the_catalogue_imitates_is_told_apart() -> None:
    outside = ask(purpose="outside", hidden=("sticky_valve",))
    unlike = Row(outside, verdict="missing", effect="creep", form_error=2.4)
    alike = replace(unlike, ask=replace(outside, seed=6), form_error=1.1)
    assert alike.imitated
    (line, _) = tables.list_conditions([unlike, alike])
    assert "named 2/2" in line
    assert "of those that no form imitates named 1/1" in line
    assert "best form leaves 1.10" in tables.list_failures([unlike, alike])[1]


@pytest.mark.long
def test_outside_the_catalogue_the_best_form_is_measured() -> None:
    row = run_case(ask(purpose="outside", hidden=("sticky_valve",), size=3.0, runs=4))
    assert row.form_error is not None
    assert 0.0 < row.form_error < 5.0
    assert run_case(ask()).form_error is None


def test_of_two_hidden_effects_only_one_may_have_a_name() -> None:
    case = next(list_asks(3, "clean", "beside", 5))
    assert len(case.hidden) == 2
    assert case.listed == case.hidden[:1]
    assert case.hidden[1] in list_hidden(3, "outside")
    name = case.listed[0]
    alone = Row(case, verdict="missing", effect=name, something_else=0.1)
    told = replace(alone, ask=replace(case, seed=6), something_else=0.7)
    wrong = replace(alone, ask=replace(case, seed=7), effect="crosstalk", something_else=0.9)
    (line, _) = tables.list_conditions([alone, told, wrong])
    assert "named 2/3" in line
    assert "something else told 1/3" in line
    assert "another 1/3" in line
