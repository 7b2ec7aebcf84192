"""Effects with their values, combined to the columns of the linear model."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import ParamSpec, TypeVar

import numpy as np

from zerodrift.base.arrays import Array
from zerodrift.base.config import EffectConfig
from zerodrift.base.errors import InputError, nearest
from zerodrift.operations.backend import NumpyOperations, Operations
from zerodrift.physics.catalogue import Catalogue, line_in
from zerodrift.physics.effect import Arrivals, Effect, Feature, Parameter, S, Signals

P = ParamSpec("P")
T = TypeVar("T")


OFFSET = "offset"
"""Name of the constant column, always the first."""
CHIP = ""
"""The chip's own thermometer, among those that `signal` chooses from."""


@dataclass(frozen=True)
class Term:
    """One effect of a model with a value for each of its parameters."""

    effect: Effect
    values: Mapping[str, float]
    held: frozenset[str] = frozenset()
    """Parameters the user wrote: not fitted."""
    signal: str = CHIP
    """Another thermometer than the chip's."""
    arrivals: Arrivals = ()
    """Of an effect that remembers: what the training runs began with."""

    @property
    def name(self) -> str:
        """The kind, with the thermometer where it is not the chip's."""
        return f"{self.effect.kind}[{self.signal}]" if self.signal else self.effect.kind

    @property
    def free(self) -> tuple[Parameter, ...]:
        """Parameters that are fitted."""
        return tuple(
            p
            for p in self.effect.parameters
            if p.default is None
            and p.name not in self.held
            and all(self.values[name] == value for name, value in p.when.items())
        )

    def with_values(self, values: Mapping[str, float]) -> "Term":
        """Return the term with some values replaced."""
        return replace(self, values={**self.values, **values})


def begin_at_rest(terms: Sequence[Term]) -> list[Term]:
    """Return the terms as they predict: a chip does not know what was before its first sample."""
    return [replace(term, arrivals=()) for term in terms]


def tidy_terms(terms: Sequence[Term]) -> list[Term]:
    """Return the terms with their values as people write them, where nothing was held."""
    tidied = []
    for term in terms:
        if term.effect.tidy is None or any(
            p.name in term.held for p in term.effect.parameters if p.default is None
        ):
            tidied.append(term)
            continue
        values = term.effect.tidy(term.values)
        inside = all(p.lower <= values[p.name] <= p.upper for p in term.free)
        tidied.append(term.with_values(values) if inside else term)
    return tidied


def list_defaults(effect: Effect) -> dict[str, float]:
    """Return the default values of an effect's choices."""
    return {p.name: p.default for p in effect.parameters if p.default is not None}


def start_term(
    catalogue: Catalogue, config: EffectConfig, choices: Mapping[str, float] | None = None
) -> Term:
    """Return an effect of the user's model at its starting values.

    Args:
        catalogue: the known effects.
        config: the `[[effect]]` table.
        choices: values of choices that the user left open.

    Raises:
        InputError: unknown effect, parameter or option, or a held value out of bounds.
    """
    where = f"zerodrift.toml:{config.line}: " if config.line else ""
    try:
        effect = catalogue[config.kind]
    except InputError as error:
        raise InputError(f"{where}{error}") from error
    values: dict[str, float] = {}
    for parameter in effect.parameters:
        low, high = parameter.typical
        if parameter.default is not None:
            values[parameter.name] = parameter.default
        elif parameter.scale == "log":
            values[parameter.name] = float(np.sqrt(low * high))
        else:
            # Off the middle, where a range on both sides of zero would start with no effect at all.
            values[parameter.name] = 0.3 * low + 0.7 * high
    values.update(effect.variants[0])
    values.update(choices or {})
    for name, value in config.held.items():
        try:
            parameter = effect.parameter(name)
        except InputError as error:
            raise InputError(f"{where}{error}") from error
        _check_value(where, effect, parameter, value)
        values[name] = float(value)
    for option in config.options:
        if option != "signal" or not effect.is_thermal:
            known = ["signal"] if effect.is_thermal else []
            raise InputError(
                f"{where}effect '{effect.kind}' has no option '{option}'"
                f"{nearest(option, known) or '.'} "
                f"It has: {', '.join(known) or 'none'}; its parameters are "
                f"{', '.join(p.name for p in effect.parameters) or 'none'}."
            )
    return Term(
        effect,
        values,
        frozenset(config.held) | frozenset(choices or {}),
        config.options.get("signal", CHIP),
    )


def _check_value(where: str, effect: Effect, parameter: Parameter, value: float) -> None:
    """Refuse a held value that the effect cannot have."""
    place = f"{where}effect '{effect.kind}': {parameter.name} = {value:g}"
    if parameter.choices and value not in parameter.choices:
        allowed = ", ".join(f"{choice:g}" for choice in parameter.choices)
        raise InputError(f"{place}; expected one of {allowed}.")
    if not parameter.lower <= value <= parameter.upper:
        raise InputError(
            f"{place} {parameter.unit}; expected {parameter.lower:g} .. {parameter.upper:g}."
        )


