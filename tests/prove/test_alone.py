"""The checkers run alone: Python's standard library, their own folder and the firmware's files."""

import copy
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from elftools.elf.elffile import ELFFile
from elftools.elf.sections import ARMAttributesSection

from tests.fixed_point.test_mutated_models import SHAPES, mutate, write
from tests.golden.model_factory import draw_model
from tests.golden.vectors import load
from tests.house.test_order import ROOT
from zerodrift.c_runtime.compilers import RUNTIME_FILES
from zerodrift.c_runtime.footprint import list_symbols
from zerodrift.codegen.generate import generate
from zerodrift.export.error_bound import ErrorBound
from zerodrift.tasks.verify import build_program
from zerodrift.verify.certificate import certify
from zerodrift_proof.command import MissingError, load_model, main
from zerodrift_proof.object.image import CPU_ARCH, FUNCTION, UNALIGNED_ACCESS, ElfError, read_elf
from zerodrift_proof.object.program import BUILDS

SHARE = 0.05
"""Of the changed models that are read, so many are proven too, which takes seconds."""
ALONE = """
import runpy, sys
sys.path.insert(0, {proof!r})
sys.argv = ["zerodrift-proof", *{arguments!r}]
try:
    runpy.run_module("zerodrift_proof", run_name="__main__", alter_sys=True)
finally:
    foreign = {{name.partition(".")[0] for name in sys.modules}} - {{"zerodrift_proof"}}
    assert foreign <= {{*sys.stdlib_module_names, "__main__", "__mp_main__"}}, foreign
"""


def run_alone(*arguments: str) -> subprocess.CompletedProcess[str]:
    """Run `zerodrift-proof` on an interpreter without installed packages."""
    code = ALONE.format(proof=str(ROOT / "proof"), arguments=arguments)
    command = [sys.executable, "-I", "-S", "-c", code]
    return subprocess.run(command, capture_output=True, text=True, check=False)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    model = load("effects").model
    code = generate(model)
    firmware = tmp_path / "firmware"
    firmware.mkdir()
    (tmp_path / "build").mkdir()
    model.save(tmp_path / "build" / "model.json")
    texts = {code.header_name: code.header, code.source_name: code.source}
    texts |= {path.name: path.read_text() for path in RUNTIME_FILES}
    texts["certificate.json"] = certify(model, code, ErrorBound((), "not asked"))
    for name, text in texts.items():
        (firmware / name).write_text(text)
    return firmware


@pytest.mark.long
def test_alone_it_shows_what_verify_shows(folder: Path) -> None:
    done = run_alone(str(folder))
    assert (done.returncode, done.stderr) == (0, "")
    assert "claims hold, 0 do not" in done.stdout
    assert ", 0 not proven" in done.stdout
    source = folder / "golden.c"
    text = source.read_text()
    assert "s->steps++" in text
    source.write_text(text.replace("s->steps++", "s->steps += 2u"))
    done = run_alone(str(folder), "--prove", "--json")
    told = json.loads(done.stdout)
    assert done.returncode == 1
    assert told["schema"] == "verify-prove/1" and not told["proven"]
    assert "step" in {p["what"] for p in told["parts"] if p["verdict"] == "not proven"}
    done = run_alone(str(folder), "--certificate", "--json")
    assert done.returncode == 1
    assert json.loads(done.stdout)["certificate"] == "refused"


