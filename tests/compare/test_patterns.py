"""The scan: planted conditions are found in words, chance is not."""

import numpy as np
import pytest

from zerodrift.diagnosis.descriptors import cut_blocks, describe, format_time, list_thresholds
from zerodrift.diagnosis.segments import (
    NO_PATTERN,
    SIGNED,
    Scan,
    count_digits,
    find_failures,
    find_patterns,
    score_place,
)

FLOOR = np.array([0.05, 0.05])
NAMES = {"outputs": ("Fz", "Mx"), "units": ("N", "Nm"), "full_scale": (2000.0, 20.0)}


def find(runs):
    errors = [[run.drift] for run in runs]
    return find_failures([[run] for run in runs], errors, FLOOR, **NAMES)


def on_fz(values):
    return np.stack([values, np.zeros_like(values)], axis=1)


def words_of(failures, output=0):
    return [p.words for p in failures.patterns if p.output == output]


def test_first_minutes_after_power_on_are_named(make_run):
    runs = [make_run(i, lambda r: on_fz(2.0 * (r.time_s < 240.0))) for i in range(6)]
    failures = find(runs)
    assert words_of(failures) == ["first 4 min after power-on"]
    assert words_of(failures, 1) == []
    worst = failures.worst[0]
    assert (worst.output, worst.from_s, worst.to_s) == ("Fz", 0.0, 239.0)
    assert worst.pattern == "first 4 min after power-on"


def test_temperature_threshold_is_found_where_it_was_planted(make_run):
    runs = [make_run(i, lambda r: on_fz(1.0 * (r.temperature_degC > 30.0))) for i in range(6)]
    assert words_of(find(runs)) == ["above 30 degC"]


def test_cooling_is_told_from_heating(make_run):
    def error(run):
        slope = np.gradient(run.temperature_degC)
        return on_fz(1.5 * (slope < -0.04))

    words = words_of(find([make_run(i, error) for i in range(6)]))
    assert len(words) == 1
    assert words[0].startswith("while cooling faster than ")
    assert words[0].endswith("K/min")


def test_load_is_named_with_its_axis_and_unit(make_run):
    runs = [make_run(i, lambda r: on_fz(1.0 * (r.reference[:, 0] > 150.0))) for i in range(6)]
    words = words_of(find(runs))
    assert words
    assert words[0].startswith("under load on Fz above ")
    threshold = float(words[0].split()[-2])
    assert 100.0 < threshold <= 200.0


def test_two_conditions_are_found_together(make_run):
    def error(run):
        rises = np.gradient(run.temperature_degC) > 0.02
        return on_fz(2.0 * (rises & (run.temperature_degC > 30.0)))

    words = words_of(find([make_run(i, error) for i in range(8)]))
    assert any("30 degC" in w and "heating" in w for w in words)


def test_error_that_changes_sign_with_the_branch_is_signed(make_run):
    def error(run):
        slope = np.sign(np.gradient(run.temperature_degC))
        turned = np.flatnonzero(slope)
        last = turned[np.maximum(np.searchsorted(turned, np.arange(len(run)), side="right") - 1, 0)]
        return on_fz(0.4 * slope[last])

    patterns = [p for p in find([make_run(i, error) for i in range(6)]).patterns if p.output == 0]
    assert {p.words for p in patterns} == {"on the heating branch", "on the cooling branch"}
    assert all(p.kind == SIGNED for p in patterns)
    signs = {p.words: np.sign(p.mean_error) for p in patterns}
    assert signs["on the heating branch"] == 1.0
    assert signs["on the cooling branch"] == -1.0


@pytest.mark.parametrize("seed", range(5))
def test_noise_has_no_pattern(make_run, seed):
    failures = find([make_run(10 * seed + i) for i in range(6)])
    assert failures.patterns == ()
    assert failures.worst == ()


def test_outputs_that_fail_in_the_same_place_are_told_by_the_same_words(make_run):
    def error(run):
        warm = np.clip((run.temperature_degC - 30.0) / 15.0, 0.0, 1.0)
        return np.stack([warm, np.sqrt(warm)], axis=1)

    failures = find([make_run(i, error) for i in range(6)])
    assert words_of(failures)[0] == words_of(failures, 1)[0]
    assert words_of(failures)[0].startswith("above 3")


def test_what_one_run_shows_is_a_segment_but_no_pattern(make_run):
    runs = [make_run(i) for i in range(6)]
    runs[3].measured[400:500, 0] += 2.0
    failures = find(runs)
    assert failures.patterns == ()
    assert [s.pattern for s in failures.worst] == [NO_PATTERN]
    assert failures.worst[0].run == "run3"
    assert abs(failures.worst[0].from_s - 400.0) <= 5.0
    assert abs(failures.worst[0].to_s - 499.0) <= 5.0


