"""Which unit is in place: means of simulated units, which share no code with the test."""

from dataclasses import replace

import numpy as np
import pytest

from zerodrift.field.noise import BlockNoise
from zerodrift.field.swapped import (
    FALSE_NAME,
    Before,
    Foretold,
    UnitsWeighed,
    add_look,
    choose,
    count_fewest,
    find_unit,
    weigh_units,
)
from zerodrift.field.watch import BlockMeans, Learned, Rules

RULES = Rules(0.01, 14_400.0, 0.1)
SAMPLES, NOISE = 240.0, 1.0
OLD, NEW = 84, 12
SPREAD = np.array([40.0, 20.0])
"""Of slope and curvature between units."""


def draw_means(rng: np.random.Generator, first: int, n: int, drift: np.ndarray) -> BlockMeans:
    """Return means of a drift [3] over temperature, and noise; the zero is any."""
    place = np.arange(first, first + n)
    warm = 0.8 * np.sin(2 * np.pi * place / 6) + 0.2 * np.cos(2 * np.pi * place / 31)
    residual = 5.0 + np.stack([warm, warm**2], axis=1) @ drift
    residual += rng.normal(size=n) * NOISE / np.sqrt(SAMPLES)
    return BlockMeans(place, np.full(n, SAMPLES), residual, warm)


def draw_case(seed: int, units: int, mounted: int | None, *, twin: bool = False, old: int = OLD):
    """Return what the naming is given: `mounted` of the known units, or one that nobody knows."""
    rng = np.random.default_rng(seed)
    known = rng.normal(size=(units, 2)) * SPREAD
    if twin:
        known[1] = known[0]
    true = known[mounted] if mounted is not None else rng.normal(size=2) * SPREAD
    noise = BlockNoise(NOISE**2, 1e-9, (0.0, 0.0, 0.0), RULES.block_s)
    new = draw_means(rng, OLD, NEW, true)
    terms = np.stack([new.temperature, new.temperature**2], axis=1)
    wrong = rng.normal(size=(units, 2)) * RULES.calibrated * np.array([1.0, 1.0])
    left = new.residual - (known + wrong) @ terms.T
    learned = Learned(old, (noise,)) if old else None
    before = draw_means(rng, 0, old, np.zeros(2))
    foretold = Foretold(new, left, np.full(units, RULES.calibrated), np.zeros(left.shape))
    return {"y": (foretold, Before(before, learned, RULES))}


def draw_part(seed: int) -> tuple[Foretold, Before]:
    """Return four days over a third of the range, where models leave the next order, x^3."""
    rng = np.random.default_rng(seed)
    before = draw_case(seed, 1, 0)["y"][1]
    blocks = draw_means(rng, OLD, 24, np.zeros(2))
    warm = 0.3 * blocks.temperature
    known = rng.normal(size=(20, 2)) * (22.0, 9.0) @ np.stack([warm, warm**2])
    left = 0.25 * rng.choice([-1, 1]) * np.sqrt(7.0) / 2 * (5 * warm**3 - 3 * warm)
    blocks = replace(blocks, residual=blocks.residual + known[3] + left, temperature=warm)
    return Foretold(blocks, blocks.residual - known, np.full(20, 0.25), 0.0 * known), before


@pytest.mark.parametrize(("units", "cases"), [(1, 20), (12, 12), (60, 4)])
def test_the_unit_that_is_mounted_is_named(units: int, cases: int) -> None:
    told = [find_unit(draw_case(seed, units, units - 1), units) for seed in range(cases)]
    assert sum(one.named == units - 1 for one in told) >= 0.8 * cases
    assert all(units - 1 in one.possible for one in told)


@pytest.mark.spread(1, "units", [1, 12, 60])
def test_a_unit_that_nobody_knows_gets_no_name_more_often_than_stated(units: int) -> None:
    told = [find_unit(draw_case(100 + seed, units, None), units) for seed in range(60)]
    assert sum(one.named is not None for one in told) <= 5  # 1 in 29 where 5 % were the chance
    assert sum(not one.possible for one in told) >= 40


def test_two_units_that_cannot_be_told_apart_are_both_possible() -> None:
    for seed in range(10):
        told = find_unit(draw_case(seed, 12, 0, twin=True), 12)
        assert told.named is None
        assert set(told.possible) == {0, 1}


def test_a_unit_that_was_there_from_the_first_sample_is_named_without_a_sound_time() -> None:
    told = [find_unit(draw_case(seed, 12, 3, old=0), 12) for seed in range(10)]
    assert [one.named for one in told].count(3) >= 8


def test_less_than_a_day_names_nobody() -> None:
    case = draw_case(0, 12, 3)
    foretold, before = case["y"]
    few = count_fewest(RULES.block_s) - 1
    blocks = foretold.blocks.first(few)
    left, flagged = foretold.residual[:, :few], foretold.flagged[:, :few]
    short = Foretold(blocks, left, foretold.calibrated, flagged)
    assert find_unit({"y": (short, before)}, 12) is None
    assert count_fewest(3600.0) == 24


