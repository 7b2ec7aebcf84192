"""Every module can be imported where the system is not Linux."""

import ast
import importlib
import os
import pkgutil
import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

import zerodrift

ROOT = Path(__file__).parents[2]
MODULES = {"fcntl", "grp", "pwd", "pty", "resource", "syslog", "termios", "tty"}
"""Not on Windows."""
SIGNALS = {
    *("SIGALRM", "SIGBUS", "SIGCHLD", "SIGCONT", "SIGHUP", "SIGKILL", "SIGPIPE", "SIGQUIT"),
    *("SIGSTOP", "SIGTSTP", "SIGUSR1", "SIGUSR2", "SIGPWR", "alarm", "setitimer", "pthread_kill"),
}
SYSTEM = {
    *("fork", "forkpty", "getuid", "geteuid", "getgid", "getpgid", "getsid", "killpg", "mkfifo"),
    *("nice", "setsid", "statvfs", "sysconf", "uname", "wait", "wait3", "wait4", "WNOHANG"),
    *("O_CLOEXEC", "O_DIRECTORY", "O_NOFOLLOW", "O_NONBLOCK", "O_TMPFILE", "chown", "fchmod"),
    *("getloadavg", "sched_getaffinity", "sched_setaffinity", "posix_fallocate", "pipe2"),
}
"""Of `os`: not on Windows, or not on macOS."""
NAMED = re.compile(rf"\b({'|'.join(MODULES | SIGNALS | SYSTEM)})\b")


def list_modules() -> list[str]:
    """Return the product's modules but those that are commands to be run."""
    found = [module.name for module in pkgutil.walk_packages(zerodrift.__path__, "zerodrift.")]
    return [name for name in found if not name.endswith("__main__")]


@pytest.mark.slow
def test_every_module_is_imported_where_posix_is_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    names = []
    for name in list_modules():
        try:
            importlib.import_module(name)  # what others wrote may ask for POSIX
            names.append(name)
        except ModuleNotFoundError as error:  # a library for one format of logs is not installed
            assert (error.name or "zerodrift").partition(".")[0] != "zerodrift"
    assert len(names) > 300
    own = {n: m for n, m in sys.modules.items() if n.partition(".")[0] == "zerodrift"}
    try:
        for name in own:
            del sys.modules[name]
        for name in MODULES:
            monkeypatch.setitem(sys.modules, name, None)
        for module, hidden in ((signal, SIGNALS), (os, SYSTEM)):
            for name in hidden:
                monkeypatch.delattr(module, name, raising=False)
        failed = {}
        for name in names:
            try:
                importlib.import_module(name)
            except (ImportError, AttributeError) as error:
                failed[name] = str(error)
        assert failed == {}
    finally:
        for name in [n for n in sys.modules if n.partition(".")[0] == "zerodrift"]:
            del sys.modules[name]
        sys.modules.update(own)


def walk_import(node: ast.AST) -> Iterator[ast.AST]:
    """Yield what runs when a module is imported: all but the bodies of functions."""
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda):
            yield from (part for given in child.args.defaults for part in ast.walk(given))
        else:
            yield child
            yield from walk_import(child)


def find_posix(text: str) -> set[str]:
    """Return the names that are missing elsewhere and that importing this text would need."""
    found: set[str] = set()
    if not NAMED.search(text):
        return found
    for node in walk_import(ast.parse(text)):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names} & MODULES
        elif isinstance(node, ast.ImportFrom):
            hidden = {"signal": SIGNALS, "os": SYSTEM}.get(node.module or "", set())
            found |= ({node.module or ""} & MODULES) | ({a.name for a in node.names} & hidden)
        elif isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
            hidden = {"signal": SIGNALS, "os": SYSTEM}.get(node.value.id, set())
            found |= {node.attr} & hidden
    return found


def test_nothing_of_posix_is_named_at_import() -> None:
    """The same by reading alone, which is quick."""
    files = subprocess.run(
        ["git", "ls-files", "*.py"], cwd=ROOT, capture_output=True, text=True, check=True
    ).stdout.split()
    product = [f for f in files if f.partition("/")[0] not in ("tests", "lab", ".ci")]
    assert len(product) > 300
    found = {f: find_posix((ROOT / f).read_text(encoding="utf-8")) for f in product}
    assert {f: names for f, names in found.items() if names} == {}


def test_search_finds_what_it_looks_for() -> None:
    assert find_posix("import fcntl") == {"fcntl"}
    assert find_posix("import signal\nEND = (signal.SIGINT, signal.SIGKILL)") == {"SIGKILL"}
    assert find_posix("from os import getuid") == {"getuid"}
    assert find_posix("import os\nclass A:\n    x = os.getuid()") == {"getuid"}
    assert find_posix("import os\ndef f():\n    import fcntl\n    return os.getuid()") == set()
