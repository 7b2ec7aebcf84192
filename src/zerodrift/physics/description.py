"""Everything declared about an effect, as `effects --json` prints it and the page shows it."""

from collections.abc import Mapping
from dataclasses import dataclass

from zerodrift.physics.effect import Effect


@dataclass(frozen=True)
class ParameterDescription:
    """What is declared about a parameter."""

    name: str
    unit: str
    meaning: str
    lower: float
    upper: float
    typical: tuple[float, ...]
    default: float | None
    choices: tuple[float, ...]
    source: str


@dataclass(frozen=True)
class EffectDescription:
    """What is declared about an effect."""

    kind: str
    title: str
    """The field's term."""
    needs: tuple[str, ...]
    """Signals of the chip."""
    equation: str
    physics: str
    fingerprint: str
    """What it looks like in the logs."""
    provoke: str
    """The experiment that shows it best."""
    cure: str
    """In hardware."""
    source: str
    file: str
    parameters: tuple[ParameterDescription, ...]


def describe_effect(effect: Effect) -> EffectDescription:
    """Return everything declared about an effect."""
    return EffectDescription(
        effect.kind,
        effect.title,
        tuple(effect.needs),
        effect.equation,
        effect.physics,
        effect.fingerprint,
        effect.provoke,
        effect.cure,
        effect.source,
        effect.file,
        tuple(
            ParameterDescription(
                p.name,
                p.unit,
                p.meaning,
                p.lower,
                p.upper,
                tuple(p.typical),
                p.default,
                tuple(p.choices),
                p.source,
            )
            for p in effect.parameters
        ),
    )


def write_values(effect: Effect, values: Mapping[str, float]) -> str:
    """Return fitted values with their units."""
    return ", ".join(
        f"{name} {value:.4g} {_write_unit(effect.parameter(name).unit)}".rstrip()
        for name, value in values.items()
    )


def _write_unit(unit: str) -> str:
    """Return a unit for print; plain numbers have none."""
    return "" if unit == "1" else unit
