"""What each operation means, family by family; a module that is added here is found by itself."""

from collections.abc import Iterator
from importlib import import_module
from pkgutil import iter_modules

from zerodrift_proof.equality.node import Node

__all__ = ["KINDS", "find_operations"]


def _list_nodes() -> Iterator[type[Node]]:
    for module in iter_modules(__path__, f"{__name__}."):
        yield from import_module(module.name).NODES


KINDS: dict[str, type[Node]] = {}
"""Kind in the model's file -> what it means."""


def find_operations() -> None:
    """Fill KINDS with the operations that there are."""
    KINDS.update({node.kind: node for node in _list_nodes()})


find_operations()
