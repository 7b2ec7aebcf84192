"""The benchmark of the proof: what it counts, and that it tells a miss."""

import pytest
from benchmarks import bench_proof

from zerodrift_proof.equality.build import PROVEN, ShownPart

pytestmark = pytest.mark.long


def test_random_models_are_proven(capsys: pytest.CaptureFixture[str]) -> None:
    assert bench_proof.prove_models(2, seed=77)
    assert "random models proven: 2 of 2" in capsys.readouterr().out


def test_a_proof_of_everything_is_found_out(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """With a prover that shows anything, the oracle finds a fault that was proven."""
    shown = (ShownPart("the C", "", PROVEN),)
    monkeypatch.setattr(bench_proof, "list_shown", lambda model, texts: iter(shown))
    assert not bench_proof.plant(4, seed=3, only=["effects"])
    assert "MISSED effects" in capsys.readouterr().out
