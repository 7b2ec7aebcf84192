"""Counts what the types do not see: `python -m tests.house.counts` lists every place.

*String subscripts* are values read by a key that is written out, `told["rmse"]`: a field of a
record has a name that the type checker knows. *Any* is an annotation that says nothing.
"""

import ast
import sys
from dataclasses import dataclass
from fnmatch import fnmatch
from functools import cache
from pathlib import Path

from tests.house.test_order import FOLDERS

C_NAMES = ("TYPES", "tables", "fields", "numbers", "known", "defined", "_limits", "pending")
NAMED = (
    ("match", "*", "groups of a regular expression"),
    ("environ", "*", "variables of the environment"),
    (
        "p",
        "src/zerodrift/physics/effects_*",
        "parameters by the names under which an effect declares them",
    ),
    ("channels", "src/zerodrift/physics/*", "a chip's inputs by the names that effects ask for"),
    ("inputs", "src/zerodrift/physics/*", "a chip's inputs by the names that effects ask for"),
    (
        "state",
        "src/zerodrift/operations/*",
        "arrays by the names under which an operation declares them",
    ),
    ("state", "export/*", "arrays by the names under which an operation declares them"),
    ("values", "src/zerodrift/base/*config.py", "keys of a table of zerodrift.toml"),
    ("_NEEDED", "src/zerodrift/base/*config.py", "words for a value of zerodrift.toml"),
    ("__dict__", "codegen/generate.py", "attributes of a class by their names"),
    ("parts", "src/zerodrift/base/toml_edit.py", "groups of a regular expression"),
    ("parts", "export/golden.py", "arrays by their names in golden.npz"),
    ("attributes", "export/onnx_*", "attributes of an ONNX node, by ONNX's own names"),
    ("weights", "train/onnx_export.py", "weights of an ONNX file, by their names in it"),
    (
        "parameters",
        "train/networks.py",
        "weights by the names under which a network is trained",
    ),
    ("trace", "src/zerodrift/verify/chip_error.py", "arrays by the names of a graph's nodes"),
    ("known", "src/zerodrift/verify/chip_error.py", "arrays by the names of a graph's nodes"),
    ("values", "export/fine_tune.py", "arrays by the names of a graph's nodes"),
    ("intervals", "export/quantize_layers.py", "intervals by the names of a graph's nodes"),
    ("nodes", "*", "arrays by the names of a graph's nodes, and of their states"),
    ("stored", "train/*", "arrays by their names in a checkpoint"),
    ("arrays", "train/*", "arrays by their names in a checkpoint"),
    (
        "found",
        "src/zerodrift/dataset/survey.py",
        "columns of a query, by the names that it gives them",
    ),
    ("page", "src/zerodrift/workbench/app.py", "parts of the page by their id"),
    ("_symbols", "c_runtime/emulator.py", "names that stand in the C under test"),
    ("_objects", "c_runtime/emulator.py", "names that stand in the C under test"),
    ("tables", "proof/zerodrift_proof/bound/check.py", "tables of the C under test"),
    *(
        (name, "proof/zerodrift_proof/certificate/*", "names that stand in the C under test")
        for name in C_NAMES
    ),
)
"""What a key may be written out for, and where: names declared elsewhere, none of a result."""
EDGES = {
    "src/zerodrift/dataset/formats/*": "readers of other programs' logs",
    "c_runtime/footprint.py": "pyelftools hands out an ELF file by the format's own names",
    "c_runtime/emulator.py": "the same",
    "train/attempts.py": "the reader of checkpoints, which yields where each attempt stood",
    "export/model_files.py": "the reader of model.json, which yields the nodes as dataclasses",
    "src/zerodrift/verify/trial_child.py": "a process of its own reads its job",
    "proof/zerodrift_proof/certificate/check.py": "reads certificate.json by itself",
    "proof/zerodrift_proof/bound/signals.py": "the same",
    "proof/zerodrift_proof/bound/conversion.py": "the same",
}
"""Modules that turn what another program wrote into records."""

