"""Where effects are declared: built-ins, installed packages and users' files call `register`."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace

from zerodrift.base.errors import InputError, nearest
from zerodrift.physics.effect import Effect

READING_ORDER = (
    *("zero_tempco", "dark_current", "span_tempco", "thermal_lag", "thermal_gradient", "warm_up"),
    *("thermal_hysteresis", "creep", "load_hysteresis", "load_nonlinearity", "crosstalk"),
    *("supply_sensitivity", "excitation_heating", "humidity", "ambient_light"),
    *("barometric_pressure", "inertial_load", "turn_on_bias", "ageing"),
    *("clock_delay", "adc_saturation"),
)
"""The order of the catalogue for readers; that of the modules is the order of acting."""


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


registered: dict[str, Effect] = {}
"""Built-in effects and those of installed packages."""
_declaring: list[tuple[str, dict[str, Effect]]] = []
"""The file being loaded and where its effects go, innermost last."""


def register(effect: Effect) -> Effect:
    """Make an effect known; built-ins and users' files call the same function.

    Raises:
        InputError: the name is taken by another declaration, or the declaration is not usable.

    Example:
        >>> register(Effect("no name", "its kind is no plain name"))
        Traceback (most recent call last):
        zerodrift.base.errors.InputError: ...
    """
    where, known = _declaring[-1] if _declaring else (_find_origin(effect), registered)
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


def _find_origin(effect: Effect) -> str:
    """Return where an effect outside of a user's file stands: a module; empty for a built-in."""
    module = (effect.rewrite or effect.build).__module__
    return "" if module.partition(".")[0] == "zerodrift" else f"module {module}"


@contextmanager
def declare(where: str, known: dict[str, Effect]) -> Iterator[None]:
    """Within this context, `register` adds effects to `known`, noting where they stand."""
    _declaring.append((where, known))
    try:
        yield
    finally:
        _declaring.pop()


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
    for variant in effect.forms:
        for name in variant:
            effect.parameter(name)
