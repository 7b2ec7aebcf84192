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

for _found in iter_modules(operations.__path__):
    if _found.ispkg:
        _module = import_module(f"{operations.__name__}.{_found.name}")
        if hasattr(_module, "OPERATION"):
            OPERATIONS[_module.OPERATION.name] = _module.OPERATION
        for _node in getattr(_module, "NODES", ()):
            NODE_CLASSES[_node.kind] = _node
            FOLDERS[_node.kind] = _found.name
        FILTERS |= getattr(_module, "FILTERS", {})
