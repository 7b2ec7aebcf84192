"""Wrong firmware is refused and right firmware is not, each case as a user met it."""

import json
from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest
from tests.gate.sensors import TESTS, TRAIN, Program, ask_gate, heat, list_kinds, write_sensor
from tests.main_job.conftest import invoke

from zerodrift.base.config import load_config
from zerodrift.base.errors import InputError
from zerodrift.base.records import from_json
from zerodrift.dataset.load import load_dataset
from zerodrift.operations.arithmetic import INT16_MAX
from zerodrift.operations.counter import IntegerCounter
from zerodrift.operations.dense import IntegerDense
from zerodrift.operations.exp2 import IntegerExp2
from zerodrift.report.tables import tabulate_chip_error
from zerodrift.tasks.built import read_firmware
from zerodrift.train.training import train
from zerodrift.verify import chip_error, left_out
from zerodrift.verify.gate import (
    GateVerdict,
    _sum_blocks,
    ask_for_tare,
    contrast_errors,
    find_chance,
    hold_jointly,
    measure_correlation,
)
from zerodrift.verify.summary import FirmwareSummary, Statement


@pytest.mark.parametrize("network", ["none", "lag_bank"])
def test_clean_sensor_passes_without_a_word(network: str, tmp_path: Path) -> None:
    verdict = ask_gate(write_sensor(tmp_path, (*TRAIN, *TESTS), network=network))
    assert verdict.passes and not verdict.warnings
    (split,) = verdict.chip_error
    assert 0.0 < split.rounding < 1e-4
    assert (split.out_of_range, split.clamped, split.saturated) == (0.0, 0.0, 0.0)


def test_hot_sensor_passes_as_a_mild_one_does(tmp_path: Path) -> None:
    programs = [heat(program) for program in (*TRAIN, *TESTS)]
    verdict = ask_gate(write_sensor(tmp_path, programs, span_degC=80.0))
    assert verdict.passes and not verdict.warnings
    (split,) = verdict.chip_error
    assert 0.0 < split.rounding < 1e-4
    assert (split.out_of_range, split.clamped, split.saturated) == (0.0, 0.0, 0.0)


def test_test_log_in_kelvin_is_refused(tmp_path: Path) -> None:
    kelvin = replace(TESTS[2], logged_add=273.15)
    project = write_sensor(tmp_path, (*TRAIN, *TESTS[:2], kelvin))
    with pytest.raises(InputError, match=r"^test_3.csv:2: .* look like kelvin: subtract 273.15"):
        ask_gate(project)
    file = project / "zerodrift.toml"
    column = '"temperature_degC"'
    wide = f"{{ column = {column}, range = [0, 400] }}"
    file.write_text(file.read_text().replace(f"temperature = {column}", f"temperature = {wide}"))
    verdict = ask_gate(project)
    assert list_kinds(verdict) == {"worse_beyond_range"}
    assert "test_3" in verdict.refused[0].text and "subtract 273.15" in verdict.refused[0].text


def test_hotter_test_log_is_told_with_run_time_and_remedy(tmp_path: Path) -> None:
    hotter = replace(TESTS[2], high_degC=52.0)
    verdict = ask_gate(write_sensor(tmp_path, (*TRAIN, *TESTS[:2], hotter)))
    assert verdict.passes  # far better than no compensation even so
    (warning,) = verdict.warnings
    assert warning.kind == "out_of_range"
    assert warning.text.startswith("test_3 leaves the calibrated range by 12 K from ")
    assert warning.text.endswith("record up to 52 degC.")
    (split,) = verdict.chip_error
    assert split.out_of_range > 100.0 * split.rounding


def test_training_run_in_another_unit_is_refused(tmp_path: Path) -> None:
    train = (*TRAIN[:3], replace(TRAIN[3], logged_times=1000.0))
    verdict = ask_gate(write_sensor(tmp_path, (*train, *TESTS)))
    assert list_kinds(verdict) == {"worse_than_none", "worse_than_constant"}
    assert "no compensation 0.17 bar (3 runs, 2700 rows)" in verdict.refused[0].text


