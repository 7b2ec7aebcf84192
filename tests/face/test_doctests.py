"""The examples in the public docstrings run, and every public name of the face has one.

They know `zd`, `frames` (three simulated runs: t in s, T in degC, fz_N in N), `folder` with a
project of them, `project` (that folder, opened) and `built` (one whose firmware lies there).
"""

import doctest
import inspect
import shutil
from collections.abc import Iterator
from functools import cached_property
from pathlib import Path

import pytest
from tests.face.test_project import make_frame

import zerodrift as zd
import zerodrift.operations.arithmetic
import zerodrift.operations.gru.layouts
from zerodrift import effects
from zerodrift.api.project import Project
from zerodrift.base.shown import Shown

FRAMES = {f"run{i}": make_frame(i, lag=30.0) for i in range(3)}
OPTIONS = doctest.ELLIPSIS | doctest.IGNORE_EXCEPTION_DETAIL
MODULES = (zd, effects, zerodrift.operations.arithmetic, zerodrift.operations.gru.layouts)
CLASSES = (Project, zd.Output, zd.ZerodriftError, Shown, effects.Effect, effects.Feature)
OBJECTS = (*MODULES, *CLASSES, effects.Parameter, effects.register)


def list_examples() -> Iterator[doctest.DocTest]:
    """Yield the docstrings that have examples, with the names of their own module."""
    finder = doctest.DocTestFinder(exclude_empty=True)
    for one in OBJECTS:
        home = inspect.getmodule(one)
        found = finder.find(one, module=home, globs=dict(vars(home)))
        for name, member in vars(one).items():
            if isinstance(member, cached_property):  # which the finder passes over
                found += finder.find(member.func, name, module=home, globs=dict(vars(home)))
        yield from (test for test in found if test.examples)


EXAMPLES = list(list_examples())


@pytest.fixture(scope="module")
def kept(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("doctests") / "project"
    columns = {"time": "t", "temperature": "T", "outputs": {"Fz": "fz_N"}}
    zd.Project.from_frames(FRAMES, network="none", path=folder, **columns)
    return folder


@pytest.fixture(scope="module")
def with_firmware(kept: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = Path(shutil.copytree(kept, tmp_path_factory.mktemp("built") / "project"))
    zd.Project(folder).add("thermal_lag").firmware()
    return folder


@pytest.mark.parametrize("example", EXAMPLES, ids=lambda test: test.name)
def test_the_example_runs(
    example: doctest.DocTest, kept: Path, tmp_path: Path, request: pytest.FixtureRequest
) -> None:
    code = "".join(one.source for one in example.examples)
    known: dict[str, object] = {"zd": zd, "frames": FRAMES}
    if "folder" in code or "project" in code:
        known["folder"] = Path(shutil.copytree(kept, tmp_path / "project"))
        known["project"] = zd.Project(tmp_path / "project")
    if "built" in code:
        known["built"] = zd.Project(request.getfixturevalue("with_firmware"))
    example.globs.update(known)
    runner = doctest.DocTestRunner(optionflags=OPTIONS)
    told: list[str] = []
    runner.run(example, out=told.append)
    assert runner.summarize(verbose=False).failed == 0, "".join(told)


def test_every_public_name_has_an_example() -> None:
    names = {test.name.rpartition(".")[2] for test in EXAMPLES}
    methods = [name for name in vars(Project) if not name.startswith("_") and name != "revision"]
    assert set(methods) <= names
    assert set(effects.__all__) <= names
    assert {"Project", "Output", "ZerodriftError", "plot"} <= names
