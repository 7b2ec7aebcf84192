"""Replays what the fuzzers kept, and random bytes: the C under sanitizers, the readers as is."""

import subprocess
from pathlib import Path

import numpy as np
import pytest
from tests.fuzz import build, corpus, loaders

from zerodrift.c_runtime.compilers import find_compilers
from zerodrift.codegen.generate import GeneratedCode
from zerodrift.export.integer_model import IntegerModel
from zerodrift.export.model_files import load_model

KEPT = corpus.read_corpus()
SANITIZED = [c for c in find_compilers() if c.name in ("gcc", "clang", "cc")]
needs_sanitizers = pytest.mark.skipif(
    not SANITIZED, reason="needs gcc or clang with the address sanitizer"
)


@needs_sanitizers
@pytest.mark.parametrize("target", build.TARGETS)
@pytest.mark.spread(
    1,
    "name",
    [pytest.param(n, marks=pytest.mark.slow if n == "windowed" else ()) for n in build.MODELS],
)
def test_corpus_and_random_bytes_find_nothing(name: str, target: str, tmp_path: Path) -> None:
    model = load_model(build.GOLDEN / f"{name}.model.json")
    flags = (f"-fsanitize={build.SANITIZERS}", "-DREPLAY")
    program = build.build(model, target, SANITIZED[0], tmp_path, flags)
    rng = np.random.default_rng(81)
    random = [rng.bytes(int(rng.integers(1, 500))) for _ in range(100)]
    files = corpus.unpack([*KEPT[f"{target}_{name}"], *random], tmp_path / "cases")
    done = subprocess.run([program, *files], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")


@needs_sanitizers
@pytest.mark.spread(1, "target", ["step", "state"])
def test_corpus_finds_nothing_in_the_small_table(target: str, tmp_path: Path) -> None:
    model = load_model(build.GOLDEN / "int8_before.model.json")
    flags = (f"-fsanitize={build.SANITIZERS}", "-DREPLAY", *build.TABLES["_small"])
    program = build.build(model, target, SANITIZED[0], tmp_path, flags)
    files = corpus.unpack(KEPT[f"{target}_int8_before"], tmp_path / "cases")
    done = subprocess.run([program, *files], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")


@needs_sanitizers
def test_target_would_find_a_state_that_is_not_checked(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Guards the test above: without the check of the delay's position, it reads out of bounds."""
    generate = build.generate

    def generate_unchecked(model: IntegerModel) -> GeneratedCode:
        code = generate(model)
        unsound = code.source.replace("        sound = 0u;", "        sound = sound;")
        assert unsound != code.source
        return GeneratedCode(code.prefix, code.header, unsound, code.harness)

    monkeypatch.setattr(build, "generate", generate_unchecked)
    flags = (f"-fsanitize={build.SANITIZERS}", "-DREPLAY")
    model = load_model(build.GOLDEN / "front_end.model.json")
    program = build.build(model, "state", SANITIZED[0], tmp_path, flags)
    bad = tmp_path / "bad"
    bad.write_bytes(b"\x03" + b"\xff" * 300)
    assert subprocess.run([program, bad], capture_output=True, check=False).returncode != 0


@pytest.mark.parametrize("target", loaders.TARGETS)
def test_readers_read_or_refuse_whatever_was_found(target: str) -> None:
    """Nothing but a message gets out, and the corpus holds files of both kinds."""
    read = [loaders.run_one(target, data) for data in KEPT[f"loader_{target}"]]
    assert True in read and False in read


@pytest.mark.parametrize("target", loaders.TARGETS)
def test_readers_read_or_refuse_damaged_files(target: str) -> None:
    seeds = loaders.list_seeds(target)
    assert loaders.run_one(target, seeds[0])
    rng = np.random.default_rng(82)
    for k in range(60):
        data = bytearray(seeds[k % len(seeds)])
        for at in rng.integers(0, len(data), 3):
            data[at] = rng.integers(0, 256)
        cut = int(rng.integers(0, len(data)))
        del data[cut : cut + int(rng.integers(0, 8))]
        loaders.run_one(target, bytes(data))


@pytest.mark.parametrize(
    ("target", "data"),
    [
        # found by the fuzzer: a quotation mark that is never closed
        ("csv", b'\0t,T,y,r,v\n0,20,0,0,3.3\n1,"0.10,0,3.3\n2,20,0,0,..3\n3,20,0,0,3\n'),
        # a field of a model that no quantizer writes, with the hash that belongs to it
        *(("model", bytes.fromhex(text)) for text in (
            "ffbebb86c3d1c427103c344c41eb2f1e", "ff10abcf0812c9305ec2",
            "ff01a65112c963c68e4b869c97", "ff11a29531c201f53981e6",
            "ff106435c0f37c9952f28000c014b527fb",
            "f529323b3b66743bff27ffffff",  # a window of 32551 samples: minutes of computation
        )),
        ("model", b"\0" + b"[" * 15000),
        ("model", b'\0{"format": ' + b"1" * 5000 + b"}"),
        ("config", b"[sensor]\nname = " + b"[" * 5000),
        ("config", b"[sensor]\nname = " + b"1" * 5000),
    ],
)  # fmt: skip
def test_files_that_once_got_through_are_refused(target: str, data: bytes) -> None:
    assert loaders.run_one(target, data) is False


def test_a_case_is_added_once_and_the_same_cases_make_the_same_archive(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    case = tmp_path / "case"
    case.write_bytes(b"t,T\n0,never kept\n")
    texts = []
    for order in (1, -1):
        monkeypatch.setattr(corpus, "ARCHIVE", tmp_path / f"{order}.tar.xz")
        corpus.write_corpus({name: KEPT[name][::order] for name in list(KEPT)[::order]})
        monkeypatch.setattr("sys.argv", ["corpus", "loader_csv", str(case), str(case)])
        corpus.main()
        texts.append(corpus.ARCHIVE.read_bytes())
    assert texts[0] == texts[1]
    grown = corpus.read_corpus()
    assert set(grown["loader_csv"]) - set(KEPT["loader_csv"]) == {case.read_bytes()}
    assert len(grown["loader_csv"]) == len(KEPT["loader_csv"]) + 1
    assert {**grown, "loader_csv": KEPT["loader_csv"]} == KEPT
