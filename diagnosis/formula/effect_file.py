"""A formula as a user's file of effects, which `add` takes."""

import json
import textwrap

from zerodrift.diagnosis.formula.expression import is_by_load
from zerodrift.diagnosis.formula.proposal import Formula
from zerodrift.physics.effect import Parameter

WIDTH = 92


def render_file(formula: Formula) -> str:
    """Return the text of the file: the effect, named and commented."""
    effect, expression, meaning = formula.effect, formula.expression, formula.meaning
    by_load = is_by_load(expression)
    feature = [f'Feature("formula", x, {_quote(expression.unit)})']
    if by_load:
        feature = [f'Feature(f"formula {{name}}", x, {_quote(expression.unit)}, name)']
    code = expression.list_code()
    if by_load:
        body = ["features = []", "for name, load in signals.load.items():"]
        body += [f"    {line}" for line in code]
        body += [f"    features.append({feature[0]})", "return features"]
    else:
        body = [*code, f"return [{feature[0]}]"]
    told = (
        f"Found by `zerodrift propose` in these logs, not taken from a book: {meaning.physics} "
        f"What would show it: {meaning.experiment}."
    )
    lines = [
        f'"""{effect.title[:1].upper()}{effect.title[1:]}: a formula that the logs propose.',
        "",
        *textwrap.wrap(told, WIDTH),
        "",
        f"    drift = k * {expression.write(formula.values)}",
        "",
        "Each output has a k of its own; the numbers below are fitted again by `zerodrift add`.",
        '"""',
        "",
        "from zerodrift.physics.catalogue import register",
        "from zerodrift.physics.effect import Effect, Feature, Parameter",
        "",
        "",
        "def build(ops, signals, p):",
        f'    """{expression.write()}"""',
        *(f"    {line}" for line in body),
        "",
        "",
        "register(",
        "    Effect(",
        f"        kind={_quote(effect.kind)},",
        f"        title={_quote(effect.title)},",
        "        build=build,",
        "        parameters=(",
        *(line for p in expression.parameters for line in _write_parameter(p, formula)),
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
