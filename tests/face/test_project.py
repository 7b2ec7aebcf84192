"""The Python face: eight lines from frames to checked C, and the same messages as from files."""

import json
import shutil
import subprocess
import sys
from dataclasses import fields
from pathlib import Path

import numpy as np
import pandas
import polars as pl
import pytest
from click.testing import CliRunner

import zerodrift as zd
from zerodrift.api.frames import to_polars
from zerodrift.cli.main import cli
from zerodrift.verify.summary import FirmwareSummary

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


@pytest.mark.long
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


@pytest.mark.long
def test_the_manuals_eight_lines_go_from_frames_to_checked_c() -> None:
    """The page's own lines are run."""
    page = (Path(__file__).parents[2] / "docs/how-to/python.md").read_text(encoding="utf-8")
    lines = page.split("```python\n")[1].split("```")[0].strip().splitlines()
    assert len([line for line in lines if line.strip()]) == 8
    names: dict[str, object] = {f"frame{i}": make_frame(i, lag=30.0) for i in range(1, 5)}
    exec("\n".join(lines), names)
    firmware, compensated = names["firmware"], names["compensated"]
    assert isinstance(firmware, FirmwareSummary) and firmware.bit_exact and firmware.written
    assert isinstance(compensated, pl.DataFrame)
    assert "Fz_uncertainty" in compensated.columns


def test_a_result_is_what_the_command_prints(folder: Path) -> None:
    done = CliRunner().invoke(cli, ["compare", "-C", str(folder), "--json"])
    assert done.exit_code == 0, done.output
    told = json.loads(done.stdout)
    found = zd.Project(folder).compare()
    assert found.outputs["Fz"].rmse_heldout == told["outputs"]["Fz"]["rmse_heldout"]
    assert list(found.runs) == list(told["runs"])


def test_results_show_themselves(project: zd.Project) -> None:
    found = project.compare()
    shown, picture = found._repr_html_(), found.plot("Fz")
    assert "<h4>runs</h4><table>" in shown and "RunSummary" not in shown and "Fz" in shown
    assert picture._repr_html_().startswith("<svg")
    (drift, model), (left,) = (panel.curves for panel in picture.panels)
    assert model.name == "model" and np.nanmax(np.abs(left.y)) < np.nanmax(np.abs(drift.y))
    values = {one.name: getattr(found, one.name) for one in fields(found)}
    with pytest.raises(TypeError, match="no data to draw"):
        type(found)(**values).plot()


def test_add_returns_the_new_project_and_leaves_the_old(folder: Path) -> None:
    old = zd.Project(folder)
    text = (folder / "zerodrift.toml").read_text()
    new = old.add("thermal_lag")
    assert new.effects == ("zero_tempco", "thermal_lag") and old.effects == ("zero_tempco",)
    assert new.revision is not None and new.revision.helps
    assert [c.name for c in new.revision.plot().panels[0].clouds] == ["before", "after"]
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
    plain = to_pandas(make_frame(3))
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


def to_pandas(frame: pl.DataFrame) -> "pandas.DataFrame":
    return pandas.DataFrame({c: frame[c].to_numpy() for c in frame.columns})


def open_pandas(first: "pandas.DataFrame", index: str | None = None) -> zd.Project:
    """Return a project of three runs of pandas, the first one as given."""
    others = [to_pandas(make_frame(i)) for i in (1, 2)]
    frames = [first, *(f.set_index(index) for f in others)] if index else [first, *others]
    return zd.Project.from_frames(
        dict(zip("abc", frames, strict=True)),
        time="t",
        temperature="T",
        outputs={"Fz": "fz_N"},
        network="none",
    )


def refuse(first: "pandas.DataFrame", message: str, index: str | None = None) -> None:
    with pytest.raises(zd.InputError, match=message):
        open_pandas(first, index).compare()


