"""A fitted model as `add` prints it and the report shows it: parameters and coefficients."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass

import numpy as np

from zerodrift.physics.model import FittedTerm, PhysicalModel


@dataclass(frozen=True)
class FittedParameter:
    """A parameter of an effect that was fitted or held."""

    value: float
    std_error: float | None
    """None where the logs do not determine it."""
    unit: str
    held: bool
    at_bound: bool


@dataclass(frozen=True)
class ParameterInterval(FittedParameter):
    """A parameter with its 95 % interval."""

    interval: tuple[float, float] | None


@dataclass(frozen=True)
class FittedCoefficient:
    """What a feature adds to an output."""

    feature: str
    output: str
    value: float
    std_error: float | None
    unit: str


@dataclass(frozen=True)
class EffectSummary:
    """An effect of a model."""

    name: str
    kind: str
    title: str
    equation: str
    parameters: Mapping[str, ParameterInterval]
    coefficients: tuple[FittedCoefficient, ...]


@dataclass(frozen=True)
class ModelSummary:
    """The effects of a model."""

    terms: tuple[EffectSummary, ...]
    reference_temperature_degC: float
    notes: tuple[str, ...]


def describe_parameters(fitted: FittedTerm) -> dict[str, FittedParameter]:
    """Return the values of an effect that were fitted or held."""
    return {
        name: FittedParameter(
            value,
            _finite(fitted.std_errors.get(name)),
            fitted.term.effect.parameter(name).unit,
            held=name in fitted.term.held,
            at_bound=name in fitted.at_bound,
        )
        for name, value in fitted.term.values.items()
        if name in fitted.std_errors or name in fitted.term.held
    }


def _finite(value: float | None) -> float | None:
    """Return a number that JSON can hold; None where the logs do not determine it."""
    return value if value is not None and np.isfinite(value) else None


ROUNDING = 1e-12
"""Of a feature's largest coefficient: what is left of zero for an output it does not act on."""


def describe_coefficients(
    model: PhysicalModel, fitted: FittedTerm
) -> tuple[FittedCoefficient, ...]:
    """Return the coefficients of an effect's features per output."""
    described = []
    for j, feature in enumerate(model.feature_names):
        if not feature.startswith(f"{fitted.term.name}: "):
            continue
        for k, (output, unit) in enumerate(zip(model.outputs, model.units, strict=True)):
            largest = float(np.abs(model.coefficients[j]).max())
            is_none = abs(model.coefficients[j, k]) <= ROUNDING * largest
            if is_none and model.std_errors[j, k] == 0.0:
                continue
            per = "" if model.feature_units[j] == "1" else f"/{model.feature_units[j]}"
            described.append(
                FittedCoefficient(
                    feature.removeprefix(f"{fitted.term.name}: "),
                    output,
                    float(model.coefficients[j, k]),
                    _finite(float(model.std_errors[j, k])),
                    f"{unit}{per}",
                )
            )
    return tuple(described)


def summarise_model(model: PhysicalModel) -> ModelSummary:
    """Return the effects with parameters, intervals and coefficients."""
    return ModelSummary(
        tuple(
            EffectSummary(
                fitted.term.name,
                fitted.kind,
                fitted.term.effect.title,
                fitted.term.effect.equation,
                {
                    name: ParameterInterval(**asdict(told), interval=_find_interval(fitted, name))
                    for name, told in describe_parameters(fitted).items()
                },
                describe_coefficients(model, fitted),
            )
            for fitted in model.terms
        ),
        model.reference_temperature_degC,
        tuple(model.notes),
    )


def _find_interval(fitted: FittedTerm, name: str) -> tuple[float, float] | None:
    interval = fitted.intervals.get(name)
    if interval is None or not all(np.isfinite(interval)):
        return None
    return float(interval[0]), float(interval[1])
