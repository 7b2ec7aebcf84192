"""A formula as a user's file of effects, which `add` takes."""

import json
import textwrap

from zerodrift.diagnosis.formula.expression import is_by_load, name_term, write_formula
from zerodrift.diagnosis.formula.proposal import Formula
from zerodrift.physics.effect import Parameter

WIDTH = 92


MARK = ": a formula that the logs propose."
"""End of the first line of each file that is written here."""


def is_proposed(text: str) -> bool:
    """Return whether a file's text came from `render_file`, as far as its first line tells."""
    return text.partition("\n")[0].endswith(MARK)


def render_file(formula: Formula) -> str:
    """Return the text of the file: the effect, named and commented."""
    effect, meaning = formula.effect, formula.meaning
    body, by_load = ["features = []"], ["for own, load in signals.load.items():"]
    for number, one in enumerate(formula.expressions, 1):
        name = name_term(number, len(formula.expressions))
        result = "x" if len(formula.expressions) == 1 else "xyz"[number - 1]
        code, unit = one.list_code(result), _quote(one.unit)
        if is_by_load(one):
            by_load += [f"    {line}" for line in code]
            by_load.append(
                f'    features.append(Feature(f"{name} {{own}}", {result}, {unit}, own))'
            )
        else:
            body += [*code, f"features.append(Feature({_quote(name)}, {result}, {unit}))"]
    body += [*(by_load if len(by_load) > 1 else []), "return features"]
    told = (
        f"Found by `zerodrift propose` in these logs, not taken from a book: {meaning.physics} "
        f"What would show it: {meaning.experiment}."
    )
    lines = [
        f'"""{effect.title[:1].upper()}{effect.title[1:]}{MARK}',
        "",
        *textwrap.wrap(told, WIDTH),
        "",
        f"    drift = {formula.write()}",
        "",
        "Each output has coefficients of its own; `zerodrift add` fits the numbers again.",
        '"""',
        "",
        "from zerodrift.physics.catalogue import register",
        "from zerodrift.physics.effect import Effect, Feature, Parameter",
        "",
        "",
        "def build(ops, signals, p):",
        f'    """Return the terms of {write_formula(formula.expressions)}."""',
        *(f"    {line}" for line in body),
        "",
        "",
        "register(",
        "    Effect(",
        f"        kind={_quote(effect.kind)},",
        f"        title={_quote(effect.title)},",
        "        build=build,",
        "        parameters=(",
        *(line for p in effect.parameters for line in _write_parameter(p, formula)),
        "        ),",
        f"        needs={_write_names(effect.needs)},",
        f"        equation={_quote(effect.equation)},",
        f"        physics={_quote(meaning.physics)},",
        f"        provoke={_quote(meaning.experiment[:1].upper() + meaning.experiment[1:] + '.')},",
        "    )",
        ")",
        "",
    ]
    return "\n".join(lines)


def _write_parameter(parameter: Parameter, formula: Formula) -> list[str]:
    """Return the declaration of a parameter, to be searched for around its value."""
    value = formula.values[parameter.name]
    fitted = formula.revision.term
    interval = fitted.intervals.get(parameter.name) if fitted is not None else None
    low, high = parameter.typical
    if not low <= value <= high:
        low, high = min(low, value), max(high, value)
    told = f"{value:.5g} {parameter.unit}"
    if interval is not None:
        told += f", between {interval[0]:.5g} and {interval[1]:.5g} with 95 %"
    return [
        f"            # found: {told}",
        f"            Parameter({_quote(parameter.name)}, {_quote(parameter.unit)}, "
        f"{_shorten(parameter.lower)}, {_shorten(parameter.upper)}, "
        f'({_shorten(low)}, {_shorten(high)}), scale="{parameter.scale}"),',
    ]


def _shorten(value: float) -> str:
    return repr(float(f"{value:.6g}"))


def _write_names(names: tuple[str, ...]) -> str:
    return f"({', '.join(_quote(name) for name in names)},)"


def _quote(text: str) -> str:
    return json.dumps(text, ensure_ascii=False)
