"""The Python face: eight lines from frames to checked C, and the same messages as from files."""

import json
import subprocess
import sys
from dataclasses import fields
from pathlib import Path

import numpy as np
import polars as pl
import pytest
from click.testing import CliRunner

import zerodrift as zd
from zerodrift.app.cli import cli
from zerodrift.app.frames import to_polars

N = 500


def make_frame(seed: int, lag: float = 0.0) -> pl.DataFrame:
    """A simulated run whose output follows the temperature, and, with a lag, its past."""
    rng = np.random.default_rng(seed)
    time_s = np.arange(float(N))
    temperature = 25 + 8 * np.sin(time_s / 60 + seed) + 4 * np.sign(np.sin(time_s / 90 + seed))
    felt = np.empty(N)
    felt[0] = temperature[0]
    for i in range(1, N):
        felt[i] = felt[i - 1] + (temperature[i] - felt[i - 1]) / max(lag, 1.0)
    fz = 0.5 * (felt - 25) + rng.normal(0, 0.02, N)
    return pl.DataFrame({"t": time_s, "T": temperature + rng.normal(0, 0.005, N), "fz_N": fz})


FRAMES = {f"run{i}": make_frame(i, lag=30.0) for i in range(5)}


@pytest.fixture(scope="module")
def project() -> zd.Project:
    return zd.Project.from_frames(
        FRAMES, time="t", temperature="T", outputs={"Fz": "fz_N"}, test=["run4"], network="none"
    )


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("face") / "kept"
    zd.Project.from_frames(
        FRAMES, time="t", temperature="T", outputs={"Fz": "fz_N"}, network="none", path=path
    )
    return path


def test_importing_loads_the_standard_library_alone() -> None:
    code = (
        "import sys; before = set(sys.modules); import zerodrift;"
        "new = {n.partition('.')[0] for n in set(sys.modules) - before};"
        "print(sorted(n for n in new if n not in sys.stdlib_module_names))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "['zerodrift']"


def test_from_frames_to_checked_c(tmp_path: Path) -> None:
    """The lines that the manual promises."""
    project = zd.Project.from_frames(
        FRAMES, time="t", temperature="T", outputs={"Fz": "fz_N"}, test=["run4"], network="none"
    )
    before = project.compare()
    verdict = project.diagnose()
    assert verdict.effect == "thermal_lag"
    project = project.add(verdict.effect)
    firmware = project.firmware()
    frame = project.apply(make_frame(9, lag=30.0))
    assert firmware.bit_exact and firmware.written
    assert project.compare().outputs["Fz"].rmse_heldout < 0.2 * before.outputs["Fz"].rmse_heldout
    assert float(frame["Fz_compensated"].std() or 1.0) < 0.1
    assert float((frame["Fz_compensated"].abs() < frame["Fz_uncertainty"]).mean() or 0.0) > 0.9


def test_a_result_is_what_the_command_prints(folder: Path) -> None:
    done = CliRunner().invoke(cli, ["compare", "-C", str(folder), "--json"])
    assert done.exit_code == 0, done.output
    told = json.loads(done.stdout)
    found = zd.Project(folder).compare()
    assert found.outputs["Fz"].rmse_heldout == told["outputs"]["Fz"]["rmse_heldout"]
    assert list(found.runs) == list(told["runs"])


def test_results_show_themselves(project: zd.Project) -> None:
    found = project.compare()
    assert "<h4>runs</h4><table>" in found._repr_html_() and "RunSummary" not in found._repr_html_()
    assert "<table>" in found._repr_html_() and "Fz" in found._repr_html_()
    assert len(found.plot("Fz").data) > 2
    values = {one.name: getattr(found, one.name) for one in fields(found)}
    with pytest.raises(TypeError, match="no data to draw"):
        type(found)(**values).plot()


def test_add_returns_the_new_project_and_leaves_the_old(folder: Path) -> None:
    old = zd.Project(folder)
    text = (folder / "zerodrift.toml").read_text()
    new = old.add("thermal_lag")
    assert new.effects == ("zero_tempco", "thermal_lag") and old.effects == ("zero_tempco",)
    assert new.revision is not None and new.revision.helps
    assert len(new.revision.plot().data) > 1
    assert old.compare().outputs["Fz"].rmse > new.compare().outputs["Fz"].rmse
    with pytest.raises(zd.InputError, match="has moved on"):
        old.add("creep")
    back = new.remove("thermal_lag")
    assert back.effects == ("zero_tempco",)
    assert (folder / "zerodrift.toml").read_text() == text
    assert [step.step for step in back.history().steps] == [
        "start",
        "+ thermal_lag",
        "- thermal_lag",
    ]


def test_what_does_not_help_is_not_added(project: zd.Project) -> None:
    with pytest.raises(zd.CheckError, match="was not added"):
        project.add("ageing")
    with pytest.raises(zd.InputError, match="no effect was named"):
        project.add(None)


def test_pandas_frames_come_and_go_as_pandas(project: zd.Project) -> None:
    pandas = pytest.importorskip("pandas")
    plain = pandas.DataFrame({c: make_frame(3)[c].to_numpy() for c in ("t", "T", "fz_N")})
    assert to_polars("x", plain).equals(make_frame(3))
    indexed = plain.assign(t=pandas.to_datetime(plain["t"], unit="s", utc=True)).set_index("t")
    assert to_polars("x", indexed)["t"].dtype.is_temporal()


def test_bad_frames_get_the_messages_of_files(tmp_path: Path) -> None:
    def open_frames(frame: object, **more: object) -> zd.Project:
        frames = {"a": frame, "b": make_frame(1)}
        return zd.Project.from_frames(
            frames, time="t", temperature="T", outputs={"Fz": "fz_N"}, **more
        )

    with pytest.raises(zd.InputError, match="there is no column 'T'"):
        open_frames(make_frame(0).drop("T"))
    with pytest.raises(zd.InputError, match="expected a data frame"):
        open_frames([1, 2])
    with pytest.raises(zd.InputError, match="test names 'c'"):
        open_frames(make_frame(0), test=["c"])
    with pytest.raises(TypeError):
        open_frames(make_frame(0), tests=["b"])
    holes = make_frame(0).with_columns(pl.when(pl.col("t") != 7).then(pl.col("T")).alias("T"))
    with pytest.raises(zd.InputError, match=r"a\.parquet.*column 'T'"):
        open_frames(holes).compare()
    twice = pl.concat([make_frame(0).head(20), make_frame(0).head(5)])
    with pytest.raises(zd.InputError, match="expected rising times"):
        open_frames(twice).compare()
    (tmp_path / "zerodrift.toml").write_text("")
    with pytest.raises(zd.InputError, match="exists already"):
        open_frames(make_frame(0), path=tmp_path)


def test_a_users_effect_needs_one_import() -> None:
    assert {"Effect", "Feature", "Parameter", "register"} <= set(dir(zd.effects))
    with pytest.raises(AttributeError):
        zd.nothing  # noqa: B018
