"""The page's plug-in is installed as a package would be, and each of its parts is found."""

import importlib.util
import re
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from tests.golden.model_factory import Shape, draw_model
from tests.report.conftest import make_findings, make_trace
from zerodrift.base import plugins
from zerodrift.c_runtime.cores import find_cross_compilers, list_cores, list_emulated
from zerodrift.cli import main
from zerodrift.codegen.generate import generate
from zerodrift.dataset.formats import registry
from zerodrift.dataset.selectors import list_suffixes
from zerodrift.export.importers import import_onnx
from zerodrift.export.reference import Reference
from zerodrift.physics import catalogue
from zerodrift.report.findings import Provenance
from zerodrift.report.report import render_report

PAGE = Path(__file__).parents[2] / "docs/how-to/write-a-plugin.md"
BLOCK = re.compile(r"^```(\w+)\n(.*?)^```$", re.M | re.S)
HELLO = """
import click
hello = click.Command("my-rig", callback=lambda: click.echo("hello, rig"))
"""


def forget() -> None:
    for cached in (plugins.load_parts, registry.list_formats, main.list_commands):
        cached.cache_clear()


@pytest.fixture
def install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[object]:
    """Give a function that installs a package: its text, and its entry points by group."""
    monkeypatch.syspath_prepend(tmp_path)
    names = []

    def put(name: str, text: str, points: dict[str, dict[str, str]]) -> None:
        (tmp_path / f"{name}.py").write_text(text, encoding="utf-8")
        told = tmp_path / f"{name}-1.0.dist-info"
        told.mkdir()
        (told / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n")
        (told / "entry_points.txt").write_text(
            "".join(
                f"[{group}]\n" + "".join(f"{k} = {v}\n" for k, v in found.items())
                for group, found in points.items()
            )
        )
        importlib.invalidate_caches()
        names.append(name)
        forget()

    yield put
    for name in names:
        sys.modules.pop(name, None)
    forget()


@pytest.fixture
def rig(install) -> None:
    texts = dict(BLOCK.findall(PAGE.read_text(encoding="utf-8")))
    points = tomllib.loads(texts["toml"])["project"]["entry-points"]
    install("my_rig", texts["python"] + HELLO, points)


def test_a_format_s_files_are_logs(rig, tmp_path):
    log = tmp_path / "a.rig"
    log.write_text("time_s|T_degC|F_N\n0|20|1\n1|21|1.5\n", encoding="utf-8")
    assert ".rig" in list_suffixes()
    known = registry.find_format(log)
    (table,) = registry.read_tables(log, "a.rig", known)
    assert table.frame["F_N"].to_list() == [1.0, 1.5]


def test_an_importer_s_file_becomes_onnx(rig, tmp_path):
    (tmp_path / "a.net").write_bytes(b"8 bytes." + b"onnx")
    assert import_onnx(tmp_path / "a.net") == b"onnx"
    assert import_onnx(tmp_path / "a.onnx") is None


def test_a_core_is_known_and_emulated(rig):
    assert list_cores()["my-chip"].emulated_as == "cortex-m4"
    assert "my-chip" in list_emulated()
    assert list_cores()["cortex-m4"].gcc


def test_the_c_runs_on_it_bit_for_bit(rig, tmp_path):
    if importlib.util.find_spec("unicorn") is None or not find_cross_compilers("my-chip"):
        pytest.skip("unicorn or ziglang is not installed")
    from zerodrift.c_runtime.emulator import EmulatedModel

    model = draw_model(Shape(hidden=2, inputs=1, outputs=1), 3)
    codes = np.full((40, len(model.channels)), 100, dtype=np.int32)
    expected = Reference(model).run(codes[None])
    drift, flags = EmulatedModel(model, generate(model), "my-chip", tmp_path).run(
        codes, settled=True
    )
    np.testing.assert_array_equal(drift, expected.drift[0])
    np.testing.assert_array_equal(flags, expected.flags[0])


def test_a_command_is_listed_and_runs(rig):
    assert "Says hello to the rig." in CliRunner().invoke(main.cli, ["--help"]).output
    assert CliRunner().invoke(main.cli, ["my-rig"]).output == "hello, rig\n"


def test_a_part_is_in_the_report_and_its_table_in_the_annex(rig):
    still = np.zeros(40)
    trace = make_trace(still, still, temperature=still + 25.0, load=still)
    page = render_report(
        make_findings(traces=(trace,), provenance=Provenance((), {"zerodrift": "0.1.0"}, ""))
    )
    assert "<h2>Rig</h2>" in page
    assert "rig.csv" in page.lower()


def test_what_cannot_be_loaded_is_missing_alone(rig, install, capsys):
    install(
        "broken",
        "raise RuntimeError('no licence')",
        {
            f"zerodrift.{part}": {"x": "broken:X"}
            for part in ("formats", "cores", "commands", "report")
        },
    )
    install("wrong", "X = 3", {"zerodrift.formats": {"y": "wrong:X"}})
    assert ".rig" in list_suffixes() and ".csv" in list_suffixes()
    assert "my-chip" in list_cores()
    assert {"my-rig", "compare"} <= main.list_commands().keys()
    told = capsys.readouterr().err
    assert told.count("'x' of broken") == 3 and "no licence" in told
    assert told.count("'y' of wrong") == 1 and "int, expected Format" in told
    list_suffixes()
    assert not capsys.readouterr().err


def test_an_effect_that_cannot_be_loaded_is_missing_alone(install, capsys, monkeypatch):
    monkeypatch.setattr(catalogue, "_left_out", set())
    install("torn", "import nothing_there", {"zerodrift.effects": {"z": "torn"}})
    assert "thermal_lag" in catalogue.load_catalogue().effects
    assert "'z' of torn" in capsys.readouterr().err
    catalogue.load_catalogue()
    assert not capsys.readouterr().err
