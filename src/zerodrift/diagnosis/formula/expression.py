"""A formula as a tree of the chip's operations: computed, written for a reader, and as code."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

from zerodrift.operations.backend import Operations
from zerodrift.physics.effect import Effect, Feature, Parameter, S, Signals, Values

OWN_LOAD = "own load"
"""The source that is each output's own load."""


@dataclass(frozen=True)
class Driver:
    """A signal that a formula may begin from."""

    kind: str
    """temperature | load | input | time"""
    name: str
    """As the formula writes it; of a load the output's name, of an input the input's."""
    unit: str
    low: float
    """The 2 % quantile of its values in the runs."""
    middle: float
    high: float
    """The 98 % quantile."""

    @property
    def span(self) -> float:
        """How far it moves."""
        return self.high - self.low

    @property
    def need(self) -> str:
        """What an effect has to say that it needs."""
        if self.kind == "input":
            return self.name
        return {"elapsed": "elapsed", "clock": "clock"}.get(self.name, self.kind)

    @property
    def text(self) -> str:
        """How a formula writes it."""
        if self.kind == "load":
            return "load" if self.name == OWN_LOAD else f"load_{self.name}"
        return self.name

    @property
    def code(self) -> str:
        """The signal in an effect's file."""
        if self.kind == "temperature":
            return "signals.temperature_degC"
        if self.kind == "time":
            return f"signals.{self.name}_s"
        if self.name == OWN_LOAD:
            return "load"
        return f'signals.{"load" if self.kind == "load" else "channels"}["{self.name}"]'

    def read(self, signals: Signals[S], own: str | None) -> S:
        """Return the signal; `own` is the output whose load `OWN_LOAD` is."""
        if self.kind == "temperature":
            return signals.temperature_degC
        if self.kind == "time":
            return signals.clock_s if self.name == "clock" else signals.elapsed_s
        if self.kind == "load":
            return signals.load[own if self.name == OWN_LOAD and own else self.name]
        return signals.channels[self.name]


@dataclass(frozen=True)
class Expression:
    """One operation on others, or a source.

    `op` is "source", or one of: lowpass, delay, play, power, exp2, shift (x less an origin), above
    (the larger of x and a number), below, size (the absolute value), product, difference, larger,
    smaller.
    """

    op: str
    inputs: tuple["Expression", ...] = ()
    source: Driver | None = None
    parameter: Parameter | None = None
    """The number of this operation that is fitted."""
    number: float = 0.0
    """A number that is not fitted: an exponent, or the sign of exp2's argument."""

    def walk(self) -> Iterator["Expression"]:
        """Yield this expression and all below it, inputs first, each once."""
        seen: list[Expression] = []
        for below in self.inputs:
            for one in below.walk():
                if one not in seen:
                    seen.append(one)
                    yield one
        yield self

    @property
    def sources(self) -> tuple[Driver, ...]:
        """The signals, each once."""
        found = [one.source for one in self.walk() if one.source is not None]
        return tuple(dict.fromkeys(found))

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The fitted numbers, each once."""
        found = {one.parameter.name: one.parameter for one in self.walk() if one.parameter}
        return tuple(found.values())

    @property
    def complexity(self) -> int:
        """Operations and fitted numbers; a shift of the origin is half an operation."""
        operations = sum(one.op not in ("source", "shift") for one in self.walk())
        return 2 * operations + len(self.parameters)

    @property
    def unit(self) -> str:
        """The unit of its values, as text."""
        match self.op:
            case "source":
                assert self.source is not None
                return self.source.unit
            case "exp2":
                return "1"
            case "power":
                return _raise(self.inputs[0].unit, self.number)
            case "product":
                return " x ".join(one.unit for one in self.inputs)
        return self.inputs[0].unit

    def build(self, ops: Operations[S], signals: Signals[S], p: Values, own: str | None) -> S:
        """Return the signal, by an effect's operations."""
        if self.source is not None:
            return self.source.read(signals, own)
        return self.apply(ops, [one.build(ops, signals, p, own) for one in self.inputs], p)

    def apply(self, ops: Operations[S], values: Sequence[S], p: Values) -> S:
        """Return what this operation makes of its inputs' signals."""
        number = p[self.parameter.name] if self.parameter else self.number
        x = values[0]
        match self.op:
            case "lowpass":
                return ops.lowpass(x, number)
            case "delay":
                return ops.delay(x, number)
            case "play":
                return ops.play(x, number)
            case "power":
                return ops.power(x, number)
            case "exp2":
                return ops.exp2(ops.affine(x, self.number / number, 0.0))
            case "shift":
                return ops.affine(x, 1.0, -number)
            case "above":
                return ops.maximum(x, ops.constant(number))
            case "below":
                return ops.minimum(x, ops.constant(number))
            case "size":
                return ops.maximum(x, ops.affine(x, -1.0, 0.0))
            case "product":
                return ops.product(*values)
            case "difference":
                return ops.difference(*values)
            case "larger":
                return ops.maximum(*values)
            case "smaller":
                return ops.minimum(*values)
        raise ValueError(self.op)

    def write(self, values: Values | None = None) -> str:
        """Return the formula as a physicist reads it; without values the numbers are names."""
        texts = [one.write(values) for one in self.inputs]
        x = texts[0] if texts else ""
        number = self._write_number(values)
        match self.op:
            case "source":
                assert self.source is not None
                return self.source.text
            case "lowpass":
                return f"LP({_bare(x)}, {number})"
            case "delay":
                return f"delay({_bare(x)}, {number})"
            case "play":
                return f"play({_bare(x)}, {number})"
            case "power":
                root = f"{self.number:g}"
                return f"sqrt({_bare(x)})" if root == "0.5" else f"{x}^{root}"
            case "exp2":
                return f"2^({'-' if self.number < 0 else ''}{x} / {number})"
            case "shift":
                return f"({x} - {number})"
            case "above" | "larger":
                return f"max({_bare(x)}, {_bare(texts[1]) if self.op == 'larger' else number})"
            case "below" | "smaller":
                return f"min({_bare(x)}, {_bare(texts[1]) if self.op == 'smaller' else number})"
            case "size":
                return f"|{_bare(x)}|"
            case "product":
                return " * ".join(texts)
            case "difference":
                return f"({x} - {texts[1]})"
        raise ValueError(self.op)

    def _write_number(self, values: Values | None) -> str:
        if self.parameter is None:
            return f"{self.number:g}"
        if values is None:
            return self.parameter.name
        unit = "" if self.parameter.unit == "1" else f" {self.parameter.unit}"
        value = f"{values[self.parameter.name]:.3g}"
        return f"{float(value):g}{unit}"

    def list_code(self, result: str = "x") -> list[str]:
        """Return the lines of a `build` function that compute it; the last one's name is given."""
        names: dict[str, str] = {}
        lines: list[str] = []
        steps = [one for one in self.walk() if one.op != "source"]
        for step in self.walk():
            if step.op == "source":
                assert step.source is not None
                names[step.write()] = step.source.code
                continue
            name = result if step is steps[-1] else f"{result}{len(lines) + 1}"
            lines.append(f"{name} = {step.write_call([names[one.write()] for one in step.inputs])}")
            names[step.write()] = name
        return lines or [f"{result} = {names[self.write()]}"]

    def write_call(self, arguments: Sequence[str]) -> str:
        """Return the call of `ops` that this operation is, its inputs given as code."""
        number = f'p["{self.parameter.name}"]' if self.parameter else f"{self.number!r}"
        x = arguments[0]
        match self.op:
            case "lowpass" | "delay" | "play" | "power":
                return f"ops.{self.op}({x}, {number})"
            case "exp2":
                return f"ops.exp2(ops.affine({x}, {self.number!r} / {number}, 0.0))"
            case "shift":
                return f"ops.affine({x}, 1.0, -{number})"
            case "above":
                return f"ops.maximum({x}, ops.constant({number}))"
            case "below":
                return f"ops.minimum({x}, ops.constant({number}))"
            case "size":
                return f"ops.maximum({x}, ops.affine({x}, -1.0, 0.0))"
        name = {"larger": "maximum", "smaller": "minimum"}.get(self.op, self.op)
        return f"ops.{name}({', '.join(arguments)})"


