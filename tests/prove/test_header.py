"""What a header tells its user is the model's: macros, structs, and how functions are called."""

from functools import cache

import pytest
from benchmarks.mutants.subjects import draw_subject

from tests.golden.vectors import load
from tests.prove.models import as_read
from tests.prove.test_reading import Texts, add_runtime
from zerodrift.codegen.generate import generate
from zerodrift.export.integer_model import IntegerModel
from zerodrift_proof.equality.build import OPEN, Proof
from zerodrift_proof.equality.prove import BUILDS

WHAT = ("header", "struct of the inputs", "struct of the state")


@cache
def write(name: str) -> tuple[IntegerModel, Texts, str]:
    model = draw_subject(name) if name == "asleep" else load(name).model
    code = generate(model)
    return model, add_runtime(code), code.prefix


def tell(name: str, before: str = "", after: str = "", every: bool = False) -> list[str]:
    """Return what is not proven of header and structs, one text of the header replaced."""
    model, texts, prefix = write(name)
    texts = {**texts}
    for file in (f"{prefix}.h", f"{prefix}.c") if every else (f"{prefix}.h",):
        assert before in texts[file]
        texts[file] = texts[file].replace(before, after)
    proof = Proof(as_read(model), texts, prefix, *BUILDS[0])
    shown = [one for one, _ in zip(proof.run(), WHAT, strict=False)]
    return [f"{one.what}: {one.why}" for one in shown if one.verdict == OPEN]


@pytest.mark.parametrize("name", ["front_end", "effects", "no_reading", "asleep"])
def test_a_generated_header_is_the_models(name: str) -> None:
    assert tell(name) == []


CHANGES = {
    "a scale": ("FY_LSB_PER_UNIT 10\n", "FY_LSB_PER_UNIT 100\n", "FY_LSB_PER_UNIT is 100"),
    "an index": ("#define FRONT_END_FX 0", "#define FRONT_END_FX 1", "FRONT_END_FX is 1"),
    "a type of a flag": (
        "RATE_RANGE UINT32_C(4)", "RATE_RANGE 4", "FLAG_RATE_RANGE is 4; the model gives"),
    "a count": ("FRONT_END_CHANNELS 3", "FRONT_END_CHANNELS 2", "FRONT_END_CHANNELS is 2"),
    "one more name": (
        "#define FRONT_END_CHANNELS 3", "#define FRONT_END_CHANNELS 3\n#define FRONT_END_FW 3",
        "FRONT_END_FW is 3; the model gives no such name"),
    "a name that is missing": (
        "#define FRONT_END_CHANNELS 3\n", "", "FRONT_END_CHANNELS is not defined"),
    "the size of a copy": ("(16u + sizeof(", "(8u + sizeof(", "FRONT_END_SAVED_BYTES is"),
}  # fmt: skip


@pytest.mark.parametrize("what", CHANGES)
def test_a_header_that_says_something_else_is_not_proven(what: str) -> None:
    before, after, told = CHANGES[what]
    assert any(told in one for one in tell("front_end", before, after))


CALLS = {
    "a result": ("uint32_t front_end_step(", "uint16_t front_end_step("),
    "the length of the answers": ("int32_t drift[FRONT_END_OUTPUTS]", "int32_t drift[2]"),
    "the type of a parameter": ("uint8_t saved[", "int8_t saved["),
    "a parameter that is not constant": ("const front_end_input_t *in", "front_end_input_t *in"),
    "a field that nobody may write": (
        "    int16_t temperature; /*", "    const int16_t temperature; /*"),
    "the type of a field": ("    int16_t temperature; /*", "    int32_t temperature; /*"),
}  # fmt: skip


@pytest.mark.parametrize("what", CALLS)
def test_a_function_or_struct_of_another_type_is_not_proven(what: str) -> None:
    """Header and source say the same, so that it compiles."""
    before, after = CALLS[what]
    assert tell("front_end", before, after, every=not before.startswith("    "))
