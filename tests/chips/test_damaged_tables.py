"""Any number of any table that changes in the chip's memory is noticed by `selftest()`.

The tables are compiled as variables, so that one build can have all of its numbers changed in turn.
"""

import ctypes
import re
from pathlib import Path

import pytest
from tests.golden.model_factory import Shape, draw_model

from zerodrift.c_runtime.compilers import RUNTIME_FILES, WARNINGS, find_compiler
from zerodrift.c_runtime.host import write_sources
from zerodrift.codegen.generate import generate
from zerodrift.codegen.identity import find_runtime_identity
from zerodrift.export.integer_model import IntegerModel

TABLES = 2
TABLE = re.compile(r"^(?:static |ZD_SHARED )?const (u?int\d+_t \w+\[)", re.MULTILINE)
DECLARED = re.compile(r"^(u?int\d+_t) (\w+)\[", re.MULTILINE)
TYPES = {
    f"{sign}int{bits}_t": getattr(ctypes, f"c_{sign}int{bits}")
    for sign in ("", "u")
    for bits in (8, 16, 32, 64)
}
EVERYTHING = Shape(
    inputs=3,
    hidden=5,
    outputs=2,
    front_end=("lowpass", "root", "exp2", "root"),
    dense=((4, "tanh"), (3, "relu6")),
)
STACKED = Shape(inputs=2, hidden=4, outputs=2, weights="int8", reset="before", upper=(3,))
CASES = {
    "portable": (EVERYTHING, ("-DZD_KERNEL=0",)),
    "columns, SSE2": (EVERYTHING, ()),
    "pairs": (EVERYTHING, ("-DZD_KERNEL=1",)),
    "columns, AVX2": (EVERYTHING, ("-mavx2",)),
    "small": (EVERYTHING, ("-DZD_SMALL",)),
    "int8 stack": (STACKED, ()),
}


def build(model: IntegerModel, folder: Path, flags: tuple[str, ...]) -> tuple[ctypes.CDLL, str]:
    """Return the compiled model with its tables as variables, and all of its text."""
    code = generate(model)
    for path in write_sources(code, folder):
        path.write_text(TABLE.sub(r"\1", path.read_text()))
    harness = folder / "harness.c"
    harness.write_text(code.harness)
    library = folder / "damaged.so"
    sources = [str(harness), str(folder / "zd_runtime.c"), "-o", str(library)]
    options = [*WARNINGS, "-O1", *flags, "-shared", "-fPIC", f"-I{folder}"]
    find_compiler().run([*options, *sources])
    loaded = ctypes.CDLL(str(library))
    return loaded, _texts(loaded)


@pytest.mark.spread(2, "name", CASES)
def test_any_number_of_any_table_changed_is_noticed(name: str, tmp_path: Path) -> None:
    shape, flags = CASES[name]
    if name == "columns, AVX2" and "avx2" not in Path("/proc/cpuinfo").read_text():
        pytest.skip("this processor has no AVX2")
    library, text = build(draw_model(shape, 7), tmp_path, flags)
    assert library.zd_selftest() == 0
    changed: dict[str, int] = {}
    for kind, table in dict.fromkeys(DECLARED.findall(text)):
        try:
            first = TYPES[kind].in_dll(library, name_symbol(table))
        except ValueError:  # of another kernel, or of the other form of tanh
            continue
        numbers = (TYPES[kind] * count_numbers(library, table)).from_address(
            ctypes.addressof(first)
        )
        places = range(0, len(numbers), 1 if len(numbers) < 200 else 7)
        for place in places:
            for bit in (0, 8 * ctypes.sizeof(TYPES[kind]) - 1):
                kept = numbers[place]
                numbers[place] ^= 1 << bit
                assert library.zd_selftest() == TABLES, f"{table}[{place}], bit {bit}"
                numbers[place] = kept
        changed[table] = len(places)
    assert library.zd_selftest() == 0
    assert {t.name for node in draw_model(shape, 7).nodes for t in node.list_tables()} <= set(
        changed
    )
    assert ("zd_exp2_octave_q29" in changed) == ("exp2" in shape.front_end)
    assert any(t.startswith("zd_tanh") for t in changed)
    recurrent = [t for t in changed if t.startswith("gru")]
    assert len(recurrent) >= (1 if name == "pairs" or name.startswith("columns") else 3)


def count_numbers(library: ctypes.CDLL, table: str) -> int:
    """Return how many numbers a table has, by the size of its symbol."""
    from elftools.elf.elffile import ELFFile

    with Path(library._name).open("rb") as file:
        symbols = ELFFile(file).get_section_by_name(".dynsym")
        (symbol,) = symbols.get_symbol_by_name(name_symbol(table))
        kind = next(k for k, t in DECLARED.findall(_texts(library)) if t == table)
        return int(symbol["st_size"]) // ctypes.sizeof(TYPES[kind])


def name_symbol(table: str) -> str:
    """Return a table's name to the linker: the runtime's end in its identity."""
    return f"{table}_{find_runtime_identity()[2:]}" if table.startswith("zd_") else table


def _texts(library: ctypes.CDLL) -> str:
    folder = Path(library._name).parent
    return "".join(path.read_text() for path in sorted(folder.glob("*.[ch]")))


def test_every_table_of_the_runtime_is_one_that_the_test_would_find() -> None:
    """A table declared otherwise would not be changed above."""
    for path in RUNTIME_FILES:
        for line in path.read_text().splitlines():
            if re.search(r"const \w+ \w+\[[^\]]*\] = \{", line):
                assert TABLE.match(line), line
