"""One case from a seed: a specimen, its runs, what is hidden, and what is known of it.

The size of a hidden effect is what the model that a user begins with leaves of it. That model is
fitted here by ordinary least squares to noise-free drift over all training runs: the powers of the
logged temperature, load and load times temperature where loads are applied, and known influences.
"""

import zlib
from dataclasses import dataclass, replace
from typing import TypedDict, Unpack

import numpy as np

from benchmarks.third_simulator.case import Case
from benchmarks.third_simulator.effects import EFFECTS, Scene, heat_place, read_far_end
from benchmarks.third_simulator.families import FAMILIES, NEEDED, OF_LOAD, Family
from benchmarks.third_simulator.heat import Array
from benchmarks.third_simulator.noise import KINDS, Recorder
from benchmarks.third_simulator.outside import OUTSIDE
from benchmarks.third_simulator.programme import (
    CHAMBERS,
    Run,
    draw_air,
    draw_input,
    draw_load,
    hold_input,
    wander,
)
from benchmarks.third_simulator.record import Asked, Model, Physics, record

SUBSTEPS = 4
TEST_RUNS = 2
KNOWN = ("supply_sensitivity", "inertial_load", "barometric_pressure")
"""Influences that a user may know of from the start."""


class Wanted(TypedDict, total=False):
    """What may be asked of a case; what is left out is as stated at `draw_case`."""

    family: str | None
    runs: int
    tests: int
    effect: str | tuple[str, ...] | None
    size: float
    outliers: float
    noise: str
    dwell: bool
    temperature_rows: int


@dataclass(frozen=True)
class _Request:
    seed: int
    family: Family
    runs: int
    tests: int
    effects: tuple[str, ...]
    size: float
    outliers: float
    noise: str
    dwell: bool
    temperature_rows: int

    def stream(self, name: str) -> np.random.Generator:
        """Return the random numbers of one part, the same whatever the others draw."""
        return np.random.default_rng([self.seed, zlib.crc32(name.encode())])


def list_effects(family: str) -> tuple[str, ...]:
    """Return the catalogue's effects that a family has."""
    return FAMILIES[family].effects


def draw_case(seed: int, **wanted: Unpack[Wanted]) -> Case:
    """Return one case.

    Args:
        seed: decides everything that is not asked for.
        **wanted: `family`: one of `FAMILIES`; left out, drawn among those that have the effects.
            `runs`: training runs, 2 to 12 (6); `tests`: test runs, on top of them (2); `dwell`: a
            dwell on top (true). `effect`: what is hidden, a name of `EFFECTS` or `OUTSIDE`,
            several, or None.
            `size`: RMS that the base model leaves of each over RMS of the noise, on the training
            runs, at the output that feels it most (3). `outliers`: share of wild rows (0).
            `noise`: one of `KINDS` ("white"). `temperature_rows`: the thermometer is read once
            in so many rows and its reading repeated (1).

    Raises:
        ValueError: a name that does not exist, or an effect that the family does not have.
    """
    request = _read(seed, wanted)
    rng = request.stream("specimen")
    family = request.family
    loaded = bool(rng.random() < 0.6) or any(name in OF_LOAD for name in request.effects)
    outputs = 2 if "crosstalk" in request.effects else int(rng.integers(1, len(family.output) + 1))
    full_scale = float(rng.choice(family.full_scale))
    known = _choose_known(request, rng)
    runs = _draw_runs(request, full_scale, outputs if loaded else -outputs, known)
    scene = _draw_specimen(request, runs, full_scale, outputs)
    recorder = _draw_recorder(request, full_scale, loaded)
    base = [scene.drift(run, place) for run, place in zip(scene.runs, scene.place, strict=True)]
    if known:
        added = _add_known(request, scene, known, recorder.sigma)
        base = [one + more for one, more in zip(base, added, strict=True)]
    hidden = {
        name: (EFFECTS | OUTSIDE)[name](scene, request.stream(name)) for name in request.effects
    }
    model = Model(
        order=len(scene.zero) - 1,
        of_load=loaded and "span_tempco" not in request.effects,
        known=NEEDED[known] if known else (),
        kind=known,
    )
    physics = Physics(
        scene=scene,
        base=tuple(base),
        hidden={name: tuple(arrays) for name, arrays in hidden.items()},
        inputs=_log_inputs(request, scene),
    )
    asked = Asked(request.seed, family, request.effects, request.size, request.temperature_rows)
    return record(asked, physics, recorder, model)