def test_full_scale_far_too_large_is_refused_and_named(tmp_path: Path) -> None:
    verdict = ask_gate(write_sensor(tmp_path, (*TRAIN, *TESTS), full_scale=1e7))
    assert "worse_than_float" in list_kinds(verdict)
    assert "full_scale = 1e+07 bar is too large" in verdict.refused[-1].text


@pytest.mark.parametrize(("runs", "method"), [(4, "leave one run out"), (1, "blocks of one run")])
def test_physics_without_test_logs_is_judged_by_runs_left_out(
    runs: int, method: str, tmp_path: Path
) -> None:
    verdict = ask_gate(write_sensor(tmp_path, TRAIN[:runs]))
    assert verdict.passes and verdict.method == method and verdict.rows == 900 * runs


@pytest.mark.long
def test_lag_bank_without_test_logs_is_fitted_again_without_each_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fitted = []
    fit = left_out.fit_bank
    monkeypatch.setattr(left_out, "fit_bank", lambda *a: fitted.append(len(a[2])) or fit(*a))
    project = write_sensor(tmp_path, TRAIN, network="lag_bank", lag_s=40.0)
    verdict = ask_gate(project)
    assert fitted == [3, 3, 3, 3]
    assert verdict.passes and verdict.method == "leave one run out" and verdict.rows > 3000


def test_training_run_in_another_unit_is_told_without_test_logs(tmp_path: Path) -> None:
    """Three runs of four are far worse than without compensation: a chance of 2.9 % by itself, and
    of three baselines none is refused by that."""
    train = (*TRAIN[:3], replace(TRAIN[3], logged_times=1000.0))
    (warning,) = ask_gate(write_sensor(tmp_path, train)).warnings
    assert warning.kind == "not_shown_better"
    assert "and less than the chip in 3 of 4 held-out runs" in warning.text


def test_runs_that_share_no_temperature_cannot_be_judged_by_each_other(tmp_path: Path) -> None:
    apart = (replace(TRAIN[0], high_degC=22.0), replace(TRAIN[1], low_degC=28.0))
    verdict = ask_gate(write_sensor(tmp_path, apart))
    assert verdict.passes and verdict.rows == 0
    assert [warning.kind for warning in verdict.warnings] == ["not_judged"]


def tare(programs: Sequence[Program], offsets: Sequence[float]) -> list[Program]:
    return [replace(p, offset=o) for p, o in zip(programs, offsets, strict=True)]


def test_guessed_tare_excuses_no_error_and_the_user_is_asked(tmp_path: Path) -> None:
    """The training runs are 1 bar off, each by another amount; the test runs are not."""
    train = tare(TRAIN, (1.4, 0.6, 1.2, 0.8))
    project = write_sensor(tmp_path, (*train, *TESTS))
    (asked,) = ask_gate(project).refused
    assert asked.kind == "tare_decides"
    assert "tared = true (each log was zeroed on its own): the firmware is written" in asked.text
    assert "are errors of the chip): the firmware is refused:" in asked.text
    assert "no compensation 0.17 bar" in asked.text
    file = project / "zerodrift.toml"
    for told, kinds in (("true", set()), ("false", {"worse_than_none"})):
        text = file.read_text().replace("[logs]\n", f"[logs]\ntared = {told}\n")
        stated = tmp_path / told / "zerodrift.toml"
        stated.parent.mkdir()
        for log in project.glob("*.csv"):
            (stated.parent / log.name).write_bytes(log.read_bytes())
        stated.write_text(text)
        assert kinds <= list_kinds(ask_gate(stated.parent))
        assert kinds or ask_gate(stated.parent).passes


def test_guessed_tare_that_decides_nothing_is_no_question(tmp_path: Path) -> None:
    train = tare(TRAIN, (0.01, -0.02, 0.02, -0.01))
    tests = tare(TESTS, (-0.01, 0.01, 0.02))
    verdict = ask_gate(write_sensor(tmp_path, (*train, *tests)))
    assert verdict.passes and not verdict.warnings


