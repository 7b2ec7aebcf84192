"""How strong every effect is: the paper's drift for what is told, the asked sizes for the rest.

The size of an effect is the RMS of what the told model cannot absorb of it, over the noise RMS,
pooled over the outputs and the training runs. What the told model can absorb is the span of its
effects' true columns, their tangents along each shape parameter, and one offset per run.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from zerodrift.base.errors import InputError
from zerodrift_lab.twin.conditions import Conditions
from zerodrift_lab.twin.disturbances import DISTURBANCES, draw_coefficients
from zerodrift_lab.twin.elements import ELEMENT_EFFECTS, Elements, feel
from zerodrift_lab.twin.recipe import PARAMETERS, EffectChoice, Recipe
from zerodrift_lab.twin.sensor import (
    COLDEST,
    DARK_SHARE,
    DRIFT_SPAN,
    FULL_SCALE,
    HOTTEST,
    OUTPUTS,
    REFERENCE_TEMPERATURE,
    draw_signs,
    draw_stream,
)

Array = NDArray[np.float64]

DEFAULT_SIZE = 2.0
"""Of a hidden effect that adds to the outputs."""
TOLD_SIZE = 8.0
"""Of a told effect other than the zero shift and the dark current."""
BASE_DRIFT = ("zero_tempco", "dark_current")
"""Told, these two span the drift of the paper's sensor between them."""
MOST_ROWS = 30_000
"""Sizes are measured on every n-th sample of longer campaigns: an RMS needs no more."""


@dataclass(frozen=True)
class Physics:
    """One sensor's effects with all their numbers."""

    parameters: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    """Effect -> shape parameter -> value."""
    coefficients: Mapping[str, Array] = field(default_factory=dict)
    """Additive effect -> [6, m], an output's unit per unit of the column."""
    rails: Array | None = None
    """[6] where the converter clips, in each output's unit; None = out of reach."""
    sizes: Mapping[str, float] = field(default_factory=dict)
    """Hidden effect -> its size."""

    def with_effect(
        self, name: str, parameters: Mapping[str, float], coefficients: Array | None = None
    ) -> "Physics":
        """Return this physics with one effect more, or with one replaced."""
        added = {} if coefficients is None else {name: coefficients}
        return replace(
            self,
            parameters={**self.parameters, name: dict(parameters)},
            coefficients={**self.coefficients, **added},
        )

    def with_size(self, name: str, size: float) -> "Physics":
        """Return this physics with the size of one hidden effect noted."""
        return replace(self, sizes={**self.sizes, name: size})


def contribute(name: str, physics: Physics, run: Conditions, elements: Elements) -> Array:
    """Return what one additive effect adds to the outputs in one run [n, 6]."""
    columns = DISTURBANCES[name].columns(run, elements, physics.parameters[name])
    added: Array = np.einsum("nkm,km->nk", columns, physics.coefficients[name])
    return added


def add_up(
    physics: Physics, run: Conditions, elements: Elements, *, thermal_only: bool = False
) -> Array:
    """Return what all additive effects add to the outputs in one run [n, 6]."""
    total = np.zeros((run.time_s.size, len(OUTPUTS)))
    for name in physics.coefficients:
        if DISTURBANCES[name].thermal or not thermal_only:
            total += contribute(name, physics, run, elements)
    return total


# --- what the told model can absorb --------------------------------------------------------------


@dataclass(frozen=True)
class Absorber:
    """The span of the told model, from which sizes are measured."""

    bases: tuple[Array, ...]
    """Per output, orthonormal columns [rows, p]."""
    stride: int
    noise_rms: Array
    """[6]."""

    def leave(self, effect: Sequence[Array]) -> Array:
        """Return what the told model leaves of an effect given per run [n, 6], in noise RMS."""
        rows = np.concatenate([part[:: self.stride] for part in effect]) / self.noise_rms
        left = np.empty_like(rows)
        for k, basis in enumerate(self.bases):
            left[:, k] = rows[:, k] - basis @ (basis.T @ rows[:, k])
        return left

    def measure(self, effect: Sequence[Array]) -> float:
        """Return the size of an effect given per run [n, 6]."""
        return float(np.sqrt(np.mean(self.leave(effect) ** 2)))