@pytest.mark.long
@pytest.mark.parametrize("name", SHAPES)
def test_no_change_of_a_model_is_proven_or_a_traceback(name: str, tmp_path: Path) -> None:
    """Each file is given the hash of its new content; the C is the old model's."""
    model, rng = draw_model(SHAPES[name], 3), np.random.default_rng(7)
    code = generate(model)
    texts = {code.header_name: code.header, code.source_name: code.source}
    texts |= {path.name: path.read_text() for path in RUNTIME_FILES}
    for file, text in texts.items():
        (tmp_path / file).write_text(text)
    path = tmp_path / "model.json"
    model.save(path)
    whole, refused = json.loads(path.read_text()), 0
    for _ in range(400):
        body = copy.deepcopy(whole)
        what = mutate(body, rng)
        write(path, body)
        try:
            read = load_model(path)
        except MissingError:
            refused += 1
            continue
        except Exception as error:
            raise AssertionError(f"{what}: {error!r}") from error
        if read.hash != model.hash and rng.random() < SHARE:
            assert main([str(tmp_path), "--prove"]) in (1, 2), what
    assert refused > 100


def test_what_is_missing_or_damaged_is_named(folder: Path) -> None:
    model = folder.parent / "build" / "model.json"
    text = model.read_text()
    for damage in (text.replace('"kind":"offset"', '"kind":"onset"'), text[:-9], "[]", "{}"):
        assert damage != text
        model.write_text(damage)
        done = run_alone(str(folder), "--prove")
        assert (done.returncode, done.stdout) == (2, "")
        assert done.stderr.startswith(f"error: {model}: cannot be read as a model (")
    model.unlink()
    done = run_alone(str(folder), "--prove")
    assert done.returncode == 2 and "--model" in done.stderr
    (folder / "certificate.json").unlink()
    done = run_alone(str(folder), "--certificate")
    assert done.returncode == 2 and "there is no certificate" in done.stderr


@pytest.mark.parametrize("build", [BUILDS[0], BUILDS[-1]], ids=lambda build: build.core)
def test_a_program_is_read_as_pyelftools_reads_it(build, tmp_path: Path) -> None:
    model = load("ordinary").model
    code = generate(model)
    texts = {path.name: path.read_text() for path in RUNTIME_FILES}
    texts |= {code.header_name: code.header, code.source_name: code.source}
    path = build_program(texts, code.prefix, len(model.outputs), build, tmp_path)
    elf = read_elf(path.read_bytes())
    with path.open("rb") as file:
        other = ELFFile(file)
        found = elf.list_symbols()
        assert found is not None
        assert [(s.name, s.value, s.size, s.section) for s in found] == [
            (s.name, s.value, s.size, s.section if isinstance(s.section, int) else None)
            for s in list_symbols(other)
        ]
        functions = {s.name for s in list_symbols(other) if s.kind == "STT_FUNC"}
        assert {s.name for s in found if s.kind == FUNCTION} == functions
        spans = {s["sh_addr"]: s.data() for s in other.iter_sections() if s["sh_flags"] & 3 == 2}
        for span in elf.list_constants():
            assert spans[span.at] == span.content
        section = other.get_section_by_name(".ARM.attributes")
        assert isinstance(section, ARMAttributesSection)
        (part,) = (p for s in section.iter_subsections() for p in s.iter_subsubsections())
        told = {a.tag: a.value for a in part.iter_attributes()}
    assert elf.find_attribute(CPU_ARCH) == told["TAG_CPU_ARCH"]
    assert elf.find_attribute(UNALIGNED_ACCESS) == told.get("TAG_CPU_UNALIGNED_ACCESS")


def test_a_damaged_program_is_no_traceback(tmp_path: Path) -> None:
    model = load("ordinary").model
    code = generate(model)
    texts = {path.name: path.read_text() for path in RUNTIME_FILES}
    texts |= {code.header_name: code.header, code.source_name: code.source}
    path = build_program(texts, code.prefix, len(model.outputs), BUILDS[0], tmp_path)
    content = path.read_bytes()
    for at in (*range(4, 64), *range(len(content) - 1200, len(content), 7)):
        for damaged in (content[:at], content[:at] + b"\xff" + content[at + 1 :]):
            try:
                elf = read_elf(damaged)
                elf.list_symbols()
                elf.find_attribute(CPU_ARCH)
            except (ElfError, UnicodeDecodeError):
                continue
