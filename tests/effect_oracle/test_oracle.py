"""The oracle: its evidence against integration by hand, and whether its probabilities hold."""

import math
from collections.abc import Sequence

import numpy as np
import pytest
from benchmarks.bench_oracle import check_bands, judge_case, main

from zerodrift_lab.oracle import oracle as module
from zerodrift_lab.oracle.forms import BLOCK, CHIP, FORMS, SetPrior, rms, tabulate, take_means
from zerodrift_lab.oracle.generator import Case, draw_case, draw_slow
from zerodrift_lab.oracle.oracle import RATIOS, Oracle, judge


def make_small(seed: int, sizes: tuple[float, float] = (3.0, 10.0), **wanted: object) -> Case:
    """Return a case of few rows."""
    given = {"runs": 2, "rows": (300, 600), "thermometers": 1, "thermometer_error_K": 0.0}
    return draw_case(seed, sizes=sizes, **{**given, **wanted})  # type: ignore[arg-type]


def weigh_by_hand(oracle: Oracle, case: Case, one: int | None, place: float, ratio: int) -> float:
    """Return log p(data) of one effect and a line: a dense Gaussian, the level summed on a grid."""
    chip = case.signals.series[CHIP]
    y = take_means((case.measured - case.reference)[None], case.lengths)[0]
    y = (y - y.mean()) / rms(y - y.mean())
    columns = [np.ones_like(y), take_means((chip - chip.mean())[None], case.lengths)[0]]
    sd = [module.OFFSET, math.sqrt((10.0**2 + 600.0 + 60.0**2) / 3.0) / columns[1].std()]
    middle = [0.0, 0.0]
    if one is not None:
        entry = case.entries[one]
        node = round(place)
        columns.append(entry.columns[0][node if len(entry.columns[0]) > 1 else 0])
        scale = entry.scale[0][node]
        sd.append(oracle.width / scale)
        middle.append(oracle.middle / scale)
    x = np.stack(columns, axis=1)
    x[:, 1:] -= x[:, 1:].mean(axis=0)
    blocks = [length // BLOCK for length in case.lengths]
    noise = np.zeros((y.size, y.size))
    start = 0
    for size in blocks:
        part = slice(start, start + size)
        noise[part, part] = module._covariance(size, case.signals.step_s, RATIOS[ratio])
        start += size
    whole = noise + (x * np.array(sd) ** 2) @ x.T
    values, vectors = np.linalg.eigh(whole)
    found = []
    for log_u in np.linspace(-3.0, 12.0, 6001):
        u = math.exp(log_u)
        signed = []
        for sign in (1.0, -1.0):
            left = vectors.T @ (u * y - sign * (x @ np.array(middle)))
            signed.append(-0.5 * float(left**2 @ (1.0 / values)))
        found.append(y.size * log_u + np.logaddexp(*signed) - math.log(2.0))
    top = max(found)
    return top + math.log(sum(math.exp(one - top) for one in found)) - 0.5 * np.log(values).sum()


@pytest.mark.parametrize("ratio", [0, 5])
@pytest.mark.parametrize("kind", ["warm_up", "dark_current"])
def test_evidence_is_that_of_a_dense_gaussian(kind: str, ratio: int) -> None:
    case = make_small(5, sizes=(0.1, 0.5))
    oracle = Oracle(case)
    one = next(n for n, entry in enumerate(case.entries) if entry.candidate.form.kind == kind)
    place = 3.0
    drawn = math.log(case.entries[one].allowed.sum())
    found = oracle.weigh((one,), np.array([[place]]), 1, ratio)[0] + drawn
    found -= oracle.weigh((), np.zeros((1, 0)), 1, 0)[0]
    wanted = weigh_by_hand(oracle, case, one, place, ratio)
    wanted -= weigh_by_hand(oracle, case, None, 0.0, 0)
    assert found == pytest.approx(wanted, abs=0.05)


def test_columns_between_the_points_of_the_grid_are_interpolated() -> None:
    """To a hundredth of a noise level at the largest size, where the play's corners are worst."""
    case = draw_case(4, runs=1, rows=(600, 600), thermometers=1)
    for entry in tabulate(case.signals, case.lengths):
        form = entry.candidate.form
        if not form.value:
            continue
        middle = np.flatnonzero(entry.allowed)[entry.allowed.sum() // 2]
        x = np.array([middle - 0.5])
        grid = np.arange(entry.grid.size, dtype=float)
        value = np.interp(x, grid, np.log(entry.grid) if form.log else entry.grid)
        value = np.exp(value) if form.log else value
        built = form.build(case.signals, entry.candidate.signal, value)
        nodes, shares, _ = module._interpolate(x, entry.allowed)
        for column, exact in zip(entry.columns, built, strict=False):
            if len(column) == 1:
                continue
            between = (shares[0][:, None] * column[nodes[0]]).sum(axis=0)
            wrong = rms(between - take_means(exact, case.lengths)[0]) / entry.scale[0][middle]
            assert wrong < (1e-2 if "hysteresis" in form.kind else 1e-3), form.name


def test_slow_noise_has_the_covariance_that_the_oracle_takes() -> None:
    drawn = draw_slow(np.random.default_rng(1), (400, 512), 10.0)
    means = drawn.reshape(400, -1, BLOCK).mean(axis=2)
    wanted = module._covariance(32, 10.0, 1.0) - np.eye(32) / BLOCK
    found = np.array([(means[:, : 32 - lag] * means[:, lag:]).mean() for lag in range(8)])
    assert found == pytest.approx(wanted[0, :8], abs=0.05)


def test_the_prior_over_sets_sums_to_one() -> None:
    case = make_small(7, thermometers=2)
    candidates = [entry.candidate for entry in case.entries]
    prior = SetPrior(candidates[:9])
    total = 0.0
    for chosen in range(2 ** len(prior.candidates)):
        members = [one for n, one in enumerate(prior.candidates) if chosen >> n & 1]
        if len(members) <= prior.most:
            total += math.exp(prior.log_probability(members))
    assert total == pytest.approx(1.0)


def test_what_is_rewritten_goes_with_nothing_else_that_follows_the_chip() -> None:
    case = make_small(7, thermometers=2)
    by_name = {one.candidate.key: one.candidate for one in case.entries}
    lag = by_name["thermal_lag, rewriting", CHIP]
    prior = SetPrior(list(by_name.values()))
    assert math.isinf(prior.log_probability([lag, by_name["dark_current", CHIP]]))
    assert math.isinf(prior.log_probability([lag, by_name["thermal_lag, own", "body_1"]]))
    assert math.isfinite(prior.log_probability([lag, by_name["dark_current", "body_1"]]))


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_case_without_an_effect_is_called_so(seed: int) -> None:
    found = judge(make_small(seed, count=0))
    assert found.by_kinds[frozenset()] > 0.9


@pytest.mark.long
def test_large_effects_are_named_and_no_others() -> None:
    of_truth = []
    for seed in (1, 2, 3, 4):
        case = make_small(seed, count=2, slow_ratio=0.0)
        found = judge(case)
        assert len(case.truth.kinds) == 2
        assert max(found.by_kinds, key=lambda kinds: found.by_kinds[kinds]) == case.truth.kinds
        assert sum(p for _, p in found.sets) == pytest.approx(1.0)
        assert -3.0 < found.expected_log_score <= 0.0
        of_truth.append(found.by_kinds[case.truth.kinds])
    assert np.mean(of_truth) > 0.9


def draw_weak(seeds: Sequence[int]) -> list[tuple[Case, module.Posterior, list[str]]]:
    """Return cases of effects that are hard to see, judged, with the kinds that they may have."""
    found = []
    for seed in seeds:
        case = make_small(seed, sizes=(0.1, 1.0), runs=1 + seed % 3)
        oracle = Oracle(case)
        found.append((case, oracle.judge(), sorted(oracle.prior.by_kind)))
    return found


@pytest.mark.long
def test_probabilities_hold_and_the_truth_scores_highest() -> None:
    """Of 60 drawn cases, within bounds that a calibrated judge leaves once in 300 times a band."""
    judged = draw_weak(range(500, 560))
    claims = [
        (found.probability_in(kind), kind in case.truth.kinds)
        for case, found, kinds in judged
        for kind in kinds
    ]
    for count, expected, right, deviation in check_bands(claims):
        assert count >= 20
        assert abs(right - expected) <= 3.0 * deviation + 1.0
    # Its own expectation of its score holds too.
    scores = np.array([found.log_score(case.truth.kinds) for case, found, _ in judged])
    expected = np.array([found.expected_log_score for _, found, _ in judged])
    apart = scores - expected
    assert abs(apart.mean()) <= 3.0 * apart.std() / math.sqrt(len(apart))
    # No other rule of naming a set from the truth has a higher mean: one effect less, one more.
    rng = np.random.default_rng(1)
    for change in ("less", "more"):
        other = []
        for case, found, kinds in judged:
            named = sorted(case.truth.kinds)
            if change == "less" and named:
                named.remove(str(rng.choice(named)))
            elif change == "more":
                named.append(str(rng.choice([kind for kind in kinds if kind not in named])))
            other.append(found.log_score(named))
        assert scores.mean() > np.mean(other)


def test_the_benchmark_prints_its_tables(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--cases", "1", "--seed", "3"]) == 0
    printed = capsys.readouterr().out
    assert printed.startswith("1 simulated sensors, seed 3")
    assert "| all | 1 |" in printed


def test_bands_count_what_was_claimed() -> None:
    rows = check_bands([(0.05, False), (0.5, True), (0.5, False), (1.0, True)])
    assert [(row[0], row[2]) for row in rows] == [(1, 0), (2, 1), (1, 1)]
    assert rows[1][3] == pytest.approx(math.sqrt(0.5))


def test_a_seed_decides_the_oracle_too() -> None:
    first, again = (judge_case((4, (3.0, 10.0))) for _ in range(2))
    assert (first.claims, first.log_score) == (again.claims, again.log_score)


def test_forms_have_names_of_their_own() -> None:
    assert len({form.name for form in FORMS}) == len(FORMS)
