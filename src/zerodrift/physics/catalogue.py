"""The known effects: built-ins, entry points, a user's files; all registered in the same way."""

import importlib.machinery
import importlib.util
import sys
from collections.abc import Iterable
from pathlib import Path
from types import CodeType

from zerodrift.base.errors import InputError
from zerodrift.base.plugins import EFFECTS, list_points, tell_missing
from zerodrift.physics.effect import Catalogue, Effect, declare, register, registered

__all__ = ["Catalogue", "load_built_ins", "load_catalogue", "register"]

_left_out: set[str] = set()
"""Entry points that could not be loaded, which is said once."""


def load_catalogue(plugin_files: Iterable[Path] = ()) -> Catalogue:
    """Return the built-in effects, those of installed packages and those of the user's files.

    Args:
        plugin_files: the `[plugins] files` of zerodrift.toml.

    Raises:
        InputError: a file is missing, cannot be imported, or declares an unusable effect.
    """
    load_built_ins()
    for point in list_points(EFFECTS):
        where = f"entry point {point.value}"
        if where in _left_out or any(effect.file == where for effect in registered.values()):
            continue
        try:
            with declare(where, registered):
                point.load()
        except Exception as error:  # noqa: BLE001 - whatever a stranger's import raises
            _left_out.add(where)
            tell_missing(point, error)
    # A project's own effects are not shared: another project may use the same names.
    effects = dict(registered)
    for path in plugin_files:
        _load_file(path, effects)
    return Catalogue(effects)


def load_built_ins() -> None:
    """Import the modules that register the built-in effects, in the order in which they act."""
    from zerodrift.physics import (  # noqa: F401 - importing them registers their effects
        effects_element,
        effects_input,
        effects_load,
        effects_temperature,
        effects_time,
    )


class _SourceLoader(importlib.machinery.SourceFileLoader):
    """Compiles a file as it is now; no bytecode is left in the user's project or taken from it."""

    def get_code(self, fullname: str) -> CodeType:
        """Return the compiled text of the file."""
        path = self.get_filename(fullname)
        return self.source_to_code(self.get_data(path), path)


def _load_file(path: Path, effects: dict[str, Effect]) -> None:
    """Run a user's file and add what it declares to `effects`."""
    where = str(path)
    if not path.is_file():
        raise InputError(
            f"{path}: no such file, though [plugins] files names it; "
            "correct the name, relative to zerodrift.toml."
        )
    name = f"zerodrift_plugin_{path.stem}"
    if path.suffix != ".py":
        raise InputError(f"{path}: not a Python file; [plugins] files takes files ending in .py.")
    loader = _SourceLoader(name, where)
    spec = importlib.util.spec_from_loader(name, loader)
    assert spec is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    before = set(effects)
    with declare(where, effects):
        try:
            loader.exec_module(module)
        except (InputError, KeyboardInterrupt, MemoryError):
            raise
        except BaseException as error:  # a user's file may raise anything, SystemExit too
            line = line_in(error, where)
            raise InputError(
                f"{path}{line}: the file of effects raised {type(error).__name__}: {error}. "
                "Run it with python to see more."
            ) from error
    if set(effects) == before:
        raise InputError(
            f"{path}: declares no effect; call zerodrift.physics.catalogue.register(Effect(...))."
        )


def line_in(error: BaseException, where: str) -> str:
    """Return `:line` of the last place in file `where` that `error` passed, or nothing."""
    trace, line = error.__traceback__, ""
    if isinstance(error, SyntaxError) and error.lineno is not None:
        return f":{error.lineno}"
    while trace is not None:
        if trace.tb_frame.f_code.co_filename == where:
            line = f":{trace.tb_lineno}"
        trace = trace.tb_next
    return line
