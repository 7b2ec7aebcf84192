"""The oracle sees traps, bounds and bits; mutants are drawn, and hashes made to fit."""

import hashlib
import json
import shutil
from collections import Counter
from pathlib import Path

import pytest
from benchmarks.mutants.judge import draw_mutant, replace_file
from benchmarks.mutants.operators import OPERATORS
from benchmarks.mutants.oracle import Finding, Oracle
from benchmarks.mutants.subjects import Subject, make_folder

pytestmark = pytest.mark.long

CLAMPED = "in_1 = zd_clamp32(in->supply, -12000, 12000) * 4096;\n    ZD_OBSERVE"


@pytest.fixture(scope="module")
def subject(tmp_path_factory: pytest.TempPathFactory) -> Subject:
    return make_folder("front_end", tmp_path_factory.mktemp("mutants") / "front_end")


@pytest.fixture(scope="module")
def oracle(subject: Subject) -> Oracle:
    return subject.make_oracle(chips=False)


def judge(oracle: Oracle, name: str, old: str, new: str, *, quick: bool = False) -> Finding:
    """Judge one replacement of the first place where a text stands."""
    text = oracle.files[name]
    at = text.index(old)
    first = text.count("\n", 0, at) + 1
    lines = range(first, first + old.count("\n") + 1)
    return oracle.judge(name, text.replace(old, new, 1), lines, quick=quick)


@pytest.mark.parametrize(
    ("name", "old", "new", "kind"),
    [
        ("front_end.c", "int16_t features[3];\n    {\n", "int16_t features[2];\n    {\n", "traps"),
        ("front_end.c", CLAMPED, "in_1 = in->supply * 4096;\n    ZD_OBSERVE", "leaves a bound"),
        ("front_end.c", "s->gru_h_q30, -1);", "s->gru_h_q30, 0);", "changes a bit"),
        ("front_end.c", "s->steps < 5u", "s->steps < 4u", "changes a bit"),
        ("front_end.h", "FY_LSB_PER_UNIT 10", "FY_LSB_PER_UNIT 010", "changes a bit"),
        ("front_end.c", "s->steps == 0u", "s->steps < 1u", "equivalent"),
        ("zd_gru_rows.h", "vrshrq_n_s32(h, 15)", "vrshrq_n_s32(h, 14)", "changes a bit"),
        ("zd_gru_pairs.h", "acc[2] = bias_n;", ";", "changes a bit"),
        ("front_end.c", "return flags;\n}\n\nvoid", "return flag;\n}\n\nvoid", "does not compile"),
    ],
)
def test_oracle_says_what_a_change_does(
    oracle: Oracle, name: str, old: str, new: str, kind: str
) -> None:
    finding = judge(oracle, name, old, new)
    assert finding.kind == kind, finding


def test_quick_oracle_finds_what_one_build_shows(oracle: Oracle) -> None:
    old = "int16_t features[3];\n    {\n"
    assert judge(oracle, "front_end.c", old, old.replace("3", "2"), quick=True).kind == "traps"
    found = judge(oracle, "front_end.c", "s->steps < 5u", "s->steps < 4u", quick=True)
    assert (found.kind, found.build) == ("changes a bit", "columns")


def test_endless_loop_is_a_trap(oracle: Oracle, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("benchmarks.mutants.oracle._SECONDS", 2)
    old = "for (uint32_t k = 0; k < ZD_GRU_RELAX_STEPS; k++) {"
    new = "for (uint32_t k = 0; k < 4294967295u; k++) {"
    assert judge(oracle, "front_end.c", old, new).kind == "traps"


def test_the_same_seed_draws_the_same_mutants_of_every_class(subject: Subject) -> None:
    drawn = [draw_mutant(subject, 1, number) for number in range(400)]
    assert {m.kind for m in drawn} == set(OPERATORS)
    assert drawn[:20] == [draw_mutant(subject, 1, number) for number in range(20)]
    for mutant in drawn:
        assert mutant.text != subject.files[mutant.file]
    assert Counter(m.file.startswith("zd_") for m in drawn)[True] > 100


def test_hashes_of_a_replaced_file_are_corrected_through_all_files(
    subject: Subject, tmp_path: Path
) -> None:
    folder = tmp_path / "firmware"
    shutil.copytree(subject.folder, folder)
    certificate = (folder / "certificate.json").read_bytes()
    manifest = {"files": {"certificate.json": hashlib.sha256(certificate).hexdigest()}}
    (folder / "manifest.json").write_text(json.dumps(manifest))
    replace_file(folder / "zd_signals.h", b"/* other */\n", [folder])
    after = (folder / "certificate.json").read_bytes()
    assert (
        json.loads(after)["files"]["zd_signals.h"] == hashlib.sha256(b"/* other */\n").hexdigest()
    )
    told = json.loads((folder / "manifest.json").read_text())
    assert told["files"]["certificate.json"] == hashlib.sha256(after).hexdigest()
