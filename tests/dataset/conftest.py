"""A small project with one good log, which each test spoils in its own way."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.projects import FORCE, render_toml

from zerodrift.base.config import Config, load_config
from zerodrift.base.errors import InputError
from zerodrift.dataset.load import load_dataset
from zerodrift.dataset.runs import Dataset

TOML = render_toml(
    """\
[logs]
train = ["log.csv"]
""",
    outputs=(FORCE,),
)
COLUMNS = ("time_s", "temperature_degC", "Fz_N", "ref_Fz_N")
SHARED_DATA = Path(__file__).resolve().parents[3] / "shared" / "data"

Rows = list[list[str]]


def make_rows(count: int = 40, period_s: float = 1.0, start_s: float = 0.0) -> Rows:
    """Return rows of text: time, a rising temperature, a drifting force, its reference."""
    return [
        [repr(start_s + k * period_s), repr(20 + 0.25 * k), repr(3.5 * k - 7), repr(0.5 * k)]
        for k in range(count)
    ]


class Project:
    """A project directory with zerodrift.toml and logs, and what comes of reading it."""

    def __init__(self, directory: Path) -> None:
        self.directory = directory
        self.write_toml(TOML)

    def write_toml(self, text: str) -> None:
        (self.directory / "zerodrift.toml").write_text(text)

    def write_log(
        self, rows: Sequence[Sequence[str]], name: str = "log.csv", header: Sequence[str] = COLUMNS
    ) -> Path:
        path = self.directory / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("\n".join(",".join(row) for row in [list(header), *rows]) + "\n")
        return path

    def config(self, **changes: object) -> Config:
        return replace(load_config(self.directory), **changes)

    def load(self, skip_invalid: bool = False, **changes: object) -> Dataset:
        return load_dataset(self.config(**changes), skip_invalid)

    def refusal(self, skip_invalid: bool = False, **changes: object) -> str:
        """Return the message of the refusal, insisting that nothing was written."""
        before = self._list_files()
        with pytest.raises(InputError) as caught:
            self.load(skip_invalid, **changes)
        assert self._list_files() == before
        return str(caught.value)

    def _list_files(self) -> Mapping[str, bytes]:
        return {
            str(path): path.read_bytes() for path in self.directory.rglob("*") if path.is_file()
        }


@pytest.fixture
def project(tmp_path: Path) -> Project:
    made = Project(tmp_path)
    made.write_log(make_rows())
    return made


@pytest.fixture
def rows() -> Callable[..., Rows]:
    return make_rows


@pytest.fixture
def real_log() -> Callable[[str], Path]:
    """Return the path of a measured log, or skip by its name when it is not there."""

    def find(name: str) -> Path:
        path = SHARED_DATA / name
        if not path.is_file():
            pytest.skip(f"no {name} in {SHARED_DATA}")
        return path

    return find


@pytest.fixture
def column() -> Callable[..., np.ndarray]:
    """Return column `index` of text rows as numbers."""
    return lambda text_rows, index: np.array([float(row[index]) for row in text_rows])
