"""The generated text itself: hostile names, deterministic bytes, nothing of this machine in it."""

import os
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.fixed_point.strategies import HOSTILE_NAMES, names
from tests.golden.model_factory import Shape, draw_model

from zerodrift.c_runtime.compilers import WARNINGS, find_compilers
from zerodrift.c_runtime.host import HostModel, write_sources
from zerodrift.codegen.generate import GeneratedCode, generate
from zerodrift.codegen.identifiers import (
    sanitize_comment,
    sanitize_identifier,
    sanitize_identifiers,
    sanitize_outputs,
    sanitize_prefix,
)

IDENTIFIER = re.compile(r"[a-z][a-z0-9_]{0,30}")
COMMENT_OR_STRING = re.compile(r'/\*.*?\*/|"[^"\n]*"', re.DOTALL)


def strip_comments(text: str) -> str:
    """Return C without comments and strings."""
    return COMMENT_OR_STRING.sub(" ", text)


def generate_hostile(name: str) -> GeneratedCode:
    """Return the C of a model all of whose names are `name`."""
    shape = Shape(
        name=name, inputs=1, hidden=1, outputs=2, channel_names=(name,), output_names=(name,) * 2
    )
    return generate(draw_model(shape, 1))


@pytest.mark.parametrize("first", range(0, len(HOSTILE_NAMES), 8))
def test_hostile_names_compile(first: int, tmp_path: Path) -> None:
    some = HOSTILE_NAMES[first : first + 8]
    shape = Shape(
        name=some[0], inputs=len(some), hidden=2, outputs=2 * len(some),
        channel_names=some, output_names=some * 2,
    )  # fmt: skip
    model = draw_model(shape, 1)
    host = HostModel(model, generate(model), tmp_path, find_compilers()[0], flags=("-O0",))
    assert host.selftest() == 0


@pytest.mark.long
@given(name=names)
@settings(max_examples=30, deadline=None)
def test_nothing_hostile_reaches_the_code(name: str) -> None:
    code = generate_hostile(name)
    clean = generate_hostile("plain")
    assert IDENTIFIER.fullmatch(code.prefix)
    for text, reference in ((code.header, clean.header), (code.source, clean.source)):
        assert text.isascii() and "\\\n" not in text and "??" not in text
        bare, plain = strip_comments(text), strip_comments(reference)
        assert len(re.findall(r"^#", bare, re.M)) == len(re.findall(r"^#", plain, re.M))
        assert set(re.findall(r"[^\w\s]", bare)) <= set(re.findall(r"[^\w\s]", plain))
        assert bare.count(";") == plain.count(";") and bare.count("{") == plain.count("{")


@given(text=st.one_of(names, st.text(max_size=400)))
@settings(max_examples=300)
def test_identifier_is_one_c_identifier(text: str) -> None:
    for identifier in (sanitize_identifier(text), sanitize_prefix(text)):
        assert IDENTIFIER.fullmatch(identifier)
        assert "__" not in identifier and not identifier.startswith("zd_")


@given(texts=st.lists(names, max_size=16))
def test_identifiers_are_distinct(texts: list[str]) -> None:
    identifiers = sanitize_identifiers(texts, "output")
    assert len(set(identifiers)) == len(texts)
    assert all(IDENTIFIER.fullmatch(identifier) for identifier in identifiers)


@given(text=st.text(max_size=200))
def test_comment_cannot_end_or_continue(text: str) -> None:
    comment = sanitize_comment(text)
    assert comment.isascii() and comment.isprintable()
    assert not set('*\\?"') & set(comment)


def test_output_does_not_take_a_macro_of_the_header(tmp_path: Path) -> None:
    outputs = (
        "H", "format", "outputs", "channels", "model id", "Model_Hash", "flag clamped",
        "FLAG_DAMAGED", "Fz", "Fz_LSB_PER_UNIT", "x", "X", "x_2", "x 2",
    )  # fmt: skip
    shape = Shape(hidden=0, inputs=1, outputs=len(outputs), output_names=outputs)
    model = draw_model(shape, 2)
    assert HostModel(model, generate(model), tmp_path, flags=("-O0",)).selftest() == 0


