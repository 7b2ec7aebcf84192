"""Replays the fuzzers' corpora and random bytes under the sanitizers, with gcc or clang."""

import importlib.util
import subprocess
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from zerodrift.c_runtime.compilers import find_compilers
from zerodrift.export.integer_model import load_model

HERE = Path(__file__).parent
SANITIZED = [c for c in find_compilers() if c.name in ("gcc", "clang", "cc")]


def load_builder() -> ModuleType:
    spec = importlib.util.spec_from_file_location("fuzz_build", HERE / "build.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


BUILDER = load_builder()


@pytest.mark.skipif(not SANITIZED, reason="needs gcc or clang with the address sanitizer")
@pytest.mark.parametrize("target", BUILDER.TARGETS)
@pytest.mark.parametrize("name", ["front_end", pytest.param("windowed", marks=pytest.mark.slow)])
def test_corpus_and_random_bytes_find_nothing(name: str, target: str, tmp_path: Path) -> None:
    model = load_model(BUILDER.GOLDEN / f"{name}.model.json")
    flags = (f"-fsanitize={BUILDER.SANITIZERS}", "-DREPLAY")
    program = BUILDER.build(model, target, SANITIZED[0], tmp_path, flags)
    files = sorted((HERE / "corpus" / f"{target}_{name}").glob("*"))
    rng = np.random.default_rng(81)
    for i in range(300):
        files.append(tmp_path / f"random_{i}")
        files[-1].write_bytes(rng.bytes(int(rng.integers(1, 500))))
    done = subprocess.run([program, *files], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.skipif(not SANITIZED, reason="needs gcc or clang with the address sanitizer")
def test_target_would_find_a_state_that_is_not_checked(tmp_path: Path) -> None:
    """Guards the test above: without the check of the delay's position, it reads out of bounds."""
    model = load_model(BUILDER.GOLDEN / "front_end.model.json")
    generate = BUILDER.generate

    def generate_unchecked(model: object) -> object:
        code = generate(model)
        unsound = code.source.replace("        sound = 0u;", "        sound = sound;")
        assert unsound != code.source
        return type(code)(code.prefix, code.header, unsound, code.harness)

    BUILDER.generate = generate_unchecked
    try:
        flags = (f"-fsanitize={BUILDER.SANITIZERS}", "-DREPLAY")
        program = BUILDER.build(model, "state", SANITIZED[0], tmp_path, flags)
    finally:
        BUILDER.generate = generate
    bad = tmp_path / "bad"
    bad.write_bytes(b"\x03" + b"\xff" * 300)
    assert subprocess.run([program, bad], capture_output=True, check=False).returncode != 0
