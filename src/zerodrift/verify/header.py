"""Checks the header's values that no comparison of bits covers: LSBs, sample period, indices,
flags.

The harness compiles the header's own macros and hands their values over, so that what is compared
is what an application gets, whatever the text looks like.
"""

import ctypes
from pathlib import Path

from zerodrift.c_runtime.host import SAVED_EXTRA_BYTES
from zerodrift.codegen.generate import GeneratedCode
from zerodrift.codegen.identifiers import name_channels, name_outputs
from zerodrift.export.integer_model import (
    FLAG_CLAMPED,
    FLAG_DAMAGED,
    FLAG_INPUT_RANGE,
    FLAG_NO_READING,
    FLAG_RATE_RANGE,
    FLAG_TARED,
    FLAG_TEMPERATURE_RANGE,
    FLAG_WARMING_UP,
    FORMAT,
    IntegerModel,
)
from zerodrift.verify.header_finding import HeaderFinding
from zerodrift.verify.manifest import FILE_NAME as MANIFEST

FLAGS = {
    "WARMING_UP": FLAG_WARMING_UP,
    "TEMPERATURE_RANGE": FLAG_TEMPERATURE_RANGE,
    "RATE_RANGE": FLAG_RATE_RANGE,
    "CLAMPED": FLAG_CLAMPED,
    "DAMAGED": FLAG_DAMAGED,
}
FAULTS = {"REPLAY": 1, "TABLES": 2}
_MISSING = -(2**63)
"""Stands for a macro that is not there; none has this value."""
_LONGEST_TEXT = 256
_TEXTS = ("MODEL_HASH", "MANIFEST")


def list_expected(
    model: IntegerModel, prefix: str, named: tuple[str, int] | None = None
) -> dict[str, int | str]:
    """Return every name that an application reads of the header -> what the model says of it.

    Args:
        model: the integer model.
        prefix: of the C names.
        named: hash and word of states of a design; None: the model's own.
    """
    upper = prefix.upper()
    outputs = name_outputs(model)
    expected: dict[str, int | str] = {
        "FORMAT": FORMAT,
        "MODEL_HASH": model.hash if named is None else named[0],
        "MODEL_ID": model.identity if named is None else named[1],
        "MANIFEST": MANIFEST,
        "CHANNELS": len(model.channels),
        "OUTPUTS": len(model.outputs),
    }
    if model.sample_period_s * 1e6 < 2**32 - 1:
        expected["SAMPLE_PERIOD_US"] = round(model.sample_period_s * 1e6)
    for index, (name, output) in enumerate(zip(outputs, model.outputs, strict=True)):
        expected[name.upper()] = index
        expected[f"{name.upper()}_LSB_PER_UNIT"] = output.lsb_per_unit
    expected |= {f"FLAG_{name}": value for name, value in FLAGS.items()}
    if model.guards.ranges:
        expected["FLAG_INPUT_RANGE"] = FLAG_INPUT_RANGE
    if model.optional:
        expected["FLAG_NO_READING"] = FLAG_NO_READING
    if model.tare:
        expected["FLAG_TARED"] = FLAG_TARED
    expected |= {f"FAULT_{name}": value for name, value in FAULTS.items()}
    return {f"{upper}_{name}": value for name, value in expected.items()}


_HAS_AVX2 = """
#if defined(__x86_64__) && defined(__GNUC__)
#include <cpuid.h>
/* Asked of the processor: __builtin_cpu_supports needs a symbol that not every linker's runtime
   has. Bit 27 of leaf 1 is OSXSAVE, XCR0 tells whether the system keeps the wide registers. */
uint32_t zd_has_avx2(void) {
    unsigned a, b, c, d, kept, high;
    if (!__get_cpuid(1, &a, &b, &c, &d) || (c >> 27 & 1u) == 0u) {
        return 0u;
    }
    __asm__ volatile("xgetbv" : "=a"(kept), "=d"(high) : "c"(0));
    return (kept & 6u) == 6u && __get_cpuid_count(7, 0, &a, &b, &c, &d) ? b >> 5 & 1u : 0u;
}
#else
uint32_t zd_has_avx2(void) {
    return 0u;
}
#endif
"""


