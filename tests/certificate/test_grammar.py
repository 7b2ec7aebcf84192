"""The C that the certificate's checker reads: what the generator writes, and no other text."""

import itertools
import random
import re
import subprocess
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import pytest
from benchmarks.random_models import draw_case

from tests.blocks.units import describe_unit
from tests.certificate.refused import FILES, NAME, REFUSED, C, H
from tests.certificate.test_check import list_texts
from tests.golden.models import CASES
from tests.operations.test_thermocouple import make_model as make_thermocouple
from tests.variable_step.models import make_model as make_asleep
from zerodrift.blocks.design import make_design
from zerodrift.c_runtime.compilers import RUNTIME_FILES, find_compilers
from zerodrift.codegen.generate import GeneratedCode, generate, generate_design
from zerodrift.export.model_files import load_model
from zerodrift.export.quantize import quantize
from zerodrift_proof.certificate.check import find_taken_headers
from zerodrift_proof.certificate.model import Runtime, read_models
from zerodrift_proof.certificate.preprocessor import (
    CLAIM,
    KERNELS,
    TOKEN,
    Build,
    list_builds,
    read_ways,
)
from zerodrift_proof.certificate.values import FaultError, NotUnderstoodError

GOLDEN = Path(__file__).parents[1] / "golden"
RUNTIME = {path.name: path.read_text() for path in RUNTIME_FILES}
KNOWN = Runtime(RUNTIME).numbers


def read(texts: dict[str, str]) -> None:
    read_models({**RUNTIME, **texts}, NAME)


@pytest.mark.parametrize("what", REFUSED)
def test_what_the_generator_never_writes_is_refused_with_its_place(what: str) -> None:
    name, old, new, reason = REFUSED[what]
    assert old in FILES[name], "the text has no such place any more: plant it anew"
    with pytest.raises((NotUnderstoodError, FaultError)) as refusal:
        read({**FILES, name: FILES[name].replace(old, new, 1)})
    told = str(refusal.value)
    assert re.match(r"front_end\.[ch]:[1-9]\d*:[1-9]\d*: ", told), told
    assert reason in told, told


def test_the_place_is_that_of_the_word() -> None:
    changed = FILES[C].replace("    uint32_t flags = 0;", "    uint32_t flags = 010;", 1)
    line = changed[: changed.index("= 010;")].count("\n") + 1
    with pytest.raises(NotUnderstoodError, match=rf"^front_end\.c:{line}:22: '010': an octal"):
        read({**FILES, C: changed})


def test_the_place_is_that_of_the_character() -> None:
    changed = FILES[H].replace("typedef struct {\n    int16_t", "typedef struct {\n    '", 1)
    line = changed[: changed.index("'")].count("\n") + 1
    with pytest.raises(
        NotUnderstoodError, match=rf"^front_end\.h:{line}:\d+: a character constant"
    ):
        read({**FILES, H: changed})


@pytest.mark.parametrize("prefix", ["zd", "zd_model", "int", "unix", "a-b", "A", "a__b", ""])
def test_a_prefix_that_would_rename_other_things_is_refused(prefix: str) -> None:
    texts = {f"{prefix}.{end}": FILES[f"{NAME}.{end}"] for end in ("h", "c")}
    with pytest.raises(NotUnderstoodError, match="prefix"):
        read_models({**RUNTIME, **texts}, prefix)


def test_a_prefix_makes_no_macro_of_a_standard_header() -> None:
    texts = {
        f"int32.{end}": FILES[f"{NAME}.{end}"].replace(NAME, "int32").replace("FRONT_END", "INT32")
        for end in ("h", "c")
    }
    read_models({**RUNTIME, **texts}, "int32")
    header = texts["int32.h"].replace("INT32_FX ", "INT32_MAX ").replace("INT32_FX_", "INT32_MAX_")
    with pytest.raises(NotUnderstoodError, match="INT32_MAX is a macro of a standard header"):
        read_models({**RUNTIME, **texts, "int32.h": header}, "int32")