def test_a_model_that_leaves_more_than_the_noise_is_not_possible_however_bad_the_others() -> None:
    (foretold, before) = draw_case(0, 1, 0)["y"]
    rough = np.where(np.arange(NEW) % 2, 1.0, -1.0)
    blocks = replace(foretold.blocks, residual=foretold.blocks.residual + rough)
    left = Foretold(blocks, foretold.residual + rough, foretold.calibrated, foretold.flagged)
    told = find_unit({"y": (left, before)}, 1)
    assert told.named is None and not told.possible


def test_a_trained_model_is_judged_by_what_its_own_calibration_leaves() -> None:
    """The drift has a wave over temperature and a lag that no model of the design has."""
    own, others = [], []
    for seed in range(12):
        foretold, before = draw_case(300 + seed, 12, 3)["y"]
        rng = np.random.default_rng(seed)
        warm = foretold.blocks.temperature
        misfit = np.sin(6.0 * warm + rng.uniform(0, 7)) + np.gradient(warm) / 0.4
        misfit *= 3.0 * NOISE / np.sqrt(SAMPLES) / np.std(misfit)
        blocks = replace(foretold.blocks, residual=foretold.blocks.residual + misfit)
        for uncertainty, told in ((4.0 * RULES.calibrated, own), (0.001, others)):
            calibrated = foretold.calibrated.copy()
            calibrated[3] = uncertainty
            left = Foretold(blocks, foretold.residual + misfit, calibrated, foretold.flagged)
            told.append(find_unit({"y": (left, before)}, 12))
    assert sum(one.named == 3 for one in own) >= 10
    assert all(one.named in (3, None) for one in own)
    assert sum(3 in one.possible for one in others) <= 3  # with a model that is that certain


def test_what_a_fit_leaves_first_is_expected_in_a_part_of_the_range() -> None:
    told = [find_unit({"y": draw_part(seed)}, 20).named for seed in range(10)]
    assert told.count(3) >= 5  # 3 where it must follow temperature and its square
    assert set(told) <= {3, None}


def test_a_look_spends_its_chance_only_where_it_was_taken() -> None:
    looks: tuple[int, ...] = ()
    for count in range(5, 30):
        looks = add_look(looks, count, RULES.block_s)
    assert looks == (6, 12, 24)
    for seed in range(3):
        foretold, before = draw_part(seed)
        (at_once, late) = (
            weigh_units(replace(foretold, looks=taken), before).needed[3] for taken in ((), (6, 12))
        )
        assert at_once < late < np.inf


def test_a_block_outside_the_range_of_a_unit_says_nothing_against_it() -> None:
    named = {False: 0, True: 0}
    for seed in range(6):
        foretold, before = draw_case(500 + seed, 12, 3)["y"]
        wrong, flagged = foretold.residual.copy(), foretold.flagged.copy()
        wrong[3, -1] += 10.0
        for is_told in (False, True):
            flagged[3, -1] = float(is_told)
            left = replace(foretold, residual=wrong, flagged=flagged.copy())
            told = find_unit({"y": (left, before)}, 12)
            named[is_told] += told.named == 3
            assert (3 in told.possible) == is_told
    assert named[False] == 0 and named[True] >= 5


def weigh(own: list[float], unknown: float, needed: float = 0.0) -> UnitsWeighed:
    n = len(own)
    return UnitsWeighed(
        np.array(own), np.full(n, unknown), np.full(n, needed), np.ones(n, dtype=bool)
    )


def test_a_name_needs_its_probability_among_the_known() -> None:
    odds = np.log((1 - FALSE_NAME) / FALSE_NAME)
    assert choose([weigh([odds + 0.01, 0.0], -50.0)], 1).named == 0
    assert choose([weigh([odds - 0.01, 0.0], -50.0)], 1).named is None
    # rivals add up where they are as likely, and do not where they are ruled out
    assert choose([weigh([odds + np.log(2) + 0.01, 0.0, 0.0], -50.0)], 2).named == 0
    assert choose([weigh([odds + np.log(2) - 0.01, 0.0, 0.0], -50.0)], 2).named is None
    assert choose([weigh([odds + 0.01, 0.0, *[-50.0] * 100], -50.0)], 101).named == 0


def test_a_name_needs_a_ratio_that_strangers_do_not_reach() -> None:
    assert choose([weigh([4.1, -50.0], 0.0, 4.0)], 1).named == 0
    assert choose([weigh([3.9, -50.0], 0.0, 4.0)], 1).named is None
    assert choose([weigh([3.9, -50.0], 0.0, 4.0)], 1).possible == (0,)
    # one output of two is enough where the other does not speak against it
    two = [weigh([4.1, -50.0], 0.0, 4.0), weigh([0.1, -50.0], 0.0, 4.0)]
    assert choose(two, 1).named == 0


def test_an_output_that_speaks_against_a_name_takes_it_away() -> None:
    sure = weigh([20.0, -50.0, -50.0], 0.0)
    assert choose([sure, weigh([0.0, 0.0, -50.0], 0.0)], 2).named == 0
    assert choose([sure, weigh([-9.0, 0.0, -50.0], 0.0)], 2).named is None
