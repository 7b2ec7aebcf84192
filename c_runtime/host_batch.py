"""Many generated models in one host library, so that a compiler starts once for all of them.

Models of one design have the same C names. Their sources are compiled as they are: a file that
includes one after the other gives every name of a model another one by the preprocessor, and takes
that and the model's macros back before the next. The runtime is compiled once.
"""

import hashlib
import re
from collections.abc import Sequence
from pathlib import Path

from zerodrift.c_runtime.compilers import WARNINGS, Compiler, find_compiler, list_runtime
from zerodrift.c_runtime.host import HostModel
from zerodrift.codegen.generate import GeneratedCode
from zerodrift.export.integer_model import IntegerModel

HARNESS = "zd_harness.c"
_MACRO = re.compile(r"^[ \t]*#[ \t]*define[ \t]+(\w+)", re.MULTILINE)
_DEFINED = re.compile(
    r"^(?:static )?(?:const )?\w[\w \t]*?[ \t*](\w+)[ \t]*(?:\(|\[|=|;)", re.MULTILINE
)


def build_host_batch(
    models: Sequence[IntegerModel],
    codes: Sequence[GeneratedCode],
    directory: Path,
    compiler: Compiler | None = None,
    flags: tuple[str, ...] = ("-O1",),
    *,
    observe: bool = False,
) -> list[HostModel]:
    """Return the compiled models, all in one shared library.

    Args:
        models: the integer models, for their shapes.
        codes: their C; names may repeat.
        directory: where sources and library are written.
        compiler: host compiler; the preferred one if None.
        flags: optimisation and other compiler flags.
        observe: record every node's value; False compiles the sources exactly as they are flashed.

    Raises:
        CheckError: the compiler refuses a source.
    """
    compiler = compiler or find_compiler()
    directory.mkdir(parents=True, exist_ok=True)
    runtime = directory / "runtime"
    runtime.mkdir(exist_ok=True)
    lines = []
    for number, code in enumerate(codes):
        folder = directory / str(number)
        folder.mkdir(exist_ok=True)
        texts = {code.header_name: code.header, code.source_name: code.source}
        for name, text in {**texts, HARNESS: code.harness}.items():
            (folder / name).write_text(text, encoding="utf-8")
        lines.append(include_renamed(code, number))
    files = list_runtime(*(text for code in codes for text in (code.header, code.source)))
    for name, text in files.items():
        (runtime / name).write_text(text, encoding="utf-8")
    together = directory / "together.c"
    together.write_text("\n".join(lines), encoding="utf-8")
    common = [*WARNINGS, *flags, "-fPIC", f"-I{runtime}"]
    if not observe:
        common.append("-DZD_PLAIN")
    # The loader takes a library for the one it has already loaded under the same name.
    digest = hashlib.sha256("\0".join([*(c.source for c in codes), *common]).encode()).hexdigest()
    library = directory / f"together_{digest[:16]}.so"
    arguments = [*common, "-shared", str(together), str(runtime / "zd_runtime.c")]
    compiler.run([*arguments, "-o", str(library)])
    return [
        HostModel.attach(model, code.prefix, library, _symbols(number), observe=observe)
        for number, (model, code) in enumerate(zip(models, codes, strict=True))
    ]


def include_renamed(code: GeneratedCode, number: int) -> str:
    """Return the lines of C that include a model's harness, its names made unlike any other's."""
    texts = (code.header, code.source, code.harness)
    macros = {name for text in texts for name in _MACRO.findall(text)}
    names = {name for text in texts for name in _DEFINED.findall(text)}
    names |= set(re.findall(rf"\b{re.escape(code.prefix)}_\w+", "\n".join(texts)))
    renamed = sorted(names - macros - {"", "in", "s", "out", "n", "k"})
    lines = [f"#define {name} {_symbols(number)}{name}" for name in renamed]
    lines.append(f'#include "{number}/{HARNESS}"')
    lines += [f"#undef {name}" for name in (*renamed, *sorted(macros))]
    return "\n".join(lines) + "\n"


def _symbols(number: int) -> str:
    return f"m{number}_"
