"""Writes the golden files again: `make golden`. Read the diff before committing it."""

import re
from pathlib import Path

from tests.golden.models import C_CASE, CASES, make
from tests.golden.vectors import FOLDER

from zerodrift.c_runtime.compilers import RUNTIME_FILES
from zerodrift.codegen.generate import generate
from zerodrift.export.integer_model import FORMAT
from zerodrift_proof import known_runtime


def main() -> None:
    """Write models, vectors and the one generated C into this folder."""
    for name in CASES:
        golden = make(name)
        golden.model.save(FOLDER / f"{name}.model.json")
        _write(FOLDER / f"{name}.vectors.json", golden.to_text())
        if name == C_CASE:
            code = generate(golden.model)
            _write(FOLDER / code.header_name, code.header)
            _write(FOLDER / code.source_name, code.source)
    write_known_runtime()


def write_known_runtime() -> None:
    """Let the certificate's checker know the runtime as it is now."""
    texts = {path.name: path.read_text(encoding="utf-8") for path in RUNTIME_FILES}
    file = Path(known_runtime.__file__).resolve()
    hashes = known_runtime.hash_runtime(texts).items()
    lines = "".join(f'        "{name}": "{digest}",\n' for name, digest in hashes)
    begin = "CURRENT: tuple[int, Mapping[str, str]] = "
    block = f"{begin}(\n    {FORMAT},\n    {{\n{lines}    }},\n)\n"
    pattern = rf"^{re.escape(begin)}\(\n.*?^\)\n"
    _write(file, re.sub(pattern, block, file.read_text(encoding="utf-8"), flags=re.M | re.S))


def _write(path: Path, text: str) -> None:
    temporary = path.with_name(f".{path.name}.part")
    temporary.write_text(text, encoding="utf-8")
    temporary.replace(path)


if __name__ == "__main__":
    main()