def render_questions(model: IntegerModel, prefix: str) -> str:
    """Return C, to stand behind the harness, that tells the values of `list_expected`, in order."""
    numbers = _list_numbers(model, prefix)
    lines = ["", "/* What the header says, for the comparison with the model. */"]
    lines.append(f"int64_t zd_told_numbers[{len(numbers) + 2 + 2 * len(model.channels)}] = {{")
    for name in numbers:
        lines += [f"#ifdef {name}", f"    (int64_t)({name}),", "#else", "    INT64_MIN,", "#endif"]
    lines += [
        f"    (int64_t)({prefix.upper()}_SAVED_BYTES),",
        f"    (int64_t)sizeof({prefix}_state_t),",
    ]
    for channel in name_channels(model):
        lines.append(f"    (int64_t)sizeof((({prefix}_input_t *)0)->{channel}),")
    for channel in name_channels(model):
        lines.append(f"    (int64_t)offsetof({prefix}_input_t, {channel}),")
    lines.append("};")
    for name in _TEXTS:
        macro = f"{prefix.upper()}_{name}"
        lines += [f"#ifdef {macro}", f"const char zd_told_{name}[{_LONGEST_TEXT}] = {macro};"]
        lines += ["#else", f"const char zd_told_{name}[{_LONGEST_TEXT}];", "#endif"]
    return "\n".join(lines) + _HAS_AVX2


def _list_numbers(model: IntegerModel, prefix: str) -> list[str]:
    """Return the names in the header that stand for numbers."""
    texts = {f"{prefix.upper()}_{name}" for name in _TEXTS}
    return [name for name in list_expected(model, prefix) if name not in texts]


def add_questions(model: IntegerModel, code: GeneratedCode) -> str:
    """Return a model's harness with the questions behind it."""
    return code.harness + render_questions(model, code.prefix)


def has_avx2(library: Path) -> bool:
    """Tell whether this host runs AVX2, as a build with the questions says."""
    return bool(ctypes.CDLL(str(library)).zd_has_avx2())


def check_header(
    model: IntegerModel, prefix: str, library: Path, named: tuple[str, int] | None = None
) -> tuple[HeaderFinding, ...]:
    """Return what a header says otherwise than the model.

    Args:
        model: the integer model.
        prefix: of the C names.
        library: a host build whose harness has the questions.
        named: hash and word of states of a design; None: the model's own.
    """
    expected = list_expected(model, prefix, named)
    loaded = ctypes.CDLL(str(library))
    numbers = _list_numbers(model, prefix)
    channels = name_channels(model)
    count = len(numbers) + 2 + 2 * len(channels)
    told = list((ctypes.c_int64 * count).in_dll(loaded, "zd_told_numbers"))
    values: dict[str, int | str | None] = {
        name: None if value == _MISSING else value
        for name, value in zip(numbers, told, strict=False)
    }
    for name in _TEXTS:
        text = bytes((ctypes.c_char * _LONGEST_TEXT).in_dll(loaded, f"zd_told_{name}"))
        values[f"{prefix.upper()}_{name}"] = text.rstrip(b"\0").decode("ascii", "replace") or None
    manifest = f"{prefix.upper()}_MANIFEST"
    if values[manifest] is None:  # firmware from before manifests names none
        del expected[manifest]
    saved, state = told[len(numbers) : len(numbers) + 2]
    values[f"{prefix.upper()}_SAVED_BYTES"] = saved
    expected[f"{prefix.upper()}_SAVED_BYTES"] = state + SAVED_EXTRA_BYTES
    widths, places = told[-2 * len(channels) : -len(channels)], told[-len(channels) :]
    for k, (name, channel) in enumerate(zip(channels, model.channels, strict=True)):
        values[f"bits of {prefix}_input_t.{name}"] = 8 * widths[k]
        expected[f"bits of {prefix}_input_t.{name}"] = channel.raw_bits
        values[f"place of {prefix}_input_t.{name}"] = sorted(places).index(places[k])
        expected[f"place of {prefix}_input_t.{name}"] = k
    form = f"{prefix.upper()}_FORMAT"
    if values[form] in range(model.format, FORMAT):  # of an older version, which its runtime shares
        expected[form] = values[form] or 0
    return tuple(
        HeaderFinding(name, values[name], value)
        for name, value in expected.items()
        if values[name] != value
    )
