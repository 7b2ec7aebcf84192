"""What the examination of the gate draws: faults that harm, in one run; sets that have none."""

from pathlib import Path

import numpy as np
import pytest
from benchmarks.one_gate import clean, leaks, wrong
from benchmarks.one_gate.draw import SIMULATORS, SPARE, Wanted, draw_sensor, replace_tests
from benchmarks.one_gate.drive import Answer, Entry, TooLongError, limit
from benchmarks.one_gate.harm import DOUBLE, bring_to_period, fit_plainly, leave, weigh_harm
from benchmarks.one_gate.results import examine_all, tell_rate
from benchmarks.one_gate.sensor import TEMPERATURE, Log, Sensor


def differ(one: Log, two: Log) -> list[str]:
    """Return the columns that are not the same."""
    assert list(one.columns) == list(two.columns)
    return [
        name for name in one.columns if not np.array_equal(one.columns[name], two.columns[name])
    ]


def draw(simulator: str, **wanted: object) -> Sensor:
    for seed in range(20):
        sensor = draw_sensor(simulator, Wanted(seed, 8, **wanted))  # type: ignore[arg-type]
        if sensor is not None:
            return sensor
    raise AssertionError(simulator)


@pytest.mark.spread(5, "kind", list(wrong.KINDS))
def test_a_fault_doubles_the_error_and_is_in_one_run_alone(kind: str) -> None:
    case = wrong.draw_wrong(kind, 0)
    assert case.harm >= DOUBLE
    assert len(case.sound.select("train")) == wrong.TRAIN
    changed = {
        log.name: columns
        for log, other in zip(case.sound.logs, case.spoilt.logs, strict=True)
        if (columns := differ(log, other))
    }
    assert list(changed) == [case.run]
    assert set(changed[case.run]) <= set(case.columns)


def test_a_case_is_drawn_the_same_again() -> None:
    one, two = (wrong.draw_wrong("kelvin read as degC", 3) for _ in range(2))
    assert (one.run, one.harm, one.columns) == (two.run, two.harm, two.columns)


def test_there_are_twenty_six_kinds() -> None:
    assert len(wrong.KINDS) == 26


def test_rows_that_are_too_close_are_averaged_before_harm_is_weighed() -> None:
    columns = {"time_s": np.arange(120) / 60.0, "y": np.arange(120.0)}
    brought = bring_to_period(columns, 1.0)
    assert brought["y"].tolist() == [29.5, 89.5]
    assert bring_to_period(brought, 1.0) is brought


@pytest.mark.parametrize("simulator", SIMULATORS)
def test_the_plain_model_of_a_complete_set_leaves_its_noise(simulator: str) -> None:
    sensor = draw(simulator)
    assert weigh_harm(sensor, sensor) == 1.0
    for k in range(len(sensor.outputs)):
        told = fit_plainly(sensor, k)
        none = leave(sensor, sensor.select("spare"), k, 0.0 * told)
        left = leave(sensor, sensor.select("spare"), k, told)
        assert left < 1.5 * leave(sensor, sensor.select("train"), k, told)
        assert left < 0.5 * none


@pytest.mark.parametrize("simulator", SIMULATORS)
def test_a_set_is_written_as_a_project_without_the_spare_runs(
    simulator: str, tmp_path: Path
) -> None:
    sensor = draw(simulator, tests=1, dwell=True)
    sensor.write(tmp_path)
    written = {path.stem for path in (tmp_path / "logs").iterdir()}
    assert written == {log.name for log in sensor.select("train", "test", "dwell")}
    assert len(sensor.select("spare")) >= SPARE - 1
    assert 'kind = "none"' in (tmp_path / "zerodrift.toml").read_text()


def test_a_coarse_thermometer_tells_multiples_of_its_step() -> None:
    sensor = draw("third", coarse_K=0.5)
    told = sensor.logs[0].columns[TEMPERATURE]
    assert np.array_equal(told, 0.5 * np.round(told / 0.5))


def test_more_tests_are_runs_of_the_same_sensor_with_the_same_training() -> None:
    sensor = draw("foreign", tests=1)
    more = replace_tests(sensor, 4)
    assert len(more.select("test")) == 4
    assert [log.name for log in more.select("train")] == [
        log.name for log in sensor.select("train")
    ]
    assert sensor.select("test")[0].columns is more.select("test")[0].columns


def test_clean_sets_are_of_every_sort() -> None:
    wanted = [clean.draw_wanted(SIMULATORS[n % 3], n) for n in range(300)]
    assert {one.tests for one in wanted} == {0, 1, 2}
    assert {one.train for one in wanted} == {*range(1, 13)}
    for sort in ("lacks", "dwell", "coarse_K"):
        assert 0.15 < np.mean([bool(getattr(one, sort)) for one in wanted]) < 0.65


