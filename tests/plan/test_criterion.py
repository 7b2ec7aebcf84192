"""What a programme is expected to tell, against worked answers."""

from dataclasses import replace

import numpy as np
import pytest

from tests.plan.projects import EXPERIMENT, read
from zerodrift.base.errors import InputError
from zerodrift.discovery.contenders import look_closer
from zerodrift.discovery.criterion import Judge, Told
from zerodrift.discovery.likely import expect_pairs, expect_verdicts
from zerodrift.discovery.plan import Question, plan_experiment
from zerodrift.discovery.programme import Log, Setting
from zerodrift.physics.catalogue import load_catalogue

CATALOGUE = load_catalogue()


def plan(*between, hours=2.0, budget_s=2.0, experiment=EXPERIMENT, target=0.001):
    question = Question(hours, between, target, budget_s)
    return plan_experiment(read(experiment), None, CATALOGUE, question)


@pytest.fixture(scope="module")
def planned():
    return plan("creep", "load_hysteresis")


def test_the_best_programme_is_no_worse_than_the_first_answer(planned):
    assert planned.best.tried > 20
    assert planned.first_cpu_s <= planned.cpu_s
    assert expect_verdicts(planned.told).mean() > 0.5


def test_a_programme_without_loads_tells_nothing_of_load_effects(planned):
    judge = Judge(planned.scene, planned.limits, (), (0,))
    still = Log(
        (Setting(0.0, 23.0, 0.0, {"Fz": 0.0}), Setting(60.0, 45.0, 2.0, {"Fz": 0.0})), 3000.0
    )
    told = judge.judge_logs([still], np.array([2.0]))
    assert told.gain.max() < 1e-6
    assert expect_verdicts(told).max() < 0.01


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
                forms=tuple(tuple((m[0], m[2]) for m in form) for form in contender.forms),
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
    twice = judge.judge_logs([half], np.array([2.0]))
    assert twice.excess[0, 0] == pytest.approx(told.excess[0, 0], rel=1e-9)
    assert twice.gain[0, 0] == pytest.approx(2.0 * told.gain[0, 0], rel=1e-9)


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
    node = creep.forms[0][3]
    truth = replace(creep.truths[0], terms=node)
    scene = replace(
        planned.scene,
        contenders=(replace(other, truths=(truth,) * len(other.truths)), creep),
    )
    judge = Judge(scene, planned.limits, (), (0,))
    told = judge.judge(planned.best.space, planned.best.point)
    assert told.gain[0, 0] > 100.0
    assert told.apart[0, 0, 1] < 1e-6 * told.gain[0, 0]


LARGE = np.full((2, 4, 1), 100.0)
FAR = np.full((2, 4), np.inf)


def test_probabilities_rise_with_what_is_told():
    gain = np.array([[50.0, 500.0, 5000.0, 5e5]] * 2)
    apart = np.full((2, 4, 2), np.inf)
    apart[0, :, 1] = apart[1, :, 0] = 0.5 * gain[0]
    p = expect_verdicts(Told(gain, apart, 8, LARGE, FAR))
    assert (np.diff(p[0]) > 0.0).all() and p.min() > 0.0 and p.max() < 1.0
    close = apart.copy()
    close[0, :, 1] = 0.001 * gain[0]
    assert (expect_verdicts(Told(gain, close, 8, LARGE, FAR))[0] < p[0]).all()
    # What lowers the error by 1 % is not named, however sure; nor what another effect does as well.
    faint = expect_verdicts(Told(gain, apart, 8, np.full((2, 4, 1), 0.01), FAR))
    assert (faint < 0.3 * p).all()
    mistaken = expect_verdicts(Told(gain, apart, 8, LARGE, np.zeros((2, 4))))
    assert mistaken == pytest.approx(0.5 * p)
    pairs = expect_pairs(Told(gain, apart, 8, LARGE, FAR))
    assert pairs[0, 1] == pairs[1, 0]
    assert (expect_verdicts(Told(gain, apart, 3, LARGE, FAR)) <= p).all()


def test_more_hours_tell_no_less():
    short, long = (plan("creep", "load_hysteresis", hours=h, target=0.0003) for h in (0.5, 4.0))
    assert expect_verdicts(long.told).mean() > expect_verdicts(short.told).mean()


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
    ],
)
def test_effects_that_cannot_be_planned_for_are_refused(between, told):
    with pytest.raises(InputError) as refused:
        plan(*between)
    assert told in str(refused.value)
