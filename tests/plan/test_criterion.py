"""What a programme is expected to tell, against worked answers."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.special import ndtr

from tests.plan.projects import EXPERIMENT, read
from zerodrift.base.errors import InputError
from zerodrift.diagnosis.evidence import SURE_NATS
from zerodrift.diagnosis.examination import LIKE_BEST, LIKE_BEST_UNITS
from zerodrift.diagnosis.rules import SURE_UNITS
from zerodrift.discovery.criterion import (
    Judge,
    Told,
    expect_pairs,
    expect_verdicts,
    rise,
    tell_disguised,
    tell_rivals_apart,
)
from zerodrift.discovery.plan import (
    NothingLeftError,
    Question,
    choose_forms,
    expect_disguise,
    judge_closely,
    look_closer,
    plan_experiment,
    refuse_alike,
)
from zerodrift.discovery.programme import Log, Setting
from zerodrift.discovery.search import list_designs
from zerodrift.physics.catalogue import load_catalogue
from zerodrift.physics.effect import FEWEST_RUNS
from zerodrift.physics.reduction import MEANS, cut_octaves

CATALOGUE = load_catalogue()


def plan(*between, hours=2.0, budget_s=2.0, experiment=EXPERIMENT, target=0.001):
    question = Question(hours, between, target, budget_s)
    return plan_experiment(read(experiment), None, CATALOGUE, question)


@pytest.fixture(scope="module")
def planned():
    return plan("creep", "load_hysteresis")


@pytest.mark.long
def test_the_best_programme_is_no_worse_than_the_first_answer(planned):
    assert planned.best.tried > 20
    assert planned.first_cpu_s <= planned.cpu_s
    assert expect_verdicts(planned.told).mean() > 0.5


@pytest.mark.long
def test_a_programme_without_loads_tells_nothing_of_load_effects(planned):
    judge = Judge(planned.scene, planned.limits, (), (0,))
    still = Log(
        (Setting(0.0, 23.0, 0.0, {"Fz": 0.0}), Setting(60.0, 45.0, 2.0, {"Fz": 0.0})), 3000.0
    )
    told = judge.judge_logs([still], np.array([2.0]))
    assert told.gain.max() < 1e-6
    assert expect_verdicts(told).max() < 0.01


@pytest.mark.long
def test_a_pure_ramp_cannot_tell_what_is_proportional_on_it():
    """The gain of an effect is its squared size over the noise, worked out by hand for one step."""
    planned = plan("crosstalk", "load_hysteresis")
    # One load on one output: crosstalk is k load, a column of its own beside the base.
    (contender, _) = planned.scene.contenders
    truth = replace(contender.truths[0], coefficients=np.array([[0.0, 0.0, 0.01]]))
    truths = (truth,) * len(contender.truths)
    scene = replace(
        planned.scene,
        base=planned.scene.base[:1],
        contenders=(
            replace(
                contender,
                truths=tuple(
                    replace(t, terms=(t.terms[0], t.terms[2]), coefficients=np.array([[0.0, 0.01]]))
                    for t in truths
                ),
                forms=tuple(
                    replace(form, models=tuple((m[0], m[2]) for m in form.models), place=1)
                    for form in contender.forms
                ),
            ),
        ),
    )
    white = replace(scene.noise, weights=np.array([[4.0]]), tau_samples=np.array([0.0]))
    judge = Judge(
        replace(scene, noise=white), replace(planned.limits, loads=planned.limits.loads), (), (0,)
    )
    half = Log(
        (Setting(0.0, 23.0, 0.0, {"Fz": 0.0}), Setting(960.0, 23.0, 0.0, {"Fz": 100.0})), 1920.0
    )
    told = judge.judge_logs([half], np.array([1.0]))
    # 0.01 x 100 N for half of 1920 s, its mean taken off: 1920 x 0.5^2 over a variance of 4.
    assert told.gain[0, 0] == pytest.approx(1920 * 0.25 / 4.0, rel=0.02)
    # Half of the time 50 N above the mean, half below: 0.5 squared over a variance of 4.
    assert told.excess[0, 0] == pytest.approx([0.25 / 4.0], rel=0.02)
    # All of it, 120 noise units, lies in the slowest octave, which shares a variance with the
    # three next ones until there are 8 coefficients or more: 1 + 2 + 4 + 8.
    assert told.nats[0, 0] == pytest.approx(0.5 * 15 * np.log(1.0 + 120.0 / 15.0), rel=0.02)
    twice = judge.judge_logs([half], np.array([2.0]))
    assert twice.excess[0, 0] == pytest.approx(told.excess[0, 0], rel=1e-9)
    assert twice.gain[0, 0] == pytest.approx(2.0 * told.gain[0, 0], rel=1e-9)


@pytest.mark.long
def test_effects_that_are_not_open_may_be_taken_for_one_that_is():
    """A thermal lag of a short time constant is nearly the delay that it is mistaken for."""
    planned = plan("clock_delay", "creep", hours=1.0)
    place = planned.kinds.index("clock_delay")
    outside = {contender.kind for contender in look_closer(planned.scene, CATALOGUE).outsiders}
    assert {"thermal_lag", "thermal_gradient"} <= outside
    assert not outside & set(planned.kinds)
    assert np.isfinite(planned.told.beside).all()
    assert (planned.told.beside[place] < planned.told.apart[place, :, 1 - place]).all()


def test_an_effect_and_its_own_model_are_not_apart(planned):
    """A rival that is the truth itself, at a value on its grid, leaves nothing."""
    creep, other = planned.scene.contenders
    node = creep.forms[0].models[3]
    truth = replace(creep.truths[0], terms=node)
    scene = replace(
        planned.scene, contenders=(replace(other, truths=(truth,) * len(other.truths)), creep)
    )
    judge = Judge(scene, planned.limits, (), (0,))
    told = judge.judge(planned.best.space, planned.best.point)
    assert told.gain[0, 0] > 100.0
    assert told.apart[0, 0, 1] < 1e-6 * told.gain[0, 0]


def test_coefficients_are_those_of_the_octaves_over_their_noise(planned):
    judge = Judge(planned.scene, planned.limits, (), (0,))
    white = judge.stage(planned.programme.logs[:1], np.ones(1)).white
    x = np.random.default_rng(1).standard_normal((1, 150, 1))
    white = replace(white, octaves=cut_octaves(np.array([150]), 5))
    white = replace(white, keep=white.octaves.octave != MEANS)
    white = replace(white, scale=1.0 + np.arange(149.0)[None])
    expected = white.octaves.transform(x[0, :, 0])[white.keep] * white.scale[0]
    assert white.whiten(x, 0)[0, :, 0] == pytest.approx(expected, abs=1e-9)


@pytest.mark.long
def test_a_slow_zero_shift_is_a_rival_of_a_gradient_once_there_are_four_logs(monkeypatch):
    monkeypatch.setattr("zerodrift.discovery.plan.FEW", ())
    planned = plan("thermal_lag", "thermal_gradient", hours=4.0)
    (lag, gradient) = planned.scene.contenders
    assert [form.fewest_runs for form in lag.forms] == [0, 0, FEWEST_RUNS]
    assert [form.fewest_runs for form in gradient.forms] == [0]
    judge = Judge(planned.scene, planned.limits, (), (0,))
    logs = planned.programme.logs[:2]
    three, four = (judge.judge_logs(logs, np.array([2.0, n])) for n in (1.0, 2.0))
    assert (four.apart[1, :, 0] < 0.3 * three.apart[1, :, 0]).all()
    assert planned.told.runs >= FEWEST_RUNS
    # It is one in disguise: with the shortest time constant that there is, it does as well.
    assert (planned.told.apart[1, :, 0] < 0.01 * planned.told.gain[1]).all()
    assert (planned.told.disguised[1, :, 0] > 0.9).all()
    # So it is no look-alike, unless it does better by chance.
    distance = planned.told.apart[1, :, 0]
    told_apart = tell_rivals_apart(planned.told)[1, :, 0]
    assert told_apart == pytest.approx(ndtr(0.5 * np.sqrt(distance)), abs=0.02)
    assert (planned.told.disguised[0, :, 1] < 0.5).all()


def test_an_end_of_a_range_is_as_good_where_diagnose_says_so():
    """A loss of 10 units at least, 2 % of the gain, but no more than 1 % of what is left."""
    gain = np.array([100.0, 1e4, 1e4, 1e4, 1e4])
    samples = 5000.0
    lost = np.array([10.0, 10.0, 50.0, 90.0, 200.0])
    squares = np.stack([np.zeros(5), np.full(5, 1e5), lost])
    seen = expect_disguise(gain, squares, samples)
    assert seen[0] == pytest.approx(0.5)
    assert seen[1] > 0.99 and seen[2] == pytest.approx(0.5)
    assert seen[3] < 0.05 and seen[4] < 1e-3
    assert expect_disguise(gain, squares, 4.0 * samples)[4] == pytest.approx(0.5)
    # Without values there is no end, and no disguise.
    assert not expect_disguise(gain, squares[:1], samples).any()


def test_the_form_of_a_rival_is_the_one_that_diagnose_would_choose():
    gain = np.array([1000.0, 1000.0, 50.0])
    nearest = np.array([[100.0, 40.0, 12.0], [0.0, 38.0, 3.0], [0.0, 0.0, 0.0]])
    assert choose_forms(gain, nearest).tolist() == [1, 2, 1]


def test_what_is_sure_is_what_diagnose_asks_for():
    gain, nats = np.array([SURE_UNITS, 10.0, 10.0]), np.array([0.0, SURE_NATS, 10.0])
    assert rise(gain, nats) == pytest.approx([0.0, 0.0, np.log(10.0 / SURE_NATS)], abs=1e-6)


def test_a_closer_look_finds_rivals_nearer_than_the_grid_does(planned):
    def judge(scene):
        return Judge(scene, planned.limits, (), (0,))

    space, point = planned.best.space, planned.best.point
    closer = replace(look_closer(planned.scene, CATALOGUE), outsiders=())
    grid = judge(closer).judge(space, point)
    near = judge_closely(judge, closer, space, point)
    assert near.gain == pytest.approx(grid.gain)
    least, before = near.apart.min(axis=2), grid.apart.min(axis=2)
    # The form is chosen as `diagnose` does: a simpler one may leave a little more.
    slack = np.maximum(LIKE_BEST * near.gain, LIKE_BEST_UNITS)
    assert (least <= before + slack).all()
    assert (least < before).any()
    assert near.samples == pytest.approx(grid.samples)


def test_long_logs_reach_every_temperature(planned):
    space = planned.best.space
    wide = space.lengthen().list_patterns(list_designs(space)[1])
    reached = {s.temperature_degC for log in wide for s in log.settings}
    assert {planned.limits.low_degC, planned.limits.high_degC} <= reached


@pytest.mark.long
def test_an_effect_is_as_large_whatever_the_hours():
    """A short plan had taken for a target what it can move within its own time."""

    def list_sizes(hours):
        contenders = plan("thermal_lag", "creep", hours=hours, budget_s=0.1).scene.contenders
        return [truth.coefficients for c in contenders for truth in c.truths]

    for short, long in zip(list_sizes(0.5), list_sizes(8.0), strict=True):
        assert np.any(short != 0.0)
        assert short == pytest.approx(long)


LARGE = np.full((2, 4, 1), 100.0)
FAR = np.full((2, 4), np.inf)
NONE = np.zeros((2, 4))
PLAIN = np.zeros((2, 4, 2))


def test_probabilities_rise_with_what_is_told():
    gain = np.array([[50.0, 500.0, 5000.0, 5e5]] * 2)
    apart = np.full((2, 4, 2), np.inf)
    apart[0, :, 1] = apart[1, :, 0] = 0.5 * gain[0]
    clear = Told(gain, apart, 8, LARGE, FAR, NONE, PLAIN, 1e4)
    p = expect_verdicts(clear)
    assert (np.diff(p[0]) > 0.0).all() and p.min() > 0.0 and p.max() < 1.0
    close = apart.copy()
    close[0, :, 1] = 0.001 * gain[0]
    assert (expect_verdicts(replace(clear, apart=close))[0] < p[0]).all()
    # What lowers the error by 1 % is not named, however sure; nor what another effect does as well.
    faint = expect_verdicts(replace(clear, excess=np.full((2, 4, 1), 0.01)))
    assert (faint < 0.3 * p).all()
    mistaken = expect_verdicts(replace(clear, beside=np.zeros((2, 4))))
    assert mistaken == pytest.approx(0.5 * p)
    # A gain is sure by likelihood too, with few runs and with many.
    for runs in (3, 8):
        none = replace(clear, runs=runs)
        likely = expect_verdicts(replace(none, nats=np.full((2, 4), 100.0)))
        assert (likely[:, 0] > expect_verdicts(none)[:, 0]).all()
    pairs = expect_pairs(clear)
    assert pairs[0, 1] == pairs[1, 0]


def test_a_rival_in_disguise_is_no_lookalike_unless_by_chance():
    apart = np.array([0.0, 0.1, 0.9])
    distance = np.array([0.0, 0.0, 100.0])
    assert tell_disguised(apart, distance, np.zeros(3)) == pytest.approx(apart)
    assert tell_disguised(apart, distance, np.ones(3)) == pytest.approx([0.5, 0.5, 1.0], abs=1e-6)


@pytest.mark.long
def test_more_hours_tell_no_less():
    short, long = (plan("creep", "load_hysteresis", hours=h, target=0.00005) for h in (0.5, 4.0))
    assert expect_verdicts(long.told).mean() > expect_verdicts(short.told).mean()


@pytest.mark.long
def test_the_same_question_has_the_same_answer():
    """With a budget that the search does not use up: the first answers alone decide."""
    one, two = (plan("creep", "load_hysteresis", budget_s=1.0) for _ in range(2))
    assert one.scene.contenders[0].truths[1].terms == two.scene.contenders[0].truths[1].terms


@pytest.mark.parametrize(
    ("between", "told"),
    [
        (("creeep",), "creep"),
        (("zero_tempco", "dark_current"), "the model has dark_current already"),
        (("humidity",), "no input 'humidity'"),
        (("adc_saturation",), "seen directly"),
        (("ageing", "creep"), "shows over days"),
        (("creep", "creep"), "the same effect twice"),
    ],
)
def test_effects_that_cannot_be_planned_for_are_refused(between, told):
    with pytest.raises(InputError) as refused:
        plan(*between)
    assert told in str(refused.value)


def test_a_warm_up_without_power_on_is_refused():
    with pytest.raises(InputError, match="power is false"):
        plan("warm_up", "creep", experiment=EXPERIMENT.replace("cooling", "power = false\ncooling"))


def test_effects_that_no_programme_tells_apart_are_refused(planned):
    refuse_alike(planned)
    told = planned.told
    alike = replace(
        told, apart=np.where(np.isfinite(told.apart), 0.01 * told.gain[..., None], np.inf)
    )
    alike = replace(alike, disguised=np.zeros_like(told.disguised))
    with pytest.raises(NothingLeftError) as refused:
        refuse_alike(replace(planned, told=alike))
    said = str(refused.value)
    assert "--between creep load_hysteresis: no programme" in said
    assert "1 % of what the right one gains" in said and "Allow more" in said
