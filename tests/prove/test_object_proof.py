"""Kernels in assembly are proven from object code; machine code that does anything else is not."""

import random
import shutil
from functools import cache
from pathlib import Path

import pytest
from benchmarks import bench_object_proof
from benchmarks.bench_object_proof import SUBJECTS, Subject, make_subject, plant

from tests.golden.vectors import load
from tests.prove.models import as_read
from tests.prove.test_proof import write
from zerodrift.c_runtime.cores import MEMORY, find_cross_compilers
from zerodrift.tasks.verify import PROGRAM, build_program, prove_model
from zerodrift_proof.equality.build import PROVEN, TESTED
from zerodrift_proof.equality.kernels import Layers
from zerodrift_proof.equality.specification import Specification
from zerodrift_proof.equality.terms import Terms
from zerodrift_proof.object.image import Image, ProgramError, read_image
from zerodrift_proof.object.program import BUILDS, check_program, show_program

pytestmark = [
    pytest.mark.long,
    pytest.mark.skipif(not find_cross_compilers("cortex-m4"), reason="needs the ziglang wheel"),
]


@pytest.fixture(scope="module")
def subject(tmp_path_factory: pytest.TempPathFactory) -> Subject:
    return make_subject("odd_hidden", 0, tmp_path_factory.mktemp("object") / "m4")


@cache
def make_layers(name: str) -> Layers:
    layers = Specification(Terms(), as_read(load(name).model)).layers
    for layer in layers.layers.values():
        for relaxing in (False, True):
            layers.given[layer.name, relaxing] = [(-32768, 32767)] * layer.inputs
    return layers


def test_a_kernel_is_proven(subject: Subject) -> None:
    assert subject.prove(subject.image) == ""


@pytest.mark.parametrize(("name", "number"), (*SUBJECTS, ("lstm", 4), ("lstm", 5)))
def test_golden_kernels_are_proven(name: str, number: int, tmp_path: Path) -> None:
    """GRU with the reset after and before, with 8 bits, and LSTM, on the cores that have them."""
    made = make_subject(name, number, tmp_path / "program")
    assert made.prove(made.image) == ""


def test_every_way_to_build_the_assembly_is_proven() -> None:
    model = load("odd_hidden").model
    shown = tuple(prove_model(model, write(model)))
    kernels = [one for one in shown if one.what == "kernels of recurrent layers"]
    assembly = [one for one in kernels if "ASSEMBLY" in one.build]
    assert len(assembly) == 6
    assert {one.verdict for one in assembly} == {PROVEN}
    assert {one.verdict for one in kernels} == {PROVEN, TESTED}
    objects = [one for one in shown if one.what.startswith("gru in assembly")]
    assert {one.build for one in objects} == {build.name for build in BUILDS}
    assert {one.verdict for one in objects} == {PROVEN}


def find(image: Image, at: int, size: int, code: bytes) -> list[int]:
    content = image.read(at, size)
    assert content is not None
    return [at + k for k in range(0, size - 1, 2) if content[k : k + len(code)] == code]


FAULTS = {
    "SMMULR cuts off": ("53fb12f3", "53fb02f3", "h[0] is another"),
    "SMMLAR takes r3 for r4": ("54fb1133", "53fb1133", "h[0] is another"),
    "the loop's end is compared with r4": ("bc45", "a445", ""),
    "ADD becomes SUB": ("04eb4304", "a4eb4304", "h[0] is another"),
    "r3 is given back for r4": ("bde8f08f", "bde8e88f", "r4 is not given back"),
    "a line of another table": ("39f915e0", "38f915e0", ""),
}
"""Bytes of an instruction, what takes their place, and what is told."""


@pytest.mark.parametrize("name", FAULTS)
def test_planted_faults_are_not_proven(subject: Subject, name: str) -> None:
    before, after, why = FAULTS[name]
    kernel = subject.kernel
    places = find(subject.image, kernel.at, kernel.size, bytes.fromhex(before))
    assert places, name
    image = subject.image.change(places[0], bytes.fromhex(after))
    found = subject.prove(image)
    assert found
    assert why in found


def test_drawn_faults_are_not_proven_or_mean_the_same(subject: Subject) -> None:
    hold_drawn_faults(subject)


def test_drawn_faults_in_an_lstm_of_the_smallest_cores_are_neither(tmp_path: Path) -> None:
    hold_drawn_faults(make_subject("lstm", 4, tmp_path / "program"))


def hold_drawn_faults(subject: Subject) -> None:
    chip = bench_object_proof.KernelChip(subject.core, subject.image, subject.kernel)
    left = 0
    for number in range(24):
        rng = random.Random(number)
        image = plant(subject, bench_object_proof.KINDS[number % 9], rng)
        if subject.prove(image):
            left += 1
        else:
            assert not subject.find_difference(image, chip, rng), number
    assert left >= 16