def test_segment_rmse_is_that_of_its_samples(make_run):
    runs = [make_run(i, lambda r: on_fz(2.0 * (r.time_s < 240.0))) for i in range(6)]
    for segment in find(runs).worst:
        run = next(r for r in runs if r.group == segment.run)
        rows = (run.time_s >= segment.from_s) & (run.time_s <= segment.to_s)
        k = NAMES["outputs"].index(segment.output)
        assert segment.rmse == pytest.approx(float(np.sqrt(np.mean(run.drift[rows, k] ** 2))))
        assert segment.mean_error == pytest.approx(float(run.drift[rows, k].mean()))


def test_segments_are_ranked_by_percent_of_full_scale(make_run):
    def error(run):
        early = 1.0 * (run.time_s < 240.0)
        return np.stack([2.0 * early, 0.5 * early], axis=1)

    worst = find([make_run(i, error) for i in range(6)]).worst
    scale = dict(zip(NAMES["outputs"], NAMES["full_scale"], strict=True))
    shares = [s.rmse / scale[s.output] for s in worst]
    assert shares == sorted(shares, reverse=True)
    assert worst[0].output == "Mx"


def test_segments_do_not_cross_a_gap(make_run):
    first = make_run(0, lambda r: on_fz(np.full(len(r), 1.0)), length=300)
    second = make_run(0, lambda r: on_fz(np.full(len(r), 1.0)), length=300, part=1)
    second.time_s[:] += 1000.0
    others = [[make_run(i)] for i in range(1, 5)]
    runs = [[first, second], *others]
    failures = find_failures(runs, [[r.drift for r in run] for run in runs], FLOOR, **NAMES)
    assert failures.worst
    assert all(s.to_s - s.from_s < 300.0 for s in failures.worst)


def test_single_run_is_cut_in_pieces_that_stand_in_for_runs(make_run):
    run = make_run(0, lambda r: on_fz(1.0 * (np.sin(r.time_s / 20.0) > 0.5)), length=4000)
    swing = np.sin(run.time_s / 20.0)
    run = make_run(
        0, lambda r: on_fz(1.0 * (np.sin(r.time_s / 20.0) > 0.5)), length=4000, supply=5.0 + swing
    )
    assert words_of(find([run])) == ["with supply above 5.5"]


def test_thresholds_are_readable_numbers_in_the_range():
    values = np.random.default_rng(0).uniform(-13.7, 61.2, 5000)
    thresholds = list_thresholds(values)
    assert thresholds.size >= 12
    assert np.all((thresholds > -13.7) & (thresholds < 61.2))
    assert np.allclose(thresholds / 5.0, np.round(thresholds / 5.0))


def test_thresholds_of_a_constant_are_none():
    assert list_thresholds(np.full(100, 3.0)).size == 0


@pytest.mark.parametrize(
    ("seconds", "text"), [(45.0, "45 s"), (60.0, "1 min"), (480.0, "8 min"), (7200.0, "2 h")]
)
def test_times_are_told_in_the_unit_that_reads_best(seconds, text):
    assert format_time(seconds) == text


def test_score_is_zero_for_an_even_spread_and_grows_with_concentration():
    shares = score_place(np.array([0.2, 0.5, 0.9]), np.array([0.2, 0.2, 0.2]))
    assert shares[0] == 0.0
    assert 0.0 < shares[1] < shares[2]


def test_score_names_no_place_that_is_nearly_everywhere():
    assert score_place(np.array(0.99), np.array(0.8)) == 0.0


@pytest.mark.parametrize(("number", "digits"), [(20.0, 0), (25.0, 1), (0.5, 0), (-12.5, 2)])
def test_digits_beyond_the_first_are_counted(number, digits):
    assert count_digits(number) == digits


def test_tally_counts_what_holds(make_run):
    runs = [make_run(i) for i in range(3)]
    blocks = cut_blocks([[run] for run in runs])
    scan = Scan(
        describe(blocks, [run.drift for run in runs], ("Fz", "Mx"), ("N", "Nm")), blocks.run
    )
    weight = np.random.default_rng(1).uniform(size=blocks.run.size)
    sums = scan.tally(0, weight).sum(axis=0)
    conditions = scan.list_conditions(0)
    assert sums.size == len(conditions)
    for condition, total in zip(conditions[::7], sums[::7], strict=True):
        assert total == pytest.approx(float(weight[scan.hold(condition)].sum()))


def test_pattern_needs_some_error(make_run):
    runs = [make_run(i) for i in range(3)]
    blocks = cut_blocks([[run] for run in runs])
    scan = Scan(
        describe(blocks, [run.drift for run in runs], ("Fz", "Mx"), ("N", "Nm")), blocks.run
    )
    zeros = np.zeros((blocks.run.size, 2))
    assert find_patterns(scan, zeros, zeros) == []
