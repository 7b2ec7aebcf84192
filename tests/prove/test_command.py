"""`verify --prove` from the command line: words, JSON and exit codes."""

import json
import sys
from pathlib import Path

import pytest
from click.testing import CliRunner

from tests.golden.vectors import load
from zerodrift.base.errors import InputError
from zerodrift.c_runtime.compilers import RUNTIME_FILES
from zerodrift.cli.main import cli
from zerodrift.codegen.generate import generate
from zerodrift.tasks.verify import build_program
from zerodrift_proof.object.program import BUILDS

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


@pytest.mark.long
def test_words_json_and_exit_codes(project: Path) -> None:
    found = CliRunner().invoke(cli, ["verify", "-C", str(project), "--prove"])
    assert found.exit_code == 0, found.output
    assert "TESTED, NOT PROVEN: kernels of recurrent layers" in found.output
    assert "proven: " in found.output
    assert "ASSEMBLY" not in found.output
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


@pytest.mark.parametrize("what", ["firmware", "verify --certificate", "verify --prove"])
def test_without_the_checkers_it_is_told_how_to_install_them(
    what: str, project: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (project / "firmware" / "certificate.json").write_text("{}")
    monkeypatch.setitem(sys.modules, "zerodrift_proof", None)
    for name in ("checkers", "proof"):
        monkeypatch.delitem(sys.modules, f"zerodrift.verify.{name}", raising=False)
    found = CliRunner().invoke(cli, [*what.split(), "-C", str(project)])
    assert isinstance(found.exception, InputError)
    assert "pip install ./proof" in str(found.exception)


@pytest.mark.long
def test_a_program_is_proven_too(project: Path, tmp_path_factory: pytest.TempPathFactory) -> None:
    """`--elf`: each kernel in it is told with the program's name; what is none is bad input."""
    model = load("effects").model
    code = generate(model)
    texts = {path.name: path.read_text() for path in RUNTIME_FILES}
    texts |= {code.header_name: code.header, code.source_name: code.source}
    folder = tmp_path_factory.mktemp("build")
    elf = build_program(texts, code.prefix, len(model.outputs), BUILDS[0], folder)
    prove = ["verify", "-C", str(project), "--prove", "--elf", str(elf)]
    found = CliRunner().invoke(cli, [*prove, "--json"])
    assert found.exit_code == 0, found.output
    parts = {(p["what"], p["build"]): p["verdict"] for p in json.loads(found.stdout)["parts"]}
    for what in ("a step", "towards rest"):
        for build in ("proof.elf", "object code for cortex-m4", "object code for cortex-m0plus"):
            assert parts[f"gru in assembly, {what}", build] == "proven"
    (text := folder / "text.elf").write_text("no program")
    found = CliRunner().invoke(cli, [*prove[:-1], str(text)])
    assert isinstance(found.exception, InputError)
    assert "is no ELF file" in str(found.exception)
    found = CliRunner().invoke(cli, ["verify", "-C", str(project), "--elf", str(elf)])
    assert isinstance(found.exception, InputError)
    assert "--elf goes with --prove" in str(found.exception)
