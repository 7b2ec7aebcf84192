"""Everything declared about an effect, as `effects --json` prints it and the page shows it."""

from collections.abc import Mapping
from dataclasses import dataclass

from zerodrift.physics.catalogue import Catalogue, load_catalogue
from zerodrift.physics.effect import Effect, Parameter

# The reference page of the effects, written from their declarations.
#
# python -m zerodrift.physics.description > docs/reference/effects.md

HEAD = """\
# The catalogue of effects

Written from the declarations in `physics/effects_*.py` by
`python -m zerodrift.physics.description`; a test fails when this page is older than they are.
In the terminal, with a picture: `zerodrift effects NAME`.

`LP(x, tau)` is x after a first-order low-pass, `play(x, r)` x with a slack of r to either side,
T the temperature that the element feels, T0 the logs' mean temperature in whole degrees. A
parameter written in the effect's table in `zerodrift.toml` is held at that value; one that is left
out is fitted, or has the default given here. A thermal effect takes another thermometer by
`signal = "NAME"`, NAME being one of `[inputs]`.

Effects that change the temperature which the others see act in this order, whatever the order in
the file: `clock_delay`, `thermal_lag`, `thermal_hysteresis`, then a user's own.
"""


def render_effects_page(catalogue: Catalogue) -> str:
    """Return the page as Markdown."""
    effects = catalogue.listed()
    rows = [
        f"| [`{effect.kind}`](#{effect.kind}) | {effect.title} | {_escape(effect.equation)} |"
        for effect in effects
    ]
    table = "\n".join(["| effect | term | model |", "|---|---|---|", *rows])
    sections = "\n\n".join(_render_effect(effect) for effect in effects)
    return f"{HEAD}\n{table}\n\n{sections}\n"


def _render_effect(effect: Effect) -> str:
    """Return one effect's section."""
    needs = ", ".join(
        f"one of {need.replace('|', ', ')}" if "|" in need else need for need in effect.needs
    )
    lines = [
        f"## {effect.kind}",
        "",
        f"{effect.title[0].upper()}{effect.title[1:]}. {effect.physics}",
        "",
        f"    {effect.equation}",
        "",
    ]
    if effect.parameters:
        lines += [
            "| parameter | unit | meaning | typical | allowed | left out |",
            "|---|---|---|---|---|---|",
            *(_render_parameter(parameter) for parameter in effect.parameters),
            "",
        ]
    lines += [
        f"- Needs: {needs}.",
        f"- Looks like: {effect.fingerprint}",
        f"- To provoke it: {effect.provoke}",
        f"- Cure in hardware: {effect.cure}",
        f"- Source: {effect.source}.",
    ]
    return "\n".join(lines)


def _render_parameter(parameter: Parameter) -> str:
    """Return one parameter's row."""
    if parameter.choices:
        typical, allowed = "", ", ".join(f"{choice:g}" for choice in parameter.choices)
    else:
        typical = " .. ".join(f"{value:g}" for value in parameter.typical)
        allowed = f"{parameter.lower:g} .. {parameter.upper:g}"
    left_out = "fitted" if parameter.default is None else f"{parameter.default:g}"
    when = ", ".join(f"{name} = {value:g}" for name, value in parameter.when.items())
    meaning = parameter.meaning + (f" (with {when})" if when else "")
    source = f"; {parameter.source}" if parameter.source else ""
    cells = (
        f"`{parameter.name}`",
        parameter.unit,
        meaning + source,
        typical,
        allowed,
        left_out,
    )
    return "| " + " | ".join(_escape(cell) for cell in cells) + " |"


def _escape(text: str) -> str:
    """Return text for a cell of a table."""
    return text.replace("|", "\\|")


if __name__ == "__main__":
    print(render_effects_page(load_catalogue()), end="")


# Everything declared about an effect, as `effects --json` prints it and the page shows it.


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
