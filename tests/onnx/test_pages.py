"""The Python in the pages about ONNX runs as it stands there."""

import json
import re
import subprocess
from pathlib import Path

import numpy as np
import pytest
import torch
from click.testing import CliRunner
from tests.golden.model_factory import Shape, draw_model

from zerodrift.c_runtime.compilers import find_compiler
from zerodrift.cli.main import cli
from zerodrift.export.integer_onnx import save_integer_onnx
from zerodrift.export.onnx_reader import read_imported
from zerodrift.export.reference import Reference

DOCS = Path(__file__).parents[2] / "docs"


def run_page(name: str) -> dict[str, object]:
    """Run every Python block of a page, one after the other; return its variables."""
    blocks = re.findall(r"```python\n(.*?)```", (DOCS / name).read_text("utf-8"), re.DOTALL)
    assert blocks
    variables: dict[str, object] = {"__name__": "page"}
    for block in blocks:
        exec(compile(block, name, "exec"), variables)
    return variables


@pytest.mark.filterwarnings("ignore")
def test_exported_network_of_the_page_is_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    run_page("how-to/any-gru.md")
    imported = read_imported(tmp_path / "net.onnx")
    assert imported.initial_state == "input" and imported.window == 0
    assert imported.network.head.shape == (2, 16)


def test_page_on_the_integer_onnx_computes_the_chips_numbers(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "build").mkdir()
    model = draw_model(Shape(inputs=1, outputs=2, front_end=("lowpass",)), 5)
    save_integer_onnx(model, tmp_path / "build" / "integer.onnx")
    page = run_page("reference/integer-onnx.md")
    answer, codes = page["answer"], page["codes"]
    trace = Reference(model).run(np.swapaxes(codes, 0, 1))
    np.testing.assert_array_equal(answer["drift"][:, 0], trace.drift[0])
    again = page["session"].run(["drift", "flags"], page["feed"])
    longer = Reference(model).run(np.swapaxes(np.concatenate([codes, codes]), 0, 1))
    np.testing.assert_array_equal(again[0][:, 0], longer.drift[0, len(codes) :])
    np.testing.assert_array_equal(again[1][:, 0], longer.flags[0, len(codes) :])
    assert str(trace.drift[0, -1]) in capsys.readouterr().out


@pytest.mark.long
@pytest.mark.filterwarnings("ignore")
def test_the_page_on_five_minutes_runs_from_the_network_to_the_c(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    name = "how-to/network-in-five-minutes.md"
    page = (DOCS / name).read_text("utf-8")
    variables = run_page(name)
    (toml,) = re.findall(r"```toml\n(.*?)```", page, re.DOTALL)
    (tmp_path / "zerodrift.toml").write_text(toml)
    (command,) = re.findall(r"```sh\nzerodrift (.*)\n```", page)
    told = CliRunner().invoke(cli, [*command.split(), "--json"])
    assert told.exit_code == 0, told.output
    found = json.loads(told.stdout)
    assert found["bit_exact"] and found["written"]
    spread = float(np.std(variables["y"]))
    assert found["rmse_integer_to_float"]["y"] < 0.005 * spread
    (text,) = re.findall(r"```c\n(.*?)```", page, re.DOTALL)
    (tmp_path / "main.c").write_text(text)
    sources = [
        str(tmp_path / file) for file in ("main.c", "firmware/net.c", "firmware/zd_runtime.c")
    ]
    program = tmp_path / "main"
    find_compiler().run(["-std=c99", f"-I{tmp_path / 'firmware'}", *sources, "-o", str(program)])
    lines = subprocess.run([program], capture_output=True, text=True, check=True).stdout.split("\n")
    network, at_rest = variables["network"], torch.zeros(1, 1, 16)
    x = torch.tensor([[[0.05, -0.02]] * 400])
    with torch.no_grad():
        wanted = float(network(x, at_rest, at_rest)[0][0, -1, 0])
    assert [line.split()[-1] for line in lines[:5]] == ["0"] * 5
    assert abs(float(lines[4].split()[0]) - wanted) < 0.01 * spread
