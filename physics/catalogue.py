"""The effects that are known: built-ins, entry points, a user's files; all registered alike."""

import importlib.machinery
import importlib.util
import sys
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from importlib.metadata import entry_points
from pathlib import Path
from types import CodeType

from zerodrift.base.errors import InputError, nearest
from zerodrift.physics.effect import Effect

READING_ORDER = (
    *("zero_tempco", "dark_current", "span_tempco", "thermal_lag", "thermal_gradient", "warm_up"),
    *("thermal_hysteresis", "creep", "load_hysteresis", "load_nonlinearity", "crosstalk"),
    *("supply_sensitivity", "humidity", "ambient_light", "inertial_load", "ageing"),
    *("clock_delay", "adc_saturation"),
)
"""The order of the catalogue for readers; that of the modules is the order of acting."""
ENTRY_POINT_GROUP = "zerodrift.effects"


@dataclass(frozen=True)
class Catalogue(Mapping[str, Effect]):
    """Effects by name, in the order in which rewriting effects act on the signals."""

    effects: Mapping[str, Effect] = field(default_factory=dict)

    def __getitem__(self, kind: str) -> Effect:
        if kind not in self.effects:
            raise InputError(
                f"no effect '{kind}'{nearest(kind, self.effects) or '.'} "
                f"The catalogue has: {', '.join(self.effects)}."
            )
        return self.effects[kind]

    def __iter__(self) -> Iterator[str]:
        return iter(self.effects)

    def __len__(self) -> int:
        return len(self.effects)

    def __contains__(self, kind: object) -> bool:
        return kind in self.effects

    def listed(self) -> list[Effect]:
        """Return the effects in the order in which people look for them, a user's own last."""
        known = [self.effects[kind] for kind in READING_ORDER if kind in self.effects]
        return known + [e for kind, e in self.effects.items() if kind not in READING_ORDER]


_registered: dict[str, Effect] = {}
"""Built-in effects and those of installed packages."""
_declaring: list[tuple[str, dict[str, Effect]]] = []
"""The file being loaded and where its effects go, innermost last."""


def register(effect: Effect) -> Effect:
    """Make an effect known; built-ins and users' files call the same function.

    Raises:
        InputError: the name is taken by another declaration, or the declaration is not usable.
    """
    where, known = _declaring[-1] if _declaring else ("", _registered)
    effect = replace(effect, file=where)
    _check_declaration(effect)
    other = known.get(effect.kind)
    if other is not None and other.file != where:
        raise InputError(
            f"{where or 'built-in'}: effect '{effect.kind}' is already declared in "
            f"{other.file or 'the built-in catalogue'}; give it another name."
        )
    known[effect.kind] = effect
    return effect


def load_catalogue(plugin_files: Iterable[Path] = ()) -> Catalogue:
    """Return the built-in effects, those of installed packages and those of the user's files.

    Args:
        plugin_files: the `[plugins] files` of zerodrift.toml.

    Raises:
        InputError: a file is missing, cannot be imported, or declares an unusable effect.
    """
    load_built_ins()
    for entry_point in entry_points(group=ENTRY_POINT_GROUP):
        where = f"entry point {entry_point.value}"
        if not any(effect.file == where for effect in _registered.values()):
            with _declare(where, _registered):
                entry_point.load()
    # A project's own effects are its own: another project may use the same names.
    effects = dict(_registered)
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


@contextmanager
def _declare(where: str, known: dict[str, Effect]) -> Iterator[None]:
    """Within this context, `register` adds effects to `known`, noting where they stand."""
    _declaring.append((where, known))
    try:
        yield
    finally:
        _declaring.pop()


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
    with _declare(where, effects):
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


def _check_declaration(effect: Effect) -> None:
    """Refuse a declaration that could not be fitted, saying why."""
    where = f"{effect.file or 'built-in'}: effect '{effect.kind}'"
    if not effect.kind.isidentifier():
        raise InputError(f"{where}: the kind must be a plain name such as 'led_ageing'.")
    for parameter in effect.parameters:
        low, high = parameter.typical
        if not parameter.lower <= low <= high <= parameter.upper:
            raise InputError(
                f"{where}: parameter '{parameter.name}' has bounds {parameter.lower:g} .. "
                f"{parameter.upper:g} and typical range {low:g} .. {high:g}; "
                "expected lower <= typical <= upper."
            )
        if parameter.scale not in ("log", "linear"):
            raise InputError(
                f"{where}: parameter '{parameter.name}' has scale '{parameter.scale}'; "
                "expected log or linear."
            )
        if parameter.scale == "log" and parameter.lower <= 0 and not parameter.choices:
            raise InputError(
                f"{where}: parameter '{parameter.name}' is searched on a log scale, so its lower "
                f"bound must be above 0; it is {parameter.lower:g}."
            )
    for variant in effect.variants:
        for name in variant:
            effect.parameter(name)
