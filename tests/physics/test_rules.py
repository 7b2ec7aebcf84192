"""The rules by which an effect is named, on figures that are given."""

from types import SimpleNamespace

import numpy as np
import pytest

from zerodrift.diagnosis.evidence import SURE_NATS
from zerodrift.diagnosis.rules import SURE_UNITS, helps


def judge(**wanted):
    """Return an effect that gains in seven of seven runs and lowers the error by 10 %."""
    gains = np.full(7, wanted.pop("gain", 40.0) / 7.0)
    figures = {
        "rmse_ratio": 0.9,
        "best_output_ratio": 0.9,
        "gains": gains,
        "gain": gains.sum(),
        "p_value": 2.0**-7,
        "nats": SURE_NATS,
        "follows_signal": True,
        "share": 0.3,
        "positive_share": 1.0,
    }
    return SimpleNamespace(**figures | wanted)


def look(runs: int = 7):
    """Return an examination of a model that is not at the floor."""
    return SimpleNamespace(runs=runs, fitted_ratio=1.5, floor=np.ones(6), noise=None)


@pytest.mark.parametrize("runs", [3, 7])
def test_an_effect_must_gain_more_than_slow_noise_explains(runs) -> None:
    assert helps(judge(), look(runs))
    assert not helps(judge(nats=SURE_NATS - 1.0), look(runs))
    assert helps(judge(nats=1.0, gain=1.01 * SURE_UNITS), look(runs))
    assert not helps(judge(nats=-1.0, gain=1.01 * SURE_UNITS), look(runs))


def test_likelihood_alone_is_no_evidence_for_what_follows_the_time_alone() -> None:
    assert not helps(judge(follows_signal=False, nats=10.0 * SURE_NATS), look())
    assert helps(judge(follows_signal=False, gain=1.01 * SURE_UNITS), look())


def test_of_few_runs_none_may_lose() -> None:
    assert helps(judge(positive_share=0.8), look(7))
    assert not helps(judge(positive_share=0.8), look(3))


def test_beside_an_effect_that_is_sure_less_is_enough() -> None:
    assert helps(judge(nats=1.0), look(), beside=True)