def _read(seed: int, wanted: Wanted) -> _Request:
    unknown = set(wanted) - set(Wanted.__annotations__)
    if unknown:
        raise ValueError(f"draw_case knows no {sorted(unknown)}; {sorted(Wanted.__annotations__)}")
    effect = wanted.get("effect")
    effects = (effect,) if isinstance(effect, str) else tuple(effect or ())
    for name in effects:
        if name not in EFFECTS and name not in OUTSIDE:
            raise ValueError(f"no effect {name!r}; there are {sorted([*EFFECTS, *OUTSIDE])}")
    having = [f for f in FAMILIES.values() if all(e in (*f.effects, *OUTSIDE) for e in effects)]
    chosen = wanted.get("family")
    if chosen is not None and chosen not in {family.name for family in having}:
        raise ValueError(
            f"family {chosen!r} has not {', '.join(effects) or 'been found'}; "
            f"those that have: {', '.join(family.name for family in having)}"
        )
    if not having:
        raise ValueError(f"no family has all of {', '.join(effects)}")
    noise = wanted.get("noise", "white")
    if noise not in KINDS:
        raise ValueError(f"no noise {noise!r}; there are {', '.join(KINDS)}")
    runs = wanted.get("runs", 6)
    if not 2 <= runs <= 12:
        raise ValueError(f"runs = {runs}; expected 2 to 12")
    place = int(np.random.default_rng([seed, 1]).integers(len(having)))
    return _Request(
        seed=seed,
        family=FAMILIES[chosen] if chosen else having[place],
        runs=runs,
        tests=wanted.get("tests", TEST_RUNS),
        effects=effects,
        size=wanted.get("size", 3.0),
        outliers=wanted.get("outliers", 0.0),
        noise=noise,
        dwell=wanted.get("dwell", True),
        temperature_rows=wanted.get("temperature_rows", 1),
    )


def _choose_known(request: _Request, rng: np.random.Generator) -> str | None:
    """Return an influence that the user's first model has, beside zero and span."""
    able = [e for e in KNOWN if e in request.family.effects and e not in request.effects]
    moved = {name for effect in request.effects for name in NEEDED.get(effect, ())}
    able = [e for e in able if not moved & set(NEEDED[e])]
    return str(rng.choice(able)) if able and rng.random() < 0.3 else None


def _list_inputs(request: _Request, known: str | None) -> tuple[set[str], set[str]]:
    """Return the inputs that are logged, and those that the programme moves."""
    rng = request.stream("columns")
    effects = (*request.effects, *([known] if known else []))
    moved = {name for effect in effects for name in NEEDED.get(effect, ())}
    usual = [n for n in ("supply", "humidity", "pressure", "clock") if rng.random() < 0.35]
    if rng.random() < 0.2 and "ambient_light" in request.family.effects:
        usual.append("ambient_light")
    return moved | set(usual), moved


def _draw_runs(
    request: _Request, full_scale: float, outputs: int, known: str | None
) -> tuple[Run, ...]:
    """Return all runs; `outputs` is negative where no load is applied."""
    rng = request.stream("programme")
    family = request.family
    low, high = family.span_degc
    middle, half = 0.5 * (low + high), 0.5 * (high - low) * rng.uniform(0.5, 0.95)
    span = (middle - half, middle + half)
    period_s = float(rng.choice(family.period_s))
    step_s = period_s / SUBSTEPS
    logged, moved = _list_inputs(request, known)
    style = str(rng.choice([*CHAMBERS, "any", "any"]))
    names = [f"train_{n + 1}" for n in range(request.runs)]
    names += [f"test_{n + 1}" for n in range(request.tests)]
    starts = np.cumsum(rng.uniform(0.3, 3.0, len(names) + 1)) * 86400.0
    order = rng.permutation(len(names))
    runs = []
    for name, place in zip(names, order, strict=True):
        seconds = period_s * float(rng.uniform(1500.0, 4000.0))
        kind = str(rng.choice(CHAMBERS)) if style == "any" else style
        air = draw_air(rng, kind, seconds, step_s, span)
        grid = (seconds, step_s)
        load = np.zeros((air.size, abs(outputs)))
        for column in range(outputs):
            load[:, column] = draw_load(rng, full_scale, family.both_signs, grid)
        inputs = {n: draw_input(rng, n, air, grid, n in moved) for n in sorted(logged - {"clock"})}
        use = name.split("_")[0]
        runs.append(Run(name, use, period_s, step_s, float(starts[place + 1]), air, load, inputs))
    if request.dwell:
        size = int(rng.uniform(1000.0, 2000.0)) * SUBSTEPS
        air = rng.uniform(22.0, 30.0) + 0.01 * wander(rng, size, step_s, 300.0)
        still = {n: hold_input(rng, n, air, step_s) for n in sorted(logged - {"clock"})}
        load = np.zeros((size, abs(outputs)))
        runs.append(Run("dwell", "dwell", period_s, step_s, float(starts[0]), air, load, still))
    if "clock" in logged:
        runs = [
            replace(run, inputs={**run.inputs, "clock": run.start_s + run.time}) for run in runs
        ]
    return tuple(runs)