PROOF = "proof/zerodrift_proof"
"""A distribution of its own, whose rooms share nothing: a name of a class is its room's."""
KEPT_ANY = {
    "export/onnx_reader.py": "attributes of an ONNX node, which onnx hands out as any of ten types",
    "export/onnx_values.py": "the same, and the arrays of its tensors",
    "src/zerodrift/operations/gru/onnx.py": "the same",
    "train/onnx_export.py": "arrays of the tensors of an ONNX file",
}
"""Where `Any` is left, and what for."""

ROOT = Path(__file__).resolve().parents[2]


@dataclass(frozen=True)
class Place:
    """A line of the product."""

    file: str
    line: int
    text: str


@cache
def list_trees() -> list[tuple[Path, str, ast.Module]]:
    """Return every module of the product and of its checkers, its text and its syntax tree."""
    folders = (*FOLDERS.values(), ROOT / PROOF)
    texts = {p: p.read_text("utf-8") for folder in folders for p in sorted(folder.rglob("*.py"))}
    return [(path, text, ast.parse(text)) for path, text in texts.items()]


def list_subscripts() -> list[Place]:
    """Return every value that is read by a key that is written out."""
    return [
        _place(path, text, node)
        for path, text, tree in list_trees()
        for node in ast.walk(tree)
        if isinstance(node, ast.Subscript)
        and isinstance(node.ctx, ast.Load)
        and isinstance(node.slice, ast.Constant)
        and isinstance(node.slice.value, str)
        and not _is_annotation(node)
        and not _is_named(_name_receiver(node), path)
        and not any(fnmatch(str(path.relative_to(ROOT)), edge) for edge in EDGES)
    ]


def list_any() -> list[Place]:
    """Return every use of `Any`, imports apart, within quoted annotations too."""
    return [
        _place(path, text, node)
        for path, text, tree in list_trees()
        for node in ast.walk(tree)
        if (isinstance(node, ast.Name) and node.id == "Any")
        or (isinstance(node, ast.Attribute) and node.attr == "Any")
    ]


def list_classes() -> dict[str, list[str]]:
    """Return the modules in which each name of a class stands; the checkers' by their room."""
    found: dict[str, list[str]] = {}
    for path, _, tree in list_trees():
        for node in ast.walk(tree):
            if isinstance(node, ast.ClassDef):
                file = str(path.relative_to(ROOT))
                room = path.relative_to(ROOT / PROOF).parts[0] if PROOF in file else ""
                name = f"{room}: {node.name}" if room else node.name
                found.setdefault(name, []).append(file)
    return found


def _is_annotation(node: ast.Subscript) -> bool:
    """Return whether the key is a quoted type, as in `list["Run"]`."""
    return isinstance(node.value, ast.Name) and node.value.id in (
        *("list", "dict", "tuple", "type", "set", "frozenset", "Mapping", "Sequence", "Iterator"),
        *("Callable", "Iterable", "Literal"),
    )


def _name_receiver(node: ast.Subscript) -> str:
    """Return what is subscripted: `x` of `x["key"]` and of `self.x["key"]`."""
    inner = node.value
    if isinstance(inner, ast.Subscript):
        inner = inner.value
    if isinstance(inner, ast.Name):
        return inner.id
    return inner.attr if isinstance(inner, ast.Attribute) else ""


def _is_named(receiver: str, path: Path) -> bool:
    file = str(path.relative_to(ROOT))
    return any(receiver == name and fnmatch(file, where) for name, where, _ in NAMED)


def _place(path: Path, text: str, node: ast.expr) -> Place:
    line = text.splitlines()[node.lineno - 1].strip()
    return Place(str(path.relative_to(ROOT)), node.lineno, line)


def main() -> None:
    """Print every place, or the number of each with `--short`."""
    for title, places in (("string subscripts", list_subscripts()), ("Any", list_any())):
        if "--short" not in sys.argv:
            for place in places:
                print(f"{place.file}:{place.line}: {place.text}")
        print(f"{title}: {len(places)}")


if __name__ == "__main__":
    main()
