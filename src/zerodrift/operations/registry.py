"""All operations, found by their folders: each names its `OPERATION`, its `NODES`, or both."""

from collections.abc import Callable
from importlib import import_module
from pkgutil import iter_modules

from zerodrift import operations
from zerodrift.operations.node import IntegerNode
from zerodrift.operations.operation import Operation

OPERATIONS: dict[str, Operation] = {}
"""What effects are written with, by name."""
NODE_CLASSES: dict[str, type[IntegerNode]] = {}
"""What integer models are made of, by kind."""
FOLDERS: dict[str, str] = {}
"""Kind of integer node -> its folder's name."""
FILTERS: dict[str, Callable[..., object]] = {}
"""What the operations' C templates call, by name."""


def find_operations() -> None:
    """Enter every folder of operations."""
    for found in iter_modules(operations.__path__):
        if found.ispkg:
            module = import_module(f"{operations.__name__}.{found.name}")
            if hasattr(module, "OPERATION"):
                OPERATIONS[module.OPERATION.name] = module.OPERATION
            for node in getattr(module, "NODES", ()):
                NODE_CLASSES[node.kind] = node
                FOLDERS[node.kind] = found.name
            FILTERS.update(getattr(module, "FILTERS", {}))


find_operations()