def _draw_specimen(
    request: _Request, runs: tuple[Run, ...], full_scale: float, outputs: int
) -> Scene:
    rng = request.stream("zero and span")
    family = request.family
    order = int(rng.choice(family.zero_order))
    if "dark_current" in request.effects:
        order = 1
    reach_k = 0.5 * (family.span_degc[1] - family.span_degc[0])
    first = 0.01 * family.zero_pct_per_k * full_scale * reach_k
    size = np.array([1.0, 1.0, 0.35, 0.2])[: order + 1]
    zero = first * size[:, None] * rng.lognormal(0.0, 0.4, (order + 1, outputs))
    zero *= rng.choice([-1.0, 1.0], zero.shape)
    span = 0.01 * family.span_pct_per_k * rng.uniform(0.3, 1.5, outputs)
    span *= rng.choice([-1.0, 1.0], outputs) * ("span_tempco" not in request.effects)
    followed = (float(rng.uniform(*family.follows_s)), float(rng.uniform(*family.follows_s)))
    place = tuple(heat_place(run.air, followed, run.step_s) for run in runs)
    return Scene(runs, place, zero, span, reach_k, full_scale)


def _draw_recorder(request: _Request, full_scale: float, loaded: bool) -> Recorder:
    rng = request.stream("recorder")
    sigma = 0.01 * request.family.noise_pct * full_scale * float(rng.lognormal(0.0, 0.3))
    coarse = request.noise == "coarse"
    return Recorder(
        kind=request.noise,
        sigma=sigma,
        lsb=sigma * (3.0 if coarse else float(rng.uniform(0.05, 0.6))),
        reference_sigma=sigma * float(rng.uniform(0.05, 0.4)) if loaded else 0.0,
        jitter=float(rng.uniform(0.0, 0.1)),
        lost=float(rng.choice([0.0, 0.002, 0.01])),
        gaps=int(rng.integers(0, 3)),
        outliers=request.outliers,
    )


def _log_inputs(request: _Request, scene: Scene) -> tuple[dict[str, Array], ...]:
    """Return what is logged beside the outputs, per run at the fine step, without errors."""
    found = tuple(dict(run.inputs) for run in scene.runs)
    rng = request.stream("second thermometer")
    if "thermal_gradient" in request.effects and rng.random() < 0.5:
        far = read_far_end(scene, request.stream("thermal_gradient"))
        for inputs, one in zip(found, far, strict=True):
            inputs["body_temperature"] = one[:, 0]
    return found


def _add_known(request: _Request, scene: Scene, name: str, sigma: float) -> list[Array]:
    """Return a known influence, a straight line in its channels, per run (n, outputs)."""
    rng = request.stream("known")
    weights = rng.normal(0.0, 1.0, (len(NEEDED[name]), scene.zero.shape[1]))
    moved = [
        np.stack([run.inputs[channel] for channel in NEEDED[name]], axis=1) @ weights
        for run in scene.runs
    ]
    strength = sigma * float(rng.uniform(3.0, 15.0)) / float(np.std(np.concatenate(moved)))
    middle = np.concatenate(moved).mean(axis=0)
    return [strength * (one - middle) for one in moved]
