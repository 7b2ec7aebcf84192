"""`verify --prove` from the command line: words, JSON and exit codes."""

import json
from pathlib import Path

import pytest
from click.testing import CliRunner

from tests.golden.vectors import load
from zerodrift.app.cli import cli
from zerodrift.c_runtime.compilers import RUNTIME_FILES
from zerodrift.codegen.generate import generate

CONFIG = """\
[sensor]
name = "front_end"
time = "t"
temperature = "T"
sample_period_s = 0.5

[outputs.Fx]
measured = "Fx"
unit = "N"
full_scale = 1000

[logs]
train = ["*.csv"]
"""


@pytest.fixture
def project(tmp_path: Path) -> Path:
    model = load("effects").model
    code = generate(model)
    (tmp_path / "zerodrift.toml").write_text(CONFIG)
    (tmp_path / "build").mkdir()
    (tmp_path / "firmware").mkdir()
    model.save(tmp_path / "build" / "model.json")
    (tmp_path / "firmware" / code.header_name).write_text(code.header)
    (tmp_path / "firmware" / code.source_name).write_text(code.source)
    for path in RUNTIME_FILES:
        (tmp_path / "firmware" / path.name).write_text(path.read_text())
    return tmp_path


def test_words_json_and_exit_codes(project: Path) -> None:
    found = CliRunner().invoke(cli, ["verify", "-C", str(project), "--prove"])
    assert found.exit_code == 0, found.output
    assert "TESTED, NOT PROVEN: kernels of recurrent layers" in found.output
    assert "proven: " in found.output
    model = load("effects").model
    source = project / "firmware" / generate(model).source_name
    text = source.read_text()
    assert "s->steps++" in text
    source.write_text(text.replace("s->steps++", "s->steps += 2u"))
    found = CliRunner().invoke(cli, ["verify", "-C", str(project), "--prove", "--json"])
    assert found.exit_code == 1
    told = json.loads(found.stdout)
    assert not told["proven"]
    assert {"step"} <= {p["what"] for p in told["parts"] if p["verdict"] == "not proven"}