def test_verdict_by_a_guessed_tare_names_what_depends_on_it() -> None:
    def give(refused: bool, *unproven: str) -> GateVerdict:
        no = (Statement(kind="worse_than_line", output="p", text="worse"),) if refused else ()
        told = tuple(Statement(kind="not_shown_better", output=o, text=o) for o in unproven)
        return GateVerdict("test logs", no, told, (), (), 1)

    assert ask_for_tare(give(True), give(True)).refused[0].kind == "worse_than_line"
    assert ask_for_tare(give(False, "p"), give(False, "p")) == give(False, "p")
    (told, kept) = ask_for_tare(give(False, "p"), give(False, "p", "q")).warnings
    assert told.kind == "tare_decides" and " in q:" in told.text and kept.output == "p"
    for verdicts in ((give(False), give(True)), (give(True), give(False))):
        (asked,) = ask_for_tare(*verdicts).refused
        assert asked.kind == "tare_decides" and "worse" in asked.text


def test_no_drift_by_temperature_is_not_shown_to_be_compensated(tmp_path: Path) -> None:
    """What drifts at random is learnt from two runs and is no use for others."""
    options = {"wander": 3.0, "full_scale": 100.0, "network": "lag_bank"}
    verdict = ask_gate(write_sensor(tmp_path, (*TRAIN[:2], *TESTS), **options))
    assert not verdict.passes or "not_shown_better" in {w.kind for w in verdict.warnings}


def test_network_without_test_logs_is_not_judged(tmp_path: Path) -> None:
    config = load_config(write_sensor(tmp_path, TRAIN[:2]))
    dataset = load_dataset(config)
    compensator = train(config, dataset).compensator
    assert left_out.leave_out(config, dataset, compensator) is not None
    with_network = replace(compensator, network=b"trained for an hour")
    assert left_out.leave_out(config, dataset, with_network) is None


@pytest.mark.long
def test_firmware_refuses_keeps_what_was_there_and_writes_when_forced(tmp_path: Path) -> None:
    project = write_sensor(tmp_path / "p", (*TRAIN, *TESTS), full_scale=1e7)
    out = project / "firmware"
    result = invoke("firmware", "-C", str(project), "--json")
    assert result.exit_code == 1
    assert "the firmware is refused" in str(result.exception)
    body = json.loads(result.stdout)
    assert body["written"] is False and body["forced"] is False and body["files"] == []
    assert [r["kind"] for r in body["refused"]] == ["worse_than_line", "worse_than_float"]
    assert body["chip_error"]["p"]["rounding"] > 0.1
    assert not out.exists() and not (project / "build" / "model.json").exists()
    firmware, _, note = read_firmware(load_config(project))
    assert firmware is None and note.startswith("The last `zerodrift firmware` was refused")

    forced = invoke("firmware", "-C", str(project), "--json", "--force")
    assert forced.exit_code == 0, forced.output
    body = json.loads(forced.stdout)
    assert body["written"] is True and body["forced"] is True
    header = (out / "p10.h").read_text()
    assert "#define P10_FORCED 1" in header
    assert "FORCED: written although" in header and "the chip errs by" in header
    table = tabulate_chip_error(from_json(FirmwareSummary, body))
    assert table.rows[0][:2] == ("p", "bar") and "FORCED: p: on rows inside" in table.note
    compared = json.loads(invoke("compare", "-C", str(project), "--json").stdout)
    assert compared["chip_error"] == body["chip_error"]
    assert "FORCED: p: on rows inside" in " ".join(
        invoke("compare", "-C", str(project)).stdout.split()
    )
    firmware, _, note = read_firmware(load_config(project))
    assert firmware is not None and firmware.forced and not note
    assert invoke("verify", "-C", str(project)).exit_code == 0
    assert invoke("verify", "-C", str(project), "--certificate").exit_code == 0
    assert invoke("firmware", "-C", str(project)).exit_code == 1
    firmware, _, note = read_firmware(load_config(project))
    assert firmware is not None
    assert note.endswith("What is shown here is the firmware before that one.")
    page = " ".join(invoke("compare", "-C", str(project)).stdout.split())
    assert "What is shown here is the firmware before that one." in page