def build_features(
    ops: Operations[S], signals: Signals[S], terms: Sequence[Term], catalogue_order: Sequence[str]
) -> list[Feature[S]]:
    """Return the columns of the linear model: the offset, then those of each term in turn.

    Rewriting effects act first, in the order of the catalogue and on their own thermometer, so the
    order of the user's tables does not matter.
    """
    thermometers = {CHIP: signals.temperature_degC, **signals.channels}

    def view(term: Term) -> Signals[S]:
        seen, own = signals, thermometers[term.signal]
        if own is not signals.temperature_degC:
            seen = replace(signals, temperature_degC=own)
        if not term.arrivals or signals.arrivals is None:
            return seen
        return replace(seen, arrival_K=signals.arrivals(term.arrivals))

    for term in sorted(terms, key=lambda term: list(catalogue_order).index(term.effect.kind)):
        rewrite = term.effect.rewrite
        if rewrite is not None:
            changed = _call(term.effect, "rewrite", rewrite, ops, view(term), term.values)
            if not isinstance(changed, Signals):
                raise InputError(
                    f"{_where(term.effect)}: rewrite returned {type(changed).__name__}; expected "
                    "Signals, as dataclasses.replace(signals, temperature_degC=...) gives."
                )
            thermometers[term.signal] = changed.temperature_degC
            signals = replace(changed, temperature_degC=thermometers[CHIP], arrival_K=None)
    features = [Feature(OFFSET, ops.constant(1.0))]
    for term in terms:
        built = _call(term.effect, "build", term.effect.build, ops, view(term), term.values)
        if not isinstance(built, list | tuple):
            raise InputError(
                f"{_where(term.effect)}: build returned {type(built).__name__}; expected a list "
                "of Feature(name, signal)."
            )
        for feature in built:
            if not isinstance(feature, Feature):
                raise InputError(
                    f"{_where(term.effect)}: build returned a {type(feature).__name__} where a "
                    "Feature(name, signal) was expected; return a list of features."
                )
            if feature.output is not None and feature.output not in signals.outputs:
                raise InputError(
                    f"{_where(term.effect)}: feature '{feature.name}' is for output "
                    f"'{feature.output}'{nearest(feature.output, signals.outputs) or '.'} "
                    f"The outputs are: {', '.join(signals.outputs)}; None is for all of them."
                )
            name = f"{term.name}: {feature.name}"
            features.append(Feature(name, feature.signal, feature.unit, feature.output))
    return features


def build_columns(
    signals: Signals[Array], terms: Sequence[Term], order: Sequence[str], sample_period_s: float
) -> list[Feature[Array]]:
    """Return the columns as arrays [n], checked, since a user's effect may return anything.

    Raises:
        InputError: an effect raised, or gave NaN or a wrong shape.
    """
    shape = signals.temperature_degC.shape
    ops = NumpyOperations(sample_period_s, shape)
    features = build_features(ops, signals, terms, order)
    for feature in features:
        column: object = feature.signal
        if not isinstance(column, np.ndarray) or column.shape != shape:
            found = getattr(column, "shape", type(column).__name__)
            raise InputError(
                f"{name_feature(feature, terms)} has shape {found}; "
                f"expected one value per sample, {shape}."
            )
        if not np.isfinite(column).all():
            row = int(np.flatnonzero(~np.isfinite(column))[0])
            raise InputError(
                f"{name_feature(feature, terms)} is {column[row]} at "
                f"sample {row}; keep its arguments where the operation is defined."
            )
    return features


def name_feature(feature: Feature[S], terms: Sequence[Term]) -> str:
    """Return the file, the effect and the name of a feature, for messages."""
    for term in terms:
        prefix = f"{term.name}: "
        if feature.name.startswith(prefix):
            return f"{_where(term.effect)}: feature '{feature.name.removeprefix(prefix)}'"
    return f"feature '{feature.name}'"


def _where(effect: Effect) -> str:
    return f"{effect.file or 'built-in'}: effect '{effect.kind}'"


def _call(
    effect: Effect, name: str, function: Callable[P, T], *given: P.args, **named: P.kwargs
) -> T:
    """Call a part of an effect; an exception in a user's file becomes one message."""
    try:
        return function(*given, **named)
    except InputError:
        raise
    except (Exception, SystemExit) as error:
        line = line_in(error, effect.file)
        raise InputError(
            f"{effect.file or 'built-in'}{line}: effect '{effect.kind}': {name} raised "
            f"{type(error).__name__}: {error}. Correct it; signals are combined by `ops` alone "
            "(ops.affine, ops.product, ops.lowpass, ...)."
        ) from error