def test_times_with_zones_are_the_same_instants() -> None:
    """The hour that daylight saving repeats too, in pandas and in Polars."""
    instants = pandas.date_range("2024-10-27T00:55", periods=N, freq="s", tz="UTC")
    rmse = set()
    for zone in ("UTC", "Europe/Berlin", "Asia/Kolkata"):
        plain = to_pandas(make_frame(0)).assign(t=instants.tz_convert(zone))
        times = pl.Series("t", instants.tz_localize(None).to_numpy())
        zoned = times.dt.replace_time_zone("UTC").dt.convert_time_zone(zone)
        for frame in (plain, plain.set_index("t"), make_frame(0).with_columns(zoned)):
            frames = {"a": frame, "b": make_frame(1), "c": make_frame(2)}
            opened = zd.Project.from_frames(
                frames, time="t", temperature="T", outputs={"Fz": "fz_N"}, network="none"
            )
            rmse.add(opened.compare().outputs["Fz"].rmse)
    assert len(rmse) == 1


def test_a_duplicated_index_is_told_by_its_times() -> None:
    plain = to_pandas(make_frame(0))
    plain.index = [0] * N  # a mere count may be anything
    assert open_pandas(plain).compare().outputs["Fz"].rmse > 0.0
    plain.loc[:, "t"] = [*range(10), 9, *range(11, N)]
    refuse(plain.set_index("t"), r"a\.parquet: row 11: t repeats 9 s; expected rising times", "t")
    levels = to_pandas(make_frame(0)).set_index(["t", "T"])
    assert open_pandas(levels).compare().outputs["Fz"].rmse > 0.0


@pytest.mark.parametrize("column", ["t", "T", "fz_N"])
@pytest.mark.parametrize("value", [np.nan, np.inf, "abc"])
def test_no_numbers_get_the_messages_of_files(column: str, value: float | str) -> None:
    plain = to_pandas(make_frame(0)).astype({column: object})
    plain.loc[5, column] = value
    expected = {"abc": "expected numbers|is no time|'abc'", "inf": "is inf", "nan": "is empty"}
    refuse(plain, rf"a\.parquet.*({expected[str(value)]})")


def test_frames_that_cannot_be_are_refused() -> None:
    plain = to_pandas(make_frame(0))
    refuse(pandas.concat([plain, plain[["T"]]], axis=1), "two columns are called 'T'")
    refuse(plain.rename(columns={"fz_N": "force"}), "there is no column 'fz_N'; it has t, T, force")
    refuse(plain.assign(fz_N="x"), "'fz_N' holds String; expected numbers")
    refuse(plain.assign(fz_N=np.nan), "column 'fz_N' is NaN")
    refuse(plain.head(1), r"a\.parquet: too few rows: 1")


@pytest.mark.long
def test_what_apply_cannot_take_is_told_of_the_frame(folder: Path, tmp_path: Path) -> None:
    with pytest.raises(zd.InputError, match="there is no integer model"):
        zd.Project(folder).apply(make_frame(0))
    kept = Path(shutil.copytree(folder, tmp_path / "kept"))
    opened = zd.Project(kept).add("thermal_lag")
    opened.firmware()
    plain = to_pandas(make_frame(0))
    for frame in (make_frame(0).drop("T"), plain.drop(columns="T")):
        with pytest.raises(zd.InputError, match=r"^the frame: there is no column 'T'"):
            opened.apply(frame)
    with pytest.raises(zd.InputError, match=r"^the frame: row 6: t repeats 4 s"):
        opened.apply(plain.assign(t=[*range(5), 4, *range(6, N)]))
    with pytest.raises(zd.InputError, match="has a column 'Fz_drift' already"):
        opened.apply(opened.apply(plain))
    plain.loc[5:8, "T"] = np.nan
    plain.index = [0] * N
    applied = opened.apply(plain)
    assert applied["flags"].tolist()[4:10] == [0, 64, 64, 64, 64, 0]
    assert applied["Fz_uncertainty"].isna().sum() == 4
    model = kept / "build/model.json"
    model.write_text(model.read_text().replace('"format":3', '"format":99'))
    with pytest.raises(zd.InputError, match="a model of format 99; expected format 2 or 3"):
        opened.apply(make_frame(0))


def test_a_users_effect_needs_one_import() -> None:
    assert {"Effect", "Feature", "Parameter", "register"} <= set(dir(zd.effects))
    with pytest.raises(AttributeError):
        zd.nothing  # noqa: B018
