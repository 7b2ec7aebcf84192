"""Effects that stand in no catalogue: their cause is not logged, or it is no sum of terms."""

import numpy as np

from benchmarks.third_simulator.effects import Effect, Scene, take_up_water
from benchmarks.third_simulator.heat import Array, build_chain, relax
from benchmarks.third_simulator.memory import stick_and_slip
from benchmarks.third_simulator.programme import ROOM_DEGC, wander


def _spread(scene: Scene, rng: np.random.Generator) -> Array:
    outputs = scene.zero.shape[1]
    mix = rng.uniform(0.5, 1.0, outputs) * rng.choice([-1.0, 1.0], outputs)
    found: Array = (mix / np.abs(mix).max())[None, :]
    return found


def miss_an_input(scene: Scene, rng: np.random.Generator) -> list[Array]:
    """Something nearby that no column holds: a motor that runs or not, and a draught."""
    mix, on_s = _spread(scene, rng), rng.uniform(100.0, 600.0)
    found = []
    for run in scene.runs:
        size = run.air.size
        switched = np.cumsum(rng.random(size) < run.step_s / on_s) % 2
        warm = relax(switched.astype(np.float64), rng.uniform(60.0, 240.0), run.step_s)
        drawn = wander(rng, size, run.step_s, 500.0)
        still = 0.05 if run.use == "dwell" else 1.0
        found.append(still * (warm + 0.4 * drawn)[:, None] * mix)
    return found


def stick(scene: Scene, rng: np.random.Generator) -> list[Array]:
    """A valve's stem, or a joint under thermal stress, that sticks and slips as it likes."""
    mix = _spread(scene, rng)
    loaded = any(np.ptp(run.load[:, 0]) > 0.0 for run in scene.runs)
    found = []
    for run, place in zip(scene.runs, scene.place, strict=True):
        if loaded:
            found.append(stick_and_slip(run.load[:, 0] / scene.full_scale, rng, 0.2)[:, None] * mix)
        else:
            pull = (place - ROOM_DEGC) / scene.reach_k
            found.append(stick_and_slip(pull, rng, 0.2)[:, None] * mix)
    return found


def burst(scene: Scene, rng: np.random.Generator) -> list[Array]:
    """A transmitter's bursts, rectified in the amplifier's first stage; they follow nothing."""
    mix, apart_s = _spread(scene, rng), rng.uniform(150.0, 500.0)
    found = []
    for run in scene.runs:
        time, told = run.time, np.zeros(run.air.size)
        for start in np.cumsum(rng.exponential(apart_s, int(time[-1] / apart_s * 3) + 3)):
            if start > time[-1] or run.use == "dwell":
                break
            inside = (time >= start) & (time < start + rng.uniform(10.0, 90.0))
            told += inside * rng.lognormal(0.0, 0.5) * (1.0 + 0.2 * np.sin(time))
        found.append(told[:, None] * mix)
    return found


def pop(scene: Scene, rng: np.random.Generator) -> list[Array]:
    """A trap in an amplifier's junction: two levels, random times (popcorn noise)."""
    mix = _spread(scene, rng)
    up_s, down_s = rng.uniform(60.0, 600.0, 2)
    found = []
    for run in scene.runs:
        told, level = np.empty(run.air.size), 0.0
        draws = rng.random(run.air.size)
        for row, draw in enumerate(draws):
            if draw < run.step_s / (up_s if level else down_s):
                level = 1.0 - level
            told[row] = level
        found.append(told[:, None] * mix * (0.0 if run.use == "dwell" else 1.0))
    return found


def interact(scene: Scene, rng: np.random.Generator) -> list[Array]:
    """Water taken up makes an adhesive's expansion another one: moisture times temperature."""
    wet = take_up_water(scene, rng)
    return [
        (inner - inner.mean()) * ((place - ROOM_DEGC) / scene.reach_k)[:, None]
        for inner, place in zip(wet, scene.place, strict=True)
    ]


def condense(scene: Scene, rng: np.random.Generator) -> list[Array]:
    """Dew on a board that is colder than the dew point of moist air; it leaks until it is dry."""
    mix, dries_s = _spread(scene, rng), rng.uniform(200.0, 900.0)
    chain = build_chain(4, rng.uniform(100.0, 400.0))
    moist = [chain.respond(run.inputs["humidity"], step_s=run.step_s)[-1] for run in scene.runs]
    dry = float(np.quantile(np.concatenate(moist), rng.uniform(0.3, 0.6)))
    mild = float(np.quantile(np.concatenate(scene.place), rng.uniform(0.4, 0.7)))
    found = []
    for run, place, wet in zip(scene.runs, scene.place, moist, strict=True):
        film = np.sqrt(np.clip(wet - dry, 0.0, None) * np.clip(mild - place, 0.0, None))
        found.append(relax(film, dries_s, run.step_s)[:, None] * mix)
    return found


def remember_heat(scene: Scene, rng: np.random.Generator) -> list[Array]:
    """A joint yields by the hottest that it has been in a run, and recovers between the runs."""
    mix = _spread(scene, rng)
    return [(np.maximum.accumulate(place) - ROOM_DEGC)[:, None] * mix for place in scene.place]


OUTSIDE: dict[str, Effect] = {
    "unlogged_input": miss_an_input,
    "sticky_valve": stick,
    "emi_bursts": burst,
    "popcorn": pop,
    "interaction": interact,
    "dew": condense,
    "heat_memory": remember_heat,
}
"""Name -> an effect beside every catalogue."""