def test_difference_is_split_by_cause_and_the_squares_add_up(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (run,) = load_dataset(load_config(write_sensor(tmp_path, TRAIN[:1]))).train
    rows = np.eye(5, dtype=np.bool_)[:, :, None]
    replayed = chip_error.RunReplay(
        run=run.take(slice(5)),
        chip=np.array([[0.001], [3.0], [4.0], [5.0], [6.0]]),
        floating=np.zeros((5, 1)),
        outside={"temperature": rows[1, :, 0]},
        after=np.zeros((5, 1), dtype=np.bool_),
        clamped=rows[2],
        rail=rows[3],
    )
    monkeypatch.setattr(chip_error, "find_saturated", lambda model, run: rows[4, :, 0])
    replay = chip_error.ChipReplay(None, (replayed,), np.array([0.01]))
    (split,) = replay.split()
    assert split.rounding == pytest.approx(0.001 / 5**0.5)
    assert split.out_of_range == pytest.approx(3.0 / 5**0.5)
    assert split.clamped == pytest.approx(4.0 / 5**0.5)
    assert split.saturated == pytest.approx(61.0**0.5 / 5**0.5)
    whole = np.sqrt(np.mean(replayed.difference**2))
    assert np.sqrt(sum(x**2 for x in asdict(split).values())) == pytest.approx(whole)
    assert [list(mask) for mask in replay.list_plain_rows()] == [[True] + [False] * 4]


def draw(
    rng: np.random.Generator, scale: float, runs: int = 4, rows: int = 500
) -> list[np.ndarray]:
    return [rng.normal(0.0, scale, rows) for _ in range(runs)]


@pytest.mark.parametrize(
    ("contrasts", "chance"),
    [
        # Student's t of 3 and 5 values by hand: mean over its standard error is 2.92 and 2.132.
        ([0.292 - 3**0.5 * 0.1, 0.292, 0.292 + 3**0.5 * 0.1], 0.05),
        ([0.2132 + 0.1 * 5**0.5 * x for x in (-1.0, -1.0, 0.0, 1.0, 1.0)], 0.05),
        ([0.4, 0.4], 0.0),
        ([0.0, 0.0], 1.0),
        ([(161.4 - 1) / (161.4 + 1)], 0.05),  # F(1, 1)
        ([0.0], 0.5),
        ([-1.0], 1.0),
        ([1.0], 0.0),
    ],
)
def test_chance_is_students_and_of_a_single_run_fishers(contrasts, chance) -> None:
    assert find_chance(np.array(contrasts)) == pytest.approx(chance, abs=2e-3)


def test_joint_level_is_holms() -> None:
    assert hold_jointly([0.011, 0.02, 0.03]) == [True, True, True]
    assert hold_jointly([0.03, 0.01, 0.026]) == [False, True, False]  # 0.026 > 0.05 / 2
    assert hold_jointly([0.02, 0.9, 0.9]) == [False, False, False]
    assert hold_jointly([]) == []


def test_larger_error_in_every_run_is_worse_and_in_one_of_them_chance() -> None:
    rng = np.random.default_rng(0)
    theirs = draw(rng, 1.0)
    found = contrast_errors([1.2 * e for e in theirs], theirs)
    assert found.is_worse and found.chance_if_alike < 1e-6 and found.runs_worse == 4
    assert not contrast_errors([1.02 * e for e in theirs], theirs).is_worse
    one_bad = [2.0 * theirs[0], *(0.99 * e for e in theirs[1:])]
    found = contrast_errors(one_bad, theirs)
    assert found.is_worse and found.chance_if_alike > 0.05 and not found.is_shown_better
    far_worse = [8.0 * k * e for k, e in enumerate(theirs, 1)]  # by unlike amounts
    assert contrast_errors(far_worse, theirs).chance_if_alike < 0.001


def test_smaller_error_in_every_run_is_shown_and_in_most_of_two_is_not() -> None:
    rng = np.random.default_rng(0)
    theirs = draw(rng, 1.0)
    assert contrast_errors([0.8 * e for e in theirs], theirs).is_shown_better
    mixed = contrast_errors([0.1 * theirs[0], *(1.05 * e for e in theirs[1:])], theirs)
    assert mixed.ratio < 1.0 and mixed.runs_worse == 3 and not mixed.is_shown_better
    assert contrast_errors([0.1 * e for e in theirs[:2]], theirs[:2]).is_shown_better
    unlike = [0.9 * theirs[0], 0.5 * theirs[1]]
    assert not contrast_errors(unlike, theirs[:2]).is_shown_better
    assert not contrast_errors([0.5 * theirs[0]], theirs[:1]).is_shown_better
    assert contrast_errors([0.05 * theirs[0]], theirs[:1]).is_shown_better


def test_few_runs_are_judged_by_blocks_longer_than_the_correlation() -> None:
    rng = np.random.default_rng(0)
    theirs = draw(rng, 1.0, runs=1, rows=2000)
    assert contrast_errors([1.2 * theirs[0]], theirs).chance_if_alike < 0.001
    burst = 0.99 * theirs[0]
    burst[:20] *= 6.0  # one event
    found = contrast_errors([burst], theirs)
    assert found.is_worse and found.chance_if_alike > 0.5
    slow = np.linspace(1.0, 2.0, 2000)  # one block
    assert 0.4 < contrast_errors([1.2 * slow], [slow], [2000]).chance_if_alike < 0.5
    assert contrast_errors([20.0 * slow], [slow], [2000]).chance_if_alike < 0.05


@pytest.mark.parametrize("runs", [1, 2, 3, 6])
def test_models_that_err_alike_are_told_apart_at_most_at_the_level(runs: int) -> None:
    """Both have slow errors of their own, runs of unlike size."""
    rng = np.random.default_rng(runs)
    worse = better = 0
    for _ in range(300):
        size = np.exp(rng.normal(size=runs))
        ours, theirs = ([s * np.repeat(rng.normal(size=20), 25) for s in size] for _ in range(2))
        found = contrast_errors(ours, theirs)
        worse += found.is_worse and found.chance_if_alike <= 0.05
        better += found.is_shown_better
    assert worse <= 25 and better <= 25  # 15 are expected; more than 25 in 1 of 100 trials


def test_correlation_is_that_of_a_first_order_process() -> None:
    rng = np.random.default_rng(1)
    x = np.zeros(200_000)
    noise = rng.normal(size=x.size)
    for i in range(1, x.size):
        x[i] = 0.9 * x[i - 1] + noise[i]
    # 2 (1 + 2 sum of 0.9**k, up to where it falls below 0.05)
    assert measure_correlation(x) == pytest.approx(2.0 * (1.0 + 2.0 * 0.95 * 9.0), rel=0.1)
    assert measure_correlation(noise) <= 3


def test_limits_that_the_float_model_lacks_are_saturation_and_no_rounding() -> None:
    power = IntegerExp2("exp2", ("x",), 1 << 24, 0, 0, -60 << 24, (10 << 24) + 5, 10)
    low, high = power.ends
    at_end = power.step({}, {"x": np.array([11, 9, -100])})[1]
    assert list((at_end <= low) | (at_end >= high)) == [True, False, False]
    counter = IntegerCounter("count", (), 7)
    assert counter.ends == (-1, 7)
    rows = {"low": (0, 0), "high": (INT16_MAX, 200), "shift": (0, 0), "activation": "clip"}
    dense = IntegerDense(
        "dense", ("h",), np.eye(2, dtype=np.int16), np.array([40000, 40000], dtype=np.int32), **rows
    )
    low, high = dense.ends
    value = dense.step({}, {"h": np.zeros((1, 2), dtype=np.int64)})[1][0]
    assert list((value <= low) | (value >= high)) == [True, False]  # 200 is the rectifier's own


@pytest.mark.parametrize("length", [1, 7, 100, 333, 5000])
def test_sums_of_blocks_are_those_of_the_blocks_one_by_one(length: int) -> None:
    part = np.random.default_rng(length).normal(size=3600) ** 2
    blocks = np.array_split(part, max(1, part.size // length))
    assert np.allclose(_sum_blocks(part, length), [block.sum() for block in blocks])
