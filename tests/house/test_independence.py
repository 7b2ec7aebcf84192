"""The certificate's checker and the proof share no code that reads C or runs it."""

import pytest
from tests.house.test_order import MODULES, list_imports

APART = {
    "zerodrift.verify.c_": ("zerodrift.verify.prove_", "zerodrift.verify.object_"),
    "zerodrift.verify.bound_": ("zerodrift.verify.prove_", "zerodrift.verify.object_"),
    "zerodrift.verify.prove_": ("zerodrift.verify.c_", "zerodrift.verify.bound_"),
    "zerodrift.verify.object_": ("zerodrift.verify.c_", "zerodrift.verify.bound_"),
}
"""Modules whose names begin so -> those that they must not reach."""


def reach(name: str) -> set[str]:
    """Return a module and all of zerodrift that it imports, directly or not, commands apart."""
    found, open_ = set(), {name}
    while open_:
        one = open_.pop()
        found.add(one)
        open_ |= {n for n, _ in list_imports(MODULES[one]) if n in MODULES} - found
    return found


@pytest.mark.parametrize("begin", APART)
def test_each_reads_c_by_its_own_code(begin: str) -> None:
    modules = [name for name in MODULES if name.startswith(begin)]
    assert modules
    for name in modules:
        others = sorted(n for n in reach(name) if n.startswith(APART[begin]))
        assert not others, f"{name} reaches {others}"