def _orthonormalise(columns: Array) -> Array:
    """Return an orthonormal basis of the columns' span, dropping what is dependent."""
    norms = np.linalg.norm(columns, axis=0)
    kept = columns[:, norms > 0.0] / norms[norms > 0.0]
    left, singular, _ = np.linalg.svd(kept, full_matrices=False)
    return np.asarray(left[:, singular > 1e-9 * singular[0]])


def _make_tangents(told: Physics, runs: Sequence[Conditions]) -> list[list[Array]]:
    """Return, per shape parameter of the told effects, the drift's derivative per run [n, 6]."""
    tangents = []
    for name, parameters in told.parameters.items():
        for key in PARAMETERS.get(name, {}):
            if key not in parameters or key in ("order", "rail_pct"):
                continue
            sides = []
            for factor in (1.0 + 1e-3, 1.0 - 1e-3):
                moved = told.with_effect(name, {**parameters, key: factor * parameters[key]})
                sides.append([add_up(moved, run, feel(run, moved.parameters)) for run in runs])
            tangents.append([up - down for up, down in zip(*sides, strict=True)])
    return tangents


def build_absorber(told: Physics, runs: Sequence[Conditions], noise_rms: Array) -> Absorber:
    """Return the span of the told effects on these runs, with one offset per run."""
    stride = max(1, -(-sum(run.time_s.size for run in runs) // MOST_ROWS))
    tangents = _make_tangents(told, runs)
    felt = [feel(run, told.parameters) for run in runs]
    blocks: list[list[Array]] = [[] for _ in OUTPUTS]
    offsets = np.repeat(np.eye(len(runs)), [run.time_s[::stride].size for run in runs], axis=0)
    for name in told.coefficients:
        columns = np.concatenate(
            [
                DISTURBANCES[name].columns(run, elements, told.parameters[name])[::stride]
                for run, elements in zip(runs, felt, strict=True)
            ]
        )
        for k, block in enumerate(blocks):
            block.append(columns[:, k])
    for tangent in tangents:
        rows = np.concatenate([part[::stride] for part in tangent])
        for k, block in enumerate(blocks):
            block.append(rows[:, k : k + 1])
    bases = tuple(_orthonormalise(np.concatenate([offsets, *block], axis=1)) for block in blocks)
    return Absorber(bases, stride, noise_rms)


# --- what is told --------------------------------------------------------------------------------


def draw_parameters(choice: EffectChoice, seed: int) -> dict[str, float]:
    """Draw the shape parameters of an effect; those that the choice states are held."""
    rng = draw_stream(seed, "parameters", choice.name)
    drawn: dict[str, float] = {}
    if choice.name == "thermal_lag":
        drawn = {"tau_s": float(np.exp(rng.uniform(np.log(20.0), np.log(300.0))))}
    elif choice.name == "thermal_hysteresis":
        drawn = {"half_width_K": float(rng.uniform(0.5, 3.0))}
    elif choice.name == "clock_delay":
        drawn = {"delay_s": float(draw_signs(rng, 1)[0] * rng.uniform(2.0, 8.0))}
    elif choice.name == "heat_path":
        drawn = {"share": float(rng.uniform(0.3, 0.9))}
    elif choice.name == "adc_saturation":
        drawn = {"rail_pct": float(rng.uniform(14.0, 19.0))}
    else:
        drawn = DISTURBANCES[choice.name].draw(rng)
    return {**drawn, **choice.parameters}


def draw_drift(seed: int, name: str, columns: int, doubling_kelvin: float, shared: bool) -> Array:
    """Draw the coefficients [6, columns] of the zero shift or the dark current.

    Over -20..60 degC they span about what the paper's sensor drifts: between them when `shared`,
    otherwise the one alone.
    """
    spread = np.exp(draw_stream(seed, "drift span").normal(0.0, 0.12, len(OUTPUTS)))
    dark_spread = np.exp(draw_stream(seed, "dark share").normal(0.0, 0.15, len(OUTPUTS)))
    dark = np.clip(DARK_SHARE * dark_spread, 0.0, 0.9) if shared else np.ones(len(OUTPUTS))
    rng = draw_stream(seed, "coefficients", name)
    span = DRIFT_SPAN * spread * draw_signs(draw_stream(seed, "drift sign"), len(OUTPUTS))
    if name == "dark_current":
        away = np.array([COLDEST, HOTTEST]) - REFERENCE_TEMPERATURE
        strength: Array = span * dark / np.ptp(np.exp2(away / doubling_kelvin))
        return strength[:, None]
    slope = span * ((1.0 - dark) if shared else 1.0) / (HOTTEST - COLDEST)
    bends = rng.uniform(0.1, 0.3, (len(OUTPUTS), columns)) / 40.0 ** np.arange(columns)
    bends[:, 0] = 1.0
    coefficients: Array = slope[:, None] * bends
    return coefficients


def make_told(recipe: Recipe, runs: Sequence[Conditions], noise_rms: Array) -> Physics:
    """Return the physics of the told effects alone."""
    physics = Physics()
    names = [choice.name for choice in recipe.told]
    for choice in recipe.told:
        scaled = choice.name in DISTURBANCES and choice.name not in BASE_DRIFT
        if choice.size is not None and not scaled:
            raise InputError(
                f"twin: told {choice.name} takes no size: what it does follows from the sensor's "
                "drift over -20..60 degC; leave the size out."
            )
        if choice.name in ELEMENT_EFFECTS or choice.name == "adc_saturation":
            physics = physics.with_effect(choice.name, draw_parameters(choice, recipe.seed))
    for choice in recipe.told:
        if choice.name not in DISTURBANCES:
            continue
        parameters = draw_parameters(choice, recipe.seed)
        order = int(parameters.get("order", 1.0))
        if choice.name in BASE_DRIFT:
            shared = all(name in names for name in BASE_DRIFT)
            doubling_kelvin = parameters.get("doubling_K", 10.0)
            coefficients = draw_drift(recipe.seed, choice.name, order, doubling_kelvin, shared)
            physics = physics.with_effect(choice.name, parameters, coefficients)
        else:
            physics = physics.with_effect(choice.name, parameters)
            nothing = build_absorber(Physics(), runs, noise_rms)
            size = TOLD_SIZE if choice.size is None else choice.size
            physics, _ = add_scaled(physics, choice, recipe.seed, runs, nothing, size)
    return physics


# --- what is hidden ------------------------------------------------------------------------------


def add_scaled(
    physics: Physics,
    choice: EffectChoice,
    seed: int,
    runs: Sequence[Conditions],
    absorber: Absorber,
    size: float,
) -> tuple[Physics, float]:
    """Return the physics with an additive effect of that size beyond the absorber's model."""
    parameters = draw_parameters(choice, seed)
    columns = int(parameters.get("order", len(DISTURBANCES[choice.name].terms)))
    coefficients = draw_coefficients(choice.name, seed, absorber.noise_rms, columns)
    with_it = physics.with_effect(choice.name, parameters, coefficients)
    effect = [contribute(choice.name, with_it, run, feel(run, physics.parameters)) for run in runs]
    unit_size = absorber.measure(effect)
    if unit_size < 1e-9:
        raise InputError(
            f"twin: {choice.name} does nothing in these runs that the told model could not "
            "absorb; use runs that move what it depends on (--kinds and --still; in a recipe "
            "train and exercise)."
        )
    scaled = with_it.with_effect(choice.name, parameters, coefficients * (size / unit_size))
    return scaled, size


def add_element_effect(
    physics: Physics,
    told: Physics,
    choice: EffectChoice,
    seed: int,
    runs: Sequence[Conditions],
    absorber: Absorber,
    size: float | None,
    *,
    may_scale_drift: bool,
) -> tuple[Physics, float]:
    """Return the physics with an effect on what the elements feel.

    Without a size it acts in full on the sensor's drift. With one, the told temperature drift is
    scaled until the size is met, so that the effect keeps its textbook form; where another effect
    has claimed that scaling (`may_scale_drift` is false), its own parameter is moved instead.
    """
    parameters = draw_parameters(choice, seed)
    before = [feel(run, told.parameters) for run in runs]

    def differ(values: Mapping[str, float], names: tuple[str, ...]) -> list[Array]:
        """Return per run what the effect changes in those additive effects."""
        subset = replace(physics, coefficients={n: physics.coefficients[n] for n in names})
        felt = {**told.parameters, choice.name: values}
        return [
            add_up(subset, run, feel(run, felt), thermal_only=True)
            - add_up(subset, run, elements, thermal_only=True)
            for run, elements in zip(runs, before, strict=True)
        ]

    if size is None:
        effect = differ(parameters, tuple(physics.coefficients))
        return physics.with_effect(choice.name, parameters), absorber.measure(effect)
    if may_scale_drift:
        of_told = absorber.leave(differ(parameters, tuple(told.coefficients)))
        others = tuple(name for name in physics.coefficients if name not in told.coefficients)
        factor = _solve_factor(of_told, absorber.leave(differ(parameters, others)), size, choice)
        scaled = {
            name: values * (factor if name in told.coefficients else 1.0)
            if DISTURBANCES[name].thermal
            else values
            for name, values in physics.coefficients.items()
        }
        return replace(physics, coefficients=scaled).with_effect(choice.name, parameters), size
    key = next(iter(parameters))
    if key in choice.parameters:
        raise InputError(
            f"twin: {choice.name}: {key} and the size are both given, and another effect has "
            f"claimed the scaling of the drift; leave out {key} or the size."
        )
    low, high = PARAMETERS[choice.name][key]
    low = max(low, -high)
    for _ in range(60):
        reached = absorber.measure(differ(parameters, tuple(physics.coefficients)))
        if abs(reached / size - 1.0) < 1e-3:
            return physics.with_effect(choice.name, parameters), reached
        moved = parameters[key] * float(np.clip(size / max(reached, 1e-12), 0.1, 10.0))
        if not low <= moved <= high:
            break
        parameters[key] = moved
    raise InputError(
        f"twin: {choice.name} cannot reach size {size:g} in these runs, {reached:.3g} at "
        f"{key} = {parameters[key]:.3g}; ask for another size, or leave the size out."
    )


def _solve_factor(of_told: Array, of_others: Array, size: float, choice: EffectChoice) -> float:
    """Return the factor f > 0 at which the RMS of f of_told + of_others is the size."""
    square = float(np.mean(of_told**2))
    cross = float(np.mean(of_told * of_others))
    rest = float(np.mean(of_others**2)) - size**2
    if square < 1e-18 or rest > 0.0:
        raise InputError(
            f"twin: {choice.name} cannot be given size {size:g}: it changes what the "
            "temperature-driven effects see, and those told do not allow it. "
            "Tell zero_tempco or dark_current, or leave the size out."
        )
    return (-cross + float(np.sqrt(cross**2 - square * rest))) / square


def set_rails(
    choice: EffectChoice,
    recipe: Recipe,
    physics: Physics,
    absorber: Absorber,
    signals: Sequence[Array],
    *,
    hidden: bool,
) -> Physics:
    """Return the physics with the converter's rails at a share of every output's full scale.

    `signals` are the training runs' [n, 6]. A hidden saturation of a given size gets the rails at
    which clipping leaves that much beyond the told model; without a size, drawn rails.
    """

    def measure(rail_pct: float) -> float:
        rails = rail_pct / 100.0 * FULL_SCALE
        return absorber.measure([np.clip(s, -rails, rails) - s for s in signals])

    parameters = draw_parameters(choice, recipe.seed)
    size = choice.size or (None if choice.parameters else recipe.size)
    if hidden and size is not None:
        low, high = PARAMETERS[choice.name]["rail_pct"]
        if measure(low) < size:
            raise InputError(
                f"twin: adc_saturation cannot reach size {size:g} in these runs, "
                f"{measure(low):.3g} at most; ask for less, or exercise the load."
            )
        for _ in range(50):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if measure(middle) > size else (low, middle)
        parameters["rail_pct"] = low
    rail_pct = parameters["rail_pct"]
    rails = rail_pct / 100.0 * FULL_SCALE
    physics = replace(physics.with_effect(choice.name, parameters), rails=rails)
    return physics.with_size(choice.name, measure(rail_pct)) if hidden else physics
