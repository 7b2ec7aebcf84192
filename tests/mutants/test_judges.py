"""What traps or leaves a bound is refused by the certificate's checker, its hashes made to fit."""

import json
import subprocess
import sys
from pathlib import Path

import pytest
from benchmarks.mutants import __main__ as driver
from benchmarks.mutants.judge import Mutant, ask_certificate, write_mutant
from benchmarks.mutants.oracle import Finding
from benchmarks.mutants.subjects import Subject, make_folder

ROOT = Path(__file__).parents[2]
CASES = {
    "type of a table": ("front_end.c", "int16_t head_weights[24]", "int8_t head_weights[24]"),
    "size of a table": ("front_end.c", "head_weights[24]", "head_weights[23]"),
    "type of a bias": ("front_end.c", "int64_t features_bias", "int16_t features_bias"),
    "type of a local array": (
        "front_end.c",
        "int16_t features[3];\n    {",
        "int8_t features[3];\n    {",
    ),
    "size of a local array": (
        "front_end.c",
        "int16_t features[3];\n    {",
        "int16_t features[2];\n    {",
    ),
    "type of the state": ("front_end.h", "int32_t gru_h_q30[8]", "int16_t gru_h_q30[8]"),
    "size of the state": ("front_end.h", "gru_h_q30[8]", "gru_h_q30[7]"),
    "argument u_keep": (
        "front_end.c",
        "gru_step(features, s->gru_h_q30, -1)",
        "gru_step(features, s->gru_h_q30, 1073741824)",
    ),
    "a kernel's length": (
        "front_end.c",
        "zd_gru_copy_state(s->gru_h_q30, gru_q15, 8u)",
        "zd_gru_copy_state(s->gru_h_q30, gru_q15, 9u)",
    ),
    "init writes beyond": (
        "front_end.c",
        "    *s = blank;",
        "    *s = blank;\n    s->delay_6_line[5] = 1;",
    ),
    "save of more": (
        "front_end.c",
        "zd_save(saved, (const uint8_t *)s, (uint32_t)sizeof(*s)",
        "zd_save(saved, (const uint8_t *)s, 4096u",
    ),
    "restore of more": (
        "front_end.c",
        "zd_restore((uint8_t *)s, saved, (uint32_t)sizeof(*s)",
        "zd_restore((uint8_t *)s, saved, 4096u",
    ),
    "the guard is not used": (
        "front_end.c",
        "if (front_end_state_is_sound(s) == 0u) { /*",
        "if (front_end_state_is_sound(s) == 2u) { /*",
    ),
    "a table in octal": ("front_end.c", "features_shift[3] = {42", "features_shift[3] = {0112"),
    "an endless loop": ("front_end.c", "k < ZD_GRU_RELAX_STEPS", "k < 4294967295u"),
    "an arm of the pairs layout": (
        "front_end.c",
        "static const zd_gru_pairs_t gru = {gru_stream, {11",
        "static const zd_gru_pairs_t gru = {gru_stream, {32",
    ),
    "a kernel": ("zd_gru_pairs.h", "w = &w[4];", "w = &w[5];"),
    "a kernel of the smallest cores": (
        "zd_runtime.h",
        "int32_t)((al * bl) >> 16) + 32768",
        "int32_t)((al * bl) >> 15) + 32768",
    ),
    "a copy of the state": ("zd_runtime.c", "i < 12u", "i < 13u"),
}


@pytest.fixture(scope="module")
def subject(tmp_path_factory: pytest.TempPathFactory) -> Subject:
    return make_folder("front_end", tmp_path_factory.mktemp("judged") / "front_end")


def change(subject: Subject, name: str, old: str, new: str) -> Mutant:
    text = subject.files[name]
    at = text.index(old)
    line = text.count("\n", 0, at) + 1
    return Mutant(0, "by hand", name, line, text.replace(old, new, 1), range(line, line + 1))


def test_unchanged_firmware_is_accepted(subject: Subject) -> None:
    assert ask_certificate(subject.folder) == ("accepted", "")


@pytest.mark.parametrize(
    "case",
    [pytest.param(c, marks=[pytest.mark.slow] if k % 2 else []) for k, c in enumerate(CASES)],
)
def test_certificate_refuses_a_trap_of_each_class(
    case: str, subject: Subject, tmp_path: Path
) -> None:
    write_mutant(subject, change(subject, *CASES[case]), tmp_path / "mutant")
    told, why = ask_certificate(tmp_path / "mutant")
    assert told == "refused", why


def test_of_every_fortieth_that_the_quick_oracle_finds_nothing_in_the_judge_is_asked(
    subject: Subject, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[bool] = []

    class Silent:
        def judge(self, *_: object, bit_suffices: bool, quick: bool) -> Finding:
            asked.append(quick)
            return Finding("equivalent" if quick else "traps")

    monkeypatch.setattr(driver, "load_subject", lambda way, name: subject)
    monkeypatch.setattr(driver, "load_oracle", lambda way, name: Silent())
    monkeypatch.setattr(driver, "try_mutant", lambda *_, **__: ("accepted", ""))
    lines = [
        json.loads(driver.work(driver.Task("certificate", "front_end", 1, number, quick=True)))
        for number in range(0, 45, 5)
    ]
    assert [line["number"] for line in lines if line["told"]] == [0, 40]
    assert [line["finding"]["kind"] for line in lines if line["told"]] == ["traps", "traps"]
    assert asked.count(False) == 2 and driver.tell(lines, "certificate") == 1


@pytest.mark.slow
@pytest.mark.parametrize("way", ["certificate", "verify"])
def test_drawn_mutants_are_refused(way: str) -> None:
    command = [sys.executable, "-m", "benchmarks.mutants", f"--{way}", "--count", "40"]
    done = subprocess.run(
        [*command, "--seed", "7"], capture_output=True, text=True, check=False, cwd=ROOT
    )
    assert done.returncode == 0, done.stdout[-3000:] + done.stderr[-2000:]
