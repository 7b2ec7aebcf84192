"""A firmware folder with everything beside it, made of a golden model without any training."""

import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
from tests.golden.vectors import load
from tests.projects import render_toml

from zerodrift.base.config import load_config
from zerodrift.codegen.generate import generate
from zerodrift.export.golden import compute_golden
from zerodrift.export.integer_model import IntegerModel
from zerodrift.verify import folder_check, ways
from zerodrift.verify.certificate import certify
from zerodrift.verify.firmware import write_artefacts
from zerodrift.verify.vectors import draw_golden, draw_sequences

MODEL = "front_end"
"""Two inputs, a lag, a delay and a GRU whose kernels exist in every layout."""


class Agreed:
    """The consent of a user who knows the C."""

    despite_changes = True

    def require(self, texts: object) -> None:
        """Agree."""


def write_firmware(
    directory: Path, model: IntegerModel | None = None, forced: tuple[str, ...] = ()
) -> Path:
    """Write a project whose firmware is a model's, by default `MODEL`; return its directory."""
    directory.mkdir(parents=True, exist_ok=True)
    logs = '[logs]\ntrain = ["logs/train_*.csv"]\ntest = ["logs/test.csv"]\n'
    (directory / "zerodrift.toml").write_text(
        render_toml(logs + '\n[firmware]\nout = "firmware"\n')
    )
    (directory / "logs").mkdir()
    for log in ("train_1", "train_2", "test"):
        (directory / "logs" / f"{log}.csv").write_text(f"time_s\n{len(log)}\n")
    model = model or load(MODEL).model
    code = generate(model)
    golden = compute_golden(model, draw_golden(model, draw_sequences(model, 500)["walk"]))
    certificate = certify(model, code)
    write_artefacts(load_config(directory), model, code, certificate, golden, forced=forced)
    return directory


@pytest.fixture(scope="session")
def pristine(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The project as it was written; not to be changed."""
    return write_firmware(tmp_path_factory.mktemp("verify") / "project")


@pytest.fixture
def project(pristine: Path, tmp_path: Path) -> Path:
    """A copy of the project that a test may spoil."""
    return Path(shutil.copytree(pristine, tmp_path / "project"))


@pytest.fixture
def few_ways(monkeypatch: pytest.MonkeyPatch) -> Callable[..., None]:
    """Leave out the other layouts and the cores but those named: the test is about one of them."""

    def keep(*names: str) -> None:
        for function in ("list_host_ways", "list_core_ways"):
            original = getattr(ways, function)
            kept = lambda model, f=original: tuple(w for w in f(model) if w.name in names)  # noqa: E731
            monkeypatch.setattr(folder_check, function, kept)

    keep()
    monkeypatch.setattr("zerodrift.verify.replay.RANDOM_STEPS", 1000)
    return keep