def test_a_proof_of_everything_is_found_out(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """With a prover that shows anything, the emulated core tells the faults."""
    monkeypatch.setattr(bench_object_proof, "SUBJECTS", (("one_input", 0),))
    monkeypatch.setattr(Subject, "prove", lambda *_: "")
    assert not bench_object_proof.run(4, seed=3)
    assert "MISSED one_input" in capsys.readouterr().out


@pytest.fixture(scope="module")
def program(tmp_path_factory: pytest.TempPathFactory) -> Path:
    model = load("odd_hidden").model
    folder = tmp_path_factory.mktemp("user")
    return build_program(write(model), "golden", len(model.outputs), BUILDS[0], folder)


def test_a_users_program_is_proven(program: Path) -> None:
    source = write(load("odd_hidden").model)["golden.c"]
    check_program(program, source)
    shown = list(show_program(program, make_layers("odd_hidden"), ["gru"]))
    assert [(one.build, one.why) for one in shown] == [("proof.elf", "")] * 2


@pytest.mark.skipif(shutil.which("arm-none-eabi-gcc") is None, reason="needs arm-none-eabi-gcc")
@pytest.mark.parametrize("core", ["cortex-m0plus", "cortex-m33"])
def test_a_program_of_gcc_is_proven(core: str, tmp_path: Path) -> None:
    (tmp_path / "zd_proof.c").write_text(PROGRAM.format(memory=MEMORY, prefix="golden", count=8))
    for file, text in write(load("odd_hidden").model).items():
        (tmp_path / file).write_text(text)
    (gcc,) = (c for c in find_cross_compilers(core) if c.name == "gcc")
    free = ["-std=c99", "-Os", "-ffreestanding", "-nostdlib", f"-I{tmp_path}"]
    path = tmp_path / "app.elf"
    gcc.run([*free, str(tmp_path / "zd_proof.c"), "-lgcc", "-o", str(path)])
    shown = list(show_program(path, make_layers("odd_hidden"), ["gru"]))
    assert [(one.build, one.why) for one in shown] == [("app.elf", "")] * 2


def test_a_program_of_another_model_is_told(program: Path) -> None:
    shown = list(show_program(program, make_layers("ordinary"), ["gru"]))
    assert len(shown) == 1
    assert "gru_stream holds other numbers than model.json" in shown[0].why


def test_what_is_no_such_program_is_told(program: Path, tmp_path: Path) -> None:
    model = load("odd_hidden").model
    source = write(model)["golden.c"]
    (text := tmp_path / "text.elf").write_text("no program")
    (host := tmp_path / "host.elf").write_bytes(_change(program, 18, b"\x3e\x00"))
    (loose := tmp_path / "loose.o").write_bytes(_change(program, 16, b"\x01\x00"))
    (stripped := tmp_path / "stripped.elf").write_bytes(_strip(program))
    for path, why in (
        (text, "is no ELF file"),
        (host, "--elf proves programs for Cortex-M"),
        (loose, "is not linked"),
        (stripped, "it was stripped"),
    ):
        with pytest.raises(ProgramError, match=why):
            check_program(path, source)
    with pytest.raises(ProgramError, match="no kernel in assembly"):
        check_program(program, write(load("int8_before").model)["golden.c"])
    c_only = tmp_path / "c_only"
    c_only.mkdir()
    texts = {
        **write(model),
        "zd_runtime.h": "#define ZD_NO_ASSEMBLY\n" + write(model)["zd_runtime.h"],
    }
    with pytest.raises(ProgramError, match="holds no gru_assembly"):
        check_program(build_program(texts, "golden", len(model.outputs), BUILDS[0], c_only), source)


def _change(path: Path, at: int, content: bytes) -> bytes:
    old = path.read_bytes()
    return old[:at] + content + old[at + len(content) :]


def _strip(path: Path) -> bytes:
    """Return a program without its section headers' table of symbols."""
    content = path.read_bytes()
    start, size, count = (
        int.from_bytes(content[a:b], "little") for a, b in ((32, 36), (46, 48), (48, 50))
    )
    for k in range(count):
        at = start + k * size + 4
        if content[at : at + 4] == b"\x02\0\0\0":  # SHT_SYMTAB
            content = content[:at] + b"\x01\0\0\0" + content[at + 4 :]
    return content


def test_two_models_in_one_program(tmp_path: Path) -> None:
    """Both call their layer gru; each is proven of its own kernel."""
    (compiler, *_) = find_cross_compilers("cortex-m4")
    files = {"odd_hidden": "golden.c", "front_end": "front_end.c"}
    for name in files:
        for file, text in write(load(name).model).items():
            (tmp_path / file).write_text(text)
    (tmp_path / "main.c").write_text(MAIN)
    path = tmp_path / "both.elf"
    sources = [str(tmp_path / file) for file in (*files.values(), "main.c")]
    free = ["-std=c99", "-O2", "-ffreestanding", f"-I{tmp_path}"]
    compiler.run([*free, *sources, "-o", str(path)])
    assert len(read_image(path).find_kernels("gru")) == 2
    for name in files:
        shown = list(show_program(path, make_layers(name), ["gru"]))
        assert [one.why for one in shown] == ["", ""]


MAIN = """\
#include "golden.h"
#include "front_end.h"
#include "zd_runtime.c"
void *memset(void *to, int value, size_t n);
void *memset(void *to, int value, size_t n) {
    for (size_t i = 0; i < n; i++) { ((volatile uint8_t *)to)[i] = (uint8_t)value; }
    return to;
}
golden_state_t one;
golden_input_t codes;
front_end_state_t other;
front_end_input_t more;
int32_t drift[16];
void _start(void);
void _start(void) {
    (void)golden_step(&one, &codes, drift);
    (void)front_end_step(&other, &more, drift);
}
"""
