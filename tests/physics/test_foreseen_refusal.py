"""What `diagnose` names is judged as `add` judges it: on the logs as read, form by form."""

from types import SimpleNamespace

import numpy as np
import pytest
from tests.physics.conftest import linear, make_dataset

from zerodrift.base.config import EffectConfig
from zerodrift.diagnosis import diagnose as diagnosing
from zerodrift.diagnosis import judgement, revision
from zerodrift.diagnosis.case import open_case
from zerodrift.diagnosis.diagnose import foresee_refusal, weigh_again
from zerodrift.physics.catalogue import load_catalogue


@pytest.mark.parametrize(
    ("passing", "chosen"),
    [
        ({("old", "a"), ("a", "b"), ("old", "b")}, 1),
        ({("old", "a"), ("a", "b")}, 0),  # what the simple form earns, the richer one forfeits
        ({("old", "a"), ("old", "b")}, 0),
        ({("a", "b"), ("old", "b")}, 1),
        ({("a", "b")}, 1),
        ({("old", "a"), ("a", "c"), ("old", "c")}, 2),
        (set(), 0),
    ],
)
def test_a_richer_form_does_not_forfeit_what_a_simpler_one_earns(passing, chosen, monkeypatch):
    monkeypatch.setattr(
        revision, "judge", lambda before, after, units: ((before, after) in passing, "")
    )
    assert revision.choose_form("old", ("a", "b", "c"), ()) == chosen


def test_an_output_that_never_moves_waters_nothing_down():
    def leave(of_first: float) -> SimpleNamespace:
        return SimpleNamespace(squares=np.array([[of_first, 0.0, 0.0]] * 4))

    change = judgement._measure_change(leave(1.0), leave(0.96))
    assert change.overall == pytest.approx(np.sqrt(0.96))
    assert change.ratio.tolist() == pytest.approx([np.sqrt(0.96), 1.0, 1.0])


@pytest.mark.parametrize(
    ("after", "nats", "helps"),
    [
        ([0.9, 0.9], 30.0, True),  # more than slow noise explains, as in the stretches of one run
        ([0.9, 0.9], 5.0, False),  # a fall of 5 % that may be chance
        ([0.6, 0.6], 5.0, True),
        ([0.5, 1.3], 30.0, False),  # one of both gets worse
    ],
)
def test_two_runs_are_no_weaker_evidence_than_one(after, nats, helps, monkeypatch):
    def leave(squares: list[float]) -> SimpleNamespace:
        return SimpleNamespace(
            squares=np.array(squares)[:, None],
            model=SimpleNamespace(outputs=("Fz",)),
            judged_steady_rmse=np.sqrt([np.mean(squares)]),
            is_one_run=False,
        )

    monkeypatch.setattr(judgement, "measure_nats", lambda before, after: nats)
    found, reason = judgement.judge(leave([1.0, 1.0]), leave(after), ("N",))
    assert found is helps
    assert ("may be chance" in reason) is (not helps and nats < judgement.SURE_NATS)


def test_the_logs_are_judged_as_they_were_read(monkeypatch):
    """Also where outliers were looked for once more, and where an output stands still."""
    rng = np.random.default_rng(4)
    dataset = make_dataset(linear)
    for run in dataset.train:
        run.measured[rng.uniform(size=len(run)) < 0.01] += [30.0, 0.3]
    case = open_case(dataset, load_catalogue(), [EffectConfig("zero_tempco")])
    again = weigh_again(case, case.terms) or case
    seen = []
    monkeypatch.setattr(
        diagnosing,
        "try_extension",
        lambda effects, extended, logs, catalogue: seen.append(logs) or (False, "no"),
    )
    judged = SimpleNamespace(kind="adc_saturation", parameters={})
    assert "not enough for `add`: no" in foresee_refusal(again, SimpleNamespace(judged=judged))
    assert seen == [dataset]
