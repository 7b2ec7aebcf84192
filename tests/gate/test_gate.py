"""Wrong firmware is refused and right firmware is not, each case as a user met it."""

import json
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest
from tests.gate.sensors import TESTS, TRAIN, ask_gate, heat, list_kinds, write_sensor
from tests.main_job.conftest import invoke

from zerodrift.app.commands.built import read_firmware
from zerodrift.base.config import load_config
from zerodrift.base.errors import InputError
from zerodrift.base.records import from_json
from zerodrift.dataset.load import load_dataset
from zerodrift.operations.arithmetic import INT16_MAX
from zerodrift.operations.counter import IntegerCounter
from zerodrift.operations.dense import IntegerDense
from zerodrift.operations.exp2 import IntegerExp2
from zerodrift.report.tables import tabulate_chip_error
from zerodrift.train.training import train
from zerodrift.verify import chip_error, left_out
from zerodrift.verify.contrast import (
    _sum_blocks,
    contrast_errors,
    find_quantile,
    measure_correlation,
)
from zerodrift.verify.summary import FirmwareSummary


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
    assert list_kinds(verdict) == {"worse_than_none"}
    assert "without compensation it is 0.17 bar (3 runs, 2700 rows)" in verdict.refused[0].text


def test_full_scale_far_too_large_is_refused_and_named(tmp_path: Path) -> None:
    verdict = ask_gate(write_sensor(tmp_path, (*TRAIN, *TESTS), full_scale=1e7))
    assert "worse_than_float" in list_kinds(verdict)
    assert "full_scale = 1e+07 bar is too large" in verdict.refused[0].text


@pytest.mark.parametrize(("runs", "method"), [(4, "leave one run out"), (1, "blocks of one run")])
def test_physics_without_test_logs_is_judged_by_runs_left_out(
    runs: int, method: str, tmp_path: Path
) -> None:
    verdict = ask_gate(write_sensor(tmp_path, TRAIN[:runs]))
    assert verdict.passes and verdict.method == method and verdict.rows == 900 * runs


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


def test_training_run_in_another_unit_is_refused_without_test_logs(tmp_path: Path) -> None:
    train = (*TRAIN[:3], replace(TRAIN[3], logged_times=1000.0))
    assert list_kinds(ask_gate(write_sensor(tmp_path, train))) == {"worse_than_none"}


def test_runs_that_share_no_temperature_cannot_be_judged_by_each_other(tmp_path: Path) -> None:
    apart = (replace(TRAIN[0], high_degC=22.0), replace(TRAIN[1], low_degC=28.0))
    verdict = ask_gate(write_sensor(tmp_path, apart))
    assert verdict.passes and verdict.rows == 0
    assert [warning.kind for warning in verdict.warnings] == ["not_judged"]


def test_network_without_test_logs_is_not_judged(tmp_path: Path) -> None:
    config = load_config(write_sensor(tmp_path, TRAIN[:2]))
    dataset = load_dataset(config)
    compensator = train(config, dataset).compensator
    assert left_out.leave_out(config, dataset, compensator) is not None
    with_network = replace(compensator, network=b"trained for an hour")
    assert left_out.leave_out(config, dataset, with_network) is None


def test_firmware_refuses_keeps_what_was_there_and_writes_when_forced(tmp_path: Path) -> None:
    project = write_sensor(tmp_path / "p", (*TRAIN, *TESTS), full_scale=1e7)
    out = project / "firmware"
    result = invoke("firmware", "-C", str(project), "--json")
    assert result.exit_code == 1
    assert "the firmware is refused" in str(result.exception)
    body = json.loads(result.stdout)
    assert body["written"] is False and body["forced"] is False and body["files"] == []
    assert [r["kind"] for r in body["refused"]] == ["worse_than_float"]
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
    ("runs", "beyond"),
    [(3, 4.53), (5, 2.87), (12, 2.25), (1000, 2.0)],  # Student's 97.72 % point
)
def test_few_runs_have_to_differ_by_more_standard_errors(runs: int, beyond: float) -> None:
    assert find_quantile(runs) == pytest.approx(beyond, abs=0.01)
    theirs = [np.full(400, 2.0**0.5) for _ in range(runs)]
    spread = np.where(np.arange(runs) % 2, 0.5, -0.5)
    spread -= spread.mean()
    error = np.std(spread, ddof=1) / runs**0.5  # of the mean squared error's excess over runs
    for times, is_beyond in ((1.02, True), (0.98, False)):
        ours = [np.full(400, (2.0 + times * beyond * error + x) ** 0.5) for x in spread]
        assert contrast_errors(ours, theirs).beyond_chance is is_beyond


def test_larger_error_in_every_run_counts_and_in_one_of_them_is_chance() -> None:
    rng = np.random.default_rng(0)
    theirs = draw(rng, 1.0)
    assert contrast_errors([1.2 * e for e in theirs], theirs).counts
    assert not contrast_errors([1.02 * e for e in theirs], theirs).worse
    one_bad = [2.0 * theirs[0], *(0.99 * e for e in theirs[1:])]
    contrast = contrast_errors(one_bad, theirs)
    assert contrast.worse and contrast.beyond_chance is False and not contrast.counts
    far_worse = [theirs[0], *(8.0 * k * e for k, e in enumerate(theirs[1:], 1))]
    assert contrast_errors(far_worse, theirs).counts  # whatever the spread of the runs


def test_few_runs_are_judged_by_blocks_longer_than_the_correlation() -> None:
    rng = np.random.default_rng(0)
    theirs = draw(rng, 1.0, runs=1, rows=2000)
    assert contrast_errors([1.2 * theirs[0]], theirs).counts
    burst = theirs[0].copy()
    burst[:20] *= 6.0  # one event
    contrast = contrast_errors([burst], theirs)
    assert contrast.worse and contrast.beyond_chance is not None
    slow = np.sin(np.linspace(0.0, 3.0, 2000))
    alone = contrast_errors([1.2 * slow], [slow])
    assert alone.beyond_chance is None and alone.counts


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
    sums, sizes = _sum_blocks(part, length)
    assert np.array_equal(sums, [block.sum() for block in blocks])
    assert np.array_equal(sizes, [block.size for block in blocks])