@pytest.mark.parametrize("simulator", SIMULATORS)
def test_a_clean_set_is_what_was_wanted(simulator: str) -> None:
    wanted = clean.draw_wanted(simulator, 4)
    sensor = clean.draw_clean(simulator, 4)
    assert len(sensor.select("train")) == wanted.train
    assert len(sensor.select("test")) == wanted.tests
    assert bool(sensor.select("dwell")) == wanted.dwell


@pytest.mark.parametrize("kind", leaks.KINDS)
def test_a_leak_is_in_the_first_test_run_alone(kind: str) -> None:
    sound, leak = leaks.draw_leak(kind, 0)
    assert len(leak.sensor.select("test")) == 2
    pairs = zip(sound.logs, leak.sensor.logs, strict=True)
    changed = [other.name for log, other in pairs if log.columns is not other.columns]
    assert changed == [leak.test]
    source = next(log for log in sound.logs if log.name == leak.source).columns
    made = leak.sensor.select("test")[0].columns
    name = sound.outputs[0].measured
    size = len(made[name])
    shared = np.isin(np.round(made[TEMPERATURE], 9), np.round(source[TEMPERATURE], 9)).mean()
    assert size <= len(source[name])
    assert shared > 0.9 or kind == "resampled"


def say(*entries: Entry, code: int = 1) -> Answer:
    return Answer(code, {"written": code == 0, "refused": [vars(entry) for entry in entries]})


def test_only_the_run_the_column_and_the_fault_together_are_right() -> None:
    case = wrong.draw_wrong("kelvin read as degC", 0)
    right = Entry("kelvin", case.run, TEMPERATURE, "reads 273 too high")
    gate = Entry("worse_than_none", "", "", "the chip is in another unit than kelvin")
    assert wrong.judge(case, say(right)) == wrong.RIGHT
    assert wrong.judge(case, say(gate, right)) == wrong.RIGHT
    assert wrong.judge(case, say(gate)) == wrong.GATE
    assert wrong.judge(case, say()) == wrong.UNSAID
    for other in (
        Entry("kelvin", "another_run", TEMPERATURE, right.text),
        Entry("kelvin", case.run, "humidity_pct", right.text),
        Entry("spikes", case.run, TEMPERATURE, "three samples lie far off"),
    ):
        assert wrong.judge(case, say(other)) == wrong.OTHER
    assert wrong.judge(case, say(code=0)) == wrong.WRITTEN
    assert wrong.judge(case, say(code=2)) == wrong.READ
    assert wrong.judge(case, Answer(-1)) == wrong.CRASH


def test_a_part_of_a_run_is_the_run_and_a_longer_name_is_not() -> None:
    assert wrong.is_run("train_1", "train_1")
    assert wrong.is_run("train_1@60%:100%", "train_1")
    assert not wrong.is_run("train_10", "train_1")


def test_a_leak_is_told_by_both_names_or_by_a_word_for_a_copy() -> None:
    _, leak = leaks.draw_leak("copied", 0)

    def told(text: str, run: str = "") -> bool:
        note = vars(Entry("note", run, "", text))
        return leaks.is_told(leak, Answer(0, {"notes": [note]}), Answer(0))

    assert told(f"{leak.test} holds the rows of {leak.source}")
    assert told("is a copy", run=leak.test)
    assert not told("is a copy", run="another")
    assert not told("reaches further than training", run=leak.test)


def test_a_clean_set_is_stopped_by_the_referee_or_by_the_gate() -> None:
    gate = Entry("worse_than_none", "", "", "Fz: ...")
    assert clean.judge(say(code=0)) == clean.PASSES
    assert clean.judge(say(gate)) == clean.GATE
    assert clean.judge(say()) == clean.UNSAID
    assert clean.judge(say(gate, Entry("gain", "train_1", "Fz"))) == clean.REFEREE


def test_what_was_found_is_kept_and_not_run_again(tmp_path: Path) -> None:
    ran: list[tuple[str, int]] = []

    def examine(kind: str, seed: int) -> dict[str, object]:
        ran.append((kind, seed))
        return {"outcome": seed}

    kept = tmp_path / "kept" / "part.jsonl"
    examine_all(examine, [("a", 0), ("a", 1)], kept, 0)
    rows = examine_all(examine, [("a", 1), ("b", 0)], kept, 0)
    assert ran == [("a", 0), ("a", 1), ("b", 0)]
    assert [row["kind"] for row in rows] == ["a", "b"]


def test_what_goes_on_for_too_long_is_ended() -> None:
    with pytest.raises(TooLongError, match="no answer within"), limit(0.05):
        while True:
            pass


def test_a_rate_has_its_bound() -> None:
    assert tell_rate(0, 300, upper=True) == "0 of 300 (0.0 %, at most 1.0 %)"
    assert tell_rate(0, 0, upper=True) == "no case"