def make_effect(kind: str, title: str, expressions: Sequence[Expression]) -> Effect:
    """Return a sum of terms as an effect, fitted and judged as those of the catalogue are."""

    def build(ops: Operations[S], signals: Signals[S], p: Mapping[str, float]) -> list[Feature[S]]:
        features: list[Feature[S]] = []
        for number, one in enumerate(expressions, 1):
            name = name_term(number, len(expressions))
            if is_by_load(one):
                features += [
                    Feature(f"{name} {own}", one.build(ops, signals, p, own), one.unit, own)
                    for own in signals.load
                ]
            else:
                features.append(Feature(name, one.build(ops, signals, p, None), one.unit))
        return features

    return Effect(
        kind=kind,
        title=title,
        build=build,
        parameters=tuple(p for one in expressions for p in one.parameters),
        needs=tuple(dict.fromkeys(d.need for one in expressions for d in one.sources)),
        equation=f"drift = {write_formula(expressions)}",
    )


def name_term(number: int, of: int) -> str:
    """Return the name of a term's feature, whose coefficient is k, or k1, k2, ..."""
    return "k" if of == 1 else f"k{number}"


def write_formula(expressions: Sequence[Expression], values: Values | None = None) -> str:
    """Return a sum of terms, each with its coefficient."""
    return " + ".join(
        f"{name_term(number, len(expressions))} * {one.write(values)}"
        for number, one in enumerate(expressions, 1)
    )


def rename(expression: Expression, suffix: str) -> Expression:
    """Return the expression with a suffix to the names of its numbers, before the unit."""
    parameter = expression.parameter
    if parameter is not None:
        stem = parameter.name.removesuffix("_s")
        unit = parameter.name[len(stem) :]
        parameter = replace(parameter, name=f"{stem}{suffix}{unit}")
    inputs = tuple(rename(one, suffix) for one in expression.inputs)
    return replace(expression, inputs=inputs, parameter=parameter)


def is_by_load(expression: Expression) -> bool:
    """Return whether each output sees it with its own load."""
    return any(source.name == OWN_LOAD for source in expression.sources)


def _raise(unit: str, exponent: float) -> str:
    return f"{unit}^{exponent:g}"


def _bare(text: str) -> str:
    """Return a text without the brackets around all of it."""
    if not (text.startswith("(") and text.endswith(")")):
        return text
    depth = 0
    for place, letter in enumerate(text):
        depth += (letter == "(") - (letter == ")")
        if depth == 0 and place < len(text) - 1:
            return text
    return text[1:-1]