def test_a_system_header_beside_the_c_is_told(tmp_path: Path) -> None:
    folder = tmp_path / "unit"
    folder.mkdir()
    assert list(find_taken_headers(folder, FILES)) == []
    (folder / "stdint.h").write_text("")
    (told,) = find_taken_headers(folder, FILES)
    assert told.startswith("stdint.h: lies beside the C")
    (folder / "stdint.h").rename(tmp_path / "stdint.h")
    assert list(find_taken_headers(folder, FILES)) == []
    (tmp_path / "runtime").mkdir()
    (tmp_path / "stdint.h").rename(tmp_path / "runtime" / "stdint.h")
    assert len(list(find_taken_headers(folder, FILES))) == 1


# --- nothing that the generator writes is refused


def make_code(kind: str) -> GeneratedCode:
    if kind == "asleep":
        return generate(make_asleep())
    if kind in ("thermocouple", "guarded"):
        return generate(replace(make_thermocouple("K", converted=True), guarded=kind == "guarded"))
    units = [replace(quantize(*describe_unit(seed, hidden=4)), tare=True) for seed in range(2)]
    return generate(units[0]) if kind == "tare" else generate_design(make_design(units))


@pytest.mark.spread(2, "kind", ["thermocouple", "guarded", "asleep", "tare", "block"])
def test_every_kind_of_model_is_read(kind: str) -> None:
    code = make_code(kind)
    assert read_models(list_texts(code), code.prefix)


@pytest.mark.spread(5, "case", CASES)
def test_every_golden_model_is_read(case: str) -> None:
    code = generate(load_model(GOLDEN / f"{case}.model.json"))
    assert read_models(list_texts(code), code.prefix)


@pytest.mark.spread(2, "number", range(6))
def test_drawn_models_are_read(number: int) -> None:
    code = generate(draw_case(5, number).model)
    assert read_models(list_texts(code), code.prefix)


# --- a compiler finds the same words


def find_words(
    folder: Path, texts: dict[str, str], prefix: str, build: Build, flags: Sequence[str] = ()
) -> list[str] | None:
    """Return the words that a C compiler finds in header and source; None if it refuses them.

    The runtime is replaced by what it defines for a build; its macros and those of the system stay
    as they are.
    """
    compiler = next(iter(find_compilers()), None)
    if compiler is None:
        pytest.skip("no C compiler: set CC, or install gcc, clang or ziglang")
    values = {"ZD_ASSEMBLY": 0, **build, "ZD_RUNTIME_FORMAT": KNOWN["ZD_RUNTIME_FORMAT"]}
    values |= {"ZD_RUNTIME_ID": KNOWN["ZD_RUNTIME_ID"]}
    values |= {f"ZD_KERNEL_{name}": number for number, name in enumerate(KERNELS)}
    stand_in = "".join(f"#define {name} {value}\n" for name, value in values.items())
    empty = dict.fromkeys([*RUNTIME, "stdint.h", "stddef.h"], "")
    plain = {name: text.replace(f"{CLAIM}\n", "\n") for name, text in texts.items()}
    for name, text in {**empty, "zd_runtime.h": stand_in, **plain}.items():
        (folder / name).write_text(text, encoding="latin-1", errors="replace", newline="")
    known = ("-DZD_OBSERVE=ZD_OBSERVE", "-DZD_QUIET=ZD_QUIET")
    command = [*compiler.command, "-E", "-P", "-nostdinc", f"-I{folder}", *known, *flags]
    done = subprocess.run(
        [*command, str(folder / f"{prefix}.c")], capture_output=True, check=False, timeout=60
    )
    return TOKEN.findall(done.stdout.decode("latin-1")) if done.returncode == 0 else None


def test_a_compiler_finds_the_same_words_in_every_way(tmp_path: Path) -> None:
    ways = read_ways({**RUNTIME, **FILES}, NAME, KNOWN)
    assert len(ways) == 10
    for way, tokens in ways:
        assert find_words(tmp_path, FILES, NAME, way.builds[-1]) == tokens.words, way.name


PIECES = (
    "'/*'", "/*", "*/", "//", "/", "\\\n", "\\", "'", '"', "??/\n", "%:", "<:", "#", "##", "\t",
    "\r", "\n", " ", "-", "+", "&", "=", "0", "x", "/* a */", "/* a\n b */", "\n#undef INT32_MAX\n",
    "\n#ifdef __GNUC__\n", "\n#endif\n", "\n#else\n", "\n#if 0\n", "\n#if defined(ZD_SMALL)\n",
    "\n#if !defined(ZD_SMALL)\n", "\n#define sound 1\n", "__LINE__", "unix",
    "\n/* x */ #define A 1\n",
)  # fmt: skip


