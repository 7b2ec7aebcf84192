"""Writes the golden files again: `make golden`. Read the diff before committing it."""

from pathlib import Path

from tests.golden.models import C_CASE, CASES, make
from tests.golden.vectors import FOLDER

from zerodrift.codegen.generate import generate


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


def _write(path: Path, text: str) -> None:
    temporary = path.with_name(f".{path.name}.part")
    temporary.write_text(text, encoding="utf-8")
    temporary.replace(path)


if __name__ == "__main__":
    main()