def test_model_does_not_hide_a_standard_header(tmp_path: Path) -> None:
    names = [sanitize_prefix(name) for name in ("stdint", "String", "time", "math")]
    assert names == ["stdint_x", "string_x", "time_x", "math_x"]
    model = draw_model(Shape(name="stdint", hidden=2, inputs=1, outputs=1), 3)
    assert HostModel(model, generate(model), tmp_path, flags=("-O0",)).selftest() == 0


STANDARD = (
    *("assert", "complex", "ctype", "errno", "fenv", "float", "inttypes", "iso646", "limits"),
    *("locale", "math", "setjmp", "signal", "stdarg", "stdbool", "stddef", "stdint", "stdio"),
    *("stdlib", "string", "tgmath", "time", "wchar", "wctype"),
)


def test_no_macro_is_one_of_a_standard_header(tmp_path: Path) -> None:
    """Sensor `int8` with output `max` would define INT8_MAX; so for every macro of every header."""
    gcc = next((c for c in find_compilers() if c.name == "gcc"), None)
    if gcc is None:
        pytest.skip("needs gcc, which lists the macros of headers")
    everything = tmp_path / "everything.c"
    everything.write_text("".join(f"#include <{name}.h>\n" for name in STANDARD))
    listed = tmp_path / "macros.h"
    gcc.run(["-std=c99", "-dM", "-E", str(everything), "-o", str(listed)])
    macros = set(re.findall(r"#define ([A-Z][A-Z0-9_]+)", listed.read_text()))
    assert {"INT8_MAX", "SIZE_MAX", "UINT32_C", "CLOCKS_PER_SEC"} <= macros
    for macro in macros:
        for cut in re.finditer("_", macro):
            prefix = sanitize_prefix(macro[: cut.start()])
            (output,) = sanitize_outputs([macro[cut.end() :]], prefix)
            assert f"{prefix}_{output}".upper() not in macros, (prefix, output)


@pytest.mark.parametrize(
    ("sensor", "output"), [("int8", "max"), ("size", "max"), ("uint32", "c"), ("mtx", "and")]
)
def test_names_of_the_language_are_left_to_it(sensor: str, output: str, tmp_path: Path) -> None:
    shape = Shape(
        name=sensor, hidden=2, inputs=1, outputs=1, output_names=(output,), channel_names=("errno",)
    )
    code = generate(draw_model(shape, 3))
    text = "".join(f"#include <{name}.h>\n" for name in STANDARD if name != "tgmath")
    source = tmp_path / f"{code.prefix}.c"
    write_sources(replace(code, header=code.header + text), tmp_path)
    find_compilers()[0].run([*WARNINGS, "-c", str(source), "-o", str(tmp_path / "object.o")])


@pytest.mark.long
def test_bytes_do_not_depend_on_the_process() -> None:
    script = (
        "import sys\nfrom tests.golden.vectors import load\n"
        "from zerodrift.codegen.generate import generate\n"
        "code = generate(load('front_end').model)\n"
        "sys.stdout.write(code.header + code.source + code.harness)\n"
    )
    root = Path(__file__).parents[2]
    texts = []
    for seed, zone in (("0", "UTC"), ("12345", "Asia/Tokyo")):
        environment = os.environ | {"PYTHONHASHSEED": seed, "TZ": zone}
        done = subprocess.run(
            [sys.executable, "-c", script], cwd=root, env=environment, check=True,
            capture_output=True, text=True,
        )  # fmt: skip
        texts.append(done.stdout)
    assert texts[0] == texts[1] and len(texts[0]) > 5000


def test_generated_text_tells_nothing_of_this_machine() -> None:
    code = generate_hostile("plain")
    text = code.header + code.source
    assert not re.search(r"\b20\d\d-\d\d|__DATE__|__TIME__|\d\d:\d\d", text)
    for secret in (os.uname().nodename, str(Path.home()), str(Path.cwd()), sys.prefix):
        assert len(secret) < 4 or secret not in text