def test_what_is_read_of_changed_text_is_what_a_compiler_reads(tmp_path: Path) -> None:
    """Texts with a piece put in, left out or doubled are refused, or read as a compiler does."""
    draw = random.Random(1)
    counts = {"refused": 0, "alike": 0}
    for _ in range(80):
        name = draw.choice([H, C, C])
        text = FILES[name]
        at = text.find(draw.choice(["\n", "#", "/*", "*/", '"', "("]), draw.randrange(len(text)))
        at += draw.randrange(2)
        end = at + draw.choice([0, 0, 0, 1, 2])
        changed = {**FILES, name: text[:at] + draw.choice(PIECES) + text[end:]}
        try:
            ways = read_ways({**RUNTIME, **changed}, NAME, KNOWN)
        except (NotUnderstoodError, FaultError):
            counts["refused"] += 1
            continue
        way, tokens = draw.choice(ways)
        found = find_words(tmp_path, changed, NAME, draw.choice(way.builds), ["-trigraphs"])
        assert found in (tokens.words, None), changed[name][max(0, at - 80) : at + 80]
        counts["alike"] += found is not None
    assert counts["refused"] > 40 and counts["alike"] > 4, counts


THUMB = ("-D__thumb__", "-D__thumb2__", "-D__ELF__", "-D__ARM_ARCH_PROFILE='M'")
CHIPS = {
    "host": (),
    "host without vectors": ("-U__SSE2__",),
    "Cortex-M0": ("-U__SSE2__", "-D__thumb__", "-D__ELF__", "-D__ARM_ARCH_6M__"),
    "Cortex-M3": ("-U__SSE2__", *THUMB, "-D__ARM_FEATURE_UNALIGNED"),
    "Cortex-M4": ("-U__SSE2__", *THUMB, "-D__ARM_FEATURE_DSP", "-D__ARM_FEATURE_UNALIGNED"),
    "Cortex-M55": ("-U__SSE2__", *THUMB, "-D__ARM_FEATURE_DSP", "-D__ARM_FEATURE_MVE"),
}
GIVEN = ((), ("-DZD_SMALL",), ("-Os",), ("-DZD_NO_ASSEMBLY",))
GIVEN += tuple((f"-DZD_KERNEL={number}",) for number in range(len(KERNELS)))


@pytest.mark.parametrize("chip", CHIPS)
def test_the_runtime_defines_no_other_build(chip: str, tmp_path: Path) -> None:
    """Whatever a build is told, zd_runtime.h makes of it what the checker takes every way for."""
    compiler = next(iter(find_compilers()), None)
    if compiler is None:
        pytest.skip("no C compiler: set CC, or install gcc, clang or ziglang")
    known = list(list_builds())
    text = RUNTIME["zd_runtime.h"].split("/* A model generated for another format")[0]
    ask = "ZD_KERNEL ZD_ASSEMBLY ZD_GRU_ASSEMBLY ZD_SMALL ZD_UNALIGNED"
    for k, name in enumerate(ask.split()):
        text += f"\n#if defined({name})\n@{k} {name}@\n#endif"
    (tmp_path / "ask.c").write_text(f"{text}\n#endif\n")
    (tmp_path / "arm_acle.h").write_text("")
    for given in GIVEN:
        command = [*compiler.command, "-E", "-P", f"-I{tmp_path}", *CHIPS[chip], *given]
        done = subprocess.run(
            [*command, str(tmp_path / "ask.c")], capture_output=True, check=True, text=True
        )
        told = dict(re.findall(r"@(\d) ?(\w*) ?@", done.stdout))
        values = {ask.split()[int(k)]: int(value or "1") for k, value in told.items()}
        build = {name: value for name, value in values.items() if name != "ZD_ASSEMBLY" or value}
        assert build in known, given


def test_builds_are_told_apart() -> None:
    builds = list(list_builds())
    assert len(builds) == len({tuple(build.items()) for build in builds}) == 48
    for one, other in itertools.combinations(builds, 2):
        assert one != other
