"""What a sensor truly does beside its zero and span, by finer physics than a fitted model's.

Each function takes a scene (every run, as it was) and draws the specimen's parameters; it returns
one array per run, shape (n, outputs), in no unit: the size is set afterwards.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from benchmarks.third_simulator.heat import Array, Network, build_chain, creep
from benchmarks.third_simulator.memory import superpose_plays
from benchmarks.third_simulator.programme import ROOM_DEGC, Run

BOLTZMANN_EV_PER_K = 8.617e-5
KELVIN = 273.15
GRAVITY = 9.81


@dataclass(frozen=True, eq=False)
class Scene:
    """A specimen in all of its runs.

    Attributes:
        runs: in the order of their names.
        place: per run, shape (n,), degC at the thermometer.
        zero: the zero's polynomial, shape (order + 1, outputs), of (T - room) / `reach_k`.
        span: shape (outputs,), of the reading per kelvin.
        reach_k: half the range of use, K.
        full_scale: in the outputs' unit.
    """

    runs: tuple[Run, ...]
    place: tuple[Array, ...]
    zero: Array
    span: Array
    reach_k: float
    full_scale: float

    def drift(self, run: Run, temperature: Array) -> Array:
        """Return zero and span's drift at an element's `temperature`, shape (n, outputs)."""
        powers = ((temperature - ROOM_DEGC) / self.reach_k)[:, None] ** np.arange(len(self.zero))
        moved: Array = powers @ self.zero
        return moved + (temperature - ROOM_DEGC)[:, None] * self.span * run.load


Effect = Callable[[Scene, np.random.Generator], list[Array]]


def _mix(scene: Scene, rng: np.random.Generator) -> Array:
    """Return how strongly each output feels what all feel, shape (1, outputs)."""
    outputs = scene.zero.shape[1]
    mix = rng.uniform(0.5, 1.0, outputs) * rng.choice([-1.0, 1.0], outputs)
    found: Array = (mix / np.abs(mix).max())[None, :]
    return found


def lag_thermally(scene: Scene, rng: np.random.Generator) -> list[Array]:
    """The element sits behind package, adhesive and body; the thermometer on the board."""
    chain = build_chain(4, float(np.exp(rng.uniform(np.log(25.0), np.log(500.0)))), 2.0)
    found = []
    for run, place in zip(scene.runs, scene.place, strict=True):
        element = chain.respond(place, step_s=run.step_s)[-1]
        found.append(scene.drift(run, element) - scene.drift(run, place))
    return found


def bend_by_gradient(scene: Scene, rng: np.random.Generator) -> list[Array]:
    """A bar of metal, heated at the end where the thermometer sits, bends by its gradient."""
    bar = build_chain(8, float(rng.uniform(5.0, 40.0)))
    lever = np.linspace(1.0, -1.0, 8)
    mix = _mix(scene, rng)
    return [
        (lever @ bar.respond(place, step_s=run.step_s))[:, None] * mix
        for run, place in zip(scene.runs, scene.place, strict=True)
    ]


def read_far_end(scene: Scene, rng: np.random.Generator) -> list[Array]:
    """Return the far end's temperature of the bar of `bend_by_gradient`, shape (n, 1), degC."""
    bar = build_chain(8, float(rng.uniform(5.0, 40.0)))
    return [
        bar.respond(place, step_s=run.step_s)[-1][:, None]
        for run, place in zip(scene.runs, scene.place, strict=True)
    ]


def _die(rng: np.random.Generator) -> Network:
    """Return die, package and board, which last also holds the thermometer."""
    slow = float(np.exp(rng.uniform(np.log(80.0), np.log(900.0))))
    quick = slow * rng.uniform(0.05, 0.2)
    return Network(
        np.array([0.2 * quick, quick, slow]),
        np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.8], [0.0, 0.8, 0.0]]),
        np.array([0.0, 0.05, 1.0]),
    )


def warm_up(scene: Scene, rng: np.random.Generator) -> list[Array]:
    """Power comes on with the first row; the die is then hotter than the board at its foot."""
    network, mix = _die(rng), _mix(scene, rng)
    seen = rng.uniform(0.5, 0.9)
    found = []
    for run in scene.runs:
        size, step_s = (4, 1e5) if run.use == "dwell" else (run.air.size, run.step_s)
        nodes = network.respond(np.zeros(size), np.ones(size), 0, step_s)
        rise = nodes[0] - (1.0 - seen) * nodes[2]
        if run.use == "dwell":  # recorded long after power came on
            rise = np.full(run.air.size, rise[-1])
        found.append(rise[:, None] * mix)
    return found


def heat_by_excitation(scene: Scene, rng: np.random.Generator) -> list[Array]:
    """V^2 / R in the grid heats it through carrier and adhesive into the body."""
    network, mix = _die(rng), _mix(scene, rng)
    found = []
    for run in scene.runs:
        power = run.inputs["supply"] ** 2 / 25.0
        before = np.full(power.size, power[0])
        rest = network.respond(np.zeros(4), np.ones(4), 0, 1e5)[0][-1] * power[0]
        moved = network.respond(np.zeros(power.size), power - before, 0, run.step_s)[0]
        found.append((rest + moved)[:, None] * mix)
    return found


def _spread_plays(rng: np.random.Generator, width: float) -> tuple[Array, Array]:
    radii = width * np.linspace(0.1, 1.0, 8) ** rng.uniform(0.7, 1.5)
    weights = rng.uniform(0.3, 1.0, 8) * np.exp(-np.linspace(0.0, rng.uniform(0.0, 2.0), 8))
    return radii, weights / weights.sum()


def lie_by_temperature(scene: Scene, rng: np.random.Generator) -> list[Array]:
    """Stress of package, die attach and adhesive takes another way down than up."""
    radii, weights = _spread_plays(rng, scene.reach_k * rng.uniform(0.08, 0.3))
    bend, mix = rng.uniform(-0.15, 0.15), _mix(scene, rng)
    return [
        superpose_plays(place - ROOM_DEGC, radii, weights, 0.0, bend)[:, None] * mix
        for place in scene.place
    ]


def lie_by_load(scene: Scene, rng: np.random.Generator) -> list[Array]:
    """Material, joints and diaphragm take another way down than up, each output by its load."""
    radii, weights = _spread_plays(rng, scene.full_scale * rng.uniform(0.08, 0.3))
    bend, mix = rng.uniform(-0.15, 0.15), _mix(scene, rng)
    return [
        np.stack([superpose_plays(one, radii, weights, 0.0, bend) for one in run.load.T], axis=1)
        * mix
        for run in scene.runs
    ]


def creep_under_load(scene: Scene, rng: np.random.Generator) -> list[Array]:
    """Carrier and adhesive yield by a Prony series; a little faster when warm."""
    first = float(np.exp(rng.uniform(np.log(20.0), np.log(120.0))))
    ratio = rng.uniform(4.0, 8.0)
    shares = rng.dirichlet([4.0, 4.0, 4.0])
    terms = [(float(s), first * ratio**n) for n, s in enumerate(shares)]
    doubling_k = rng.uniform(40.0, 120.0)
    mix = _mix(scene, rng)
    found = []
    for run, place in zip(scene.runs, scene.place, strict=True):
        shift = 2.0 ** ((place - ROOM_DEGC) / doubling_k)
        per_output = [creep(one, shift, terms, run.step_s) for one in run.load.T]
        found.append(np.stack(per_output, axis=1) * mix)
    return found


def stretch_span(scene: Scene, rng: np.random.Generator) -> list[Array]:
    """The span moves with temperature: 1 / (1 + a dT) of a constant-voltage bridge, say."""
    bend, mix = rng.uniform(-4e-4, 4e-4), _mix(scene, rng)
    return [
        ((place - ROOM_DEGC) / (1.0 + bend * (place - ROOM_DEGC)))[:, None] * run.load * mix
        for run, place in zip(scene.runs, scene.place, strict=True)
    ]


def bend_by_load(scene: Scene, rng: np.random.Generator) -> list[Array]:
    """A diaphragm stiffens as it bulges; absorption saturates; a plate's Hall voltage bends."""
    kind, mix = rng.choice(["diaphragm", "absorption", "plate"]), _mix(scene, rng)
    strength = rng.uniform(0.1, 0.5)
    found = []
    for run in scene.runs:
        share = run.load / scene.full_scale
        if kind == "diaphragm":
            deflection = share / (1.0 + strength)
            for _ in range(30):
                slope = 1.0 + 3.0 * strength * deflection**2
                deflection -= (deflection + strength * deflection**3 - share) / slope
            told = deflection * (1.0 + strength)
        elif kind == "absorption":
            told = np.expm1(-strength * share) / np.expm1(-strength)
        else:
            told = share * (1.0 - strength * share**2) / (1.0 - strength)
        found.append((told - share) * mix)
    return found


def turn_axes(scene: Scene, rng: np.random.Generator) -> list[Array]:
    """The sensitive axes are turned against the case, and one feels what the other is given."""
    angles = rng.uniform(0.4, 1.0, 2) * rng.choice([-1.0, 1.0], 2)
    return [run.load[:, ::-1] * angles for run in scene.runs]


def follow_supply(scene: Scene, rng: np.random.Generator) -> list[Array]:
    """Zero and, a little, span go with the supply that is not quite ratiometric."""
    mix, of_span = _mix(scene, rng), rng.uniform(-0.4, 0.4)
    return [
        (run.inputs["supply"] - 5.0)[:, None] * (mix + of_span * run.load / scene.full_scale)
        for run in scene.runs
    ]


def take_up_water(scene: Scene, rng: np.random.Generator) -> list[Array]:
    """Water diffuses into a sheet from one side (Fick); its mean content swells the part.

    Or, of an electrochemical cell and of a bilayer, only the difference of surface and inside
    counts, which passes.
    """
    tau_s = float(np.exp(rng.uniform(np.log(400.0), np.log(5000.0))))
    sheet = build_chain(12, tau_s)
    passing, mix = bool(rng.random() < 0.25), _mix(scene, rng)
    found = []
    for run in scene.runs:
        outside = run.inputs["humidity"]
        inside = sheet.respond(outside, step_s=run.step_s).mean(axis=0)
        found.append((outside - inside if passing else inside - 40.0)[:, None] * mix)
    return found


def feel_weather(scene: Scene, rng: np.random.Generator) -> list[Array]:
    """Air presses on a sealed body; of a gas sensor the partial pressure counts as well."""
    mix, of_span = _mix(scene, rng), rng.uniform(0.0, 0.4)
    return [
        (run.inputs["pressure"] - 1013.25)[:, None] * (mix + of_span * run.load / scene.full_scale)
        for run in scene.runs
    ]


def see_light(scene: Scene, rng: np.random.Generator) -> list[Array]:
    """Light makes a current in every junction that it reaches, and a detector saturates."""
    full, mix = rng.uniform(4e3, 2e4), _mix(scene, rng)
    return [
        (run.inputs["ambient_light"] / (1.0 + run.inputs["ambient_light"] / full))[:, None] * mix
        for run in scene.runs
    ]


def feel_gravity(scene: Scene, rng: np.random.Generator) -> list[Array]:
    """A mass that is never perfectly balanced feels acceleration, and its square a little."""
    outputs = scene.zero.shape[1]
    linear = rng.normal(0.0, 1.0, (3, outputs))
    square = rng.normal(0.0, 0.02, (3, outputs))
    found = []
    for run in scene.runs:
        g = np.stack([run.inputs[f"acceleration_{a}"] for a in "xyz"], axis=1) / GRAVITY
        found.append(g @ linear + g**2 @ square)
    return found


def leak(scene: Scene, rng: np.random.Generator) -> list[Array]:
    """A junction's or an electrode's current by Arrhenius's law."""
    barrier_ev, mix = rng.uniform(0.5, 0.75), _mix(scene, rng)
    room = ROOM_DEGC + KELVIN
    return [
        np.exp(barrier_ev / BOLTZMANN_EV_PER_K * (1.0 / room - 1.0 / (place + KELVIN)))[:, None]
        * mix
        for place in scene.place
    ]


def grow_old(scene: Scene, rng: np.random.Generator) -> list[Array]:
    """Stress relaxes as the logarithm of time, or something is used up at a steady rate."""
    steady, mix = bool(rng.random() < 0.5), _mix(scene, rng)
    first_s = 86400.0 * rng.uniform(0.3, 3.0)
    found = []
    for run in scene.runs:
        age = run.start_s + run.time
        told = age / 864000.0 if steady else np.log1p(age / first_s)
        found.append(told[:, None] * mix)
    return found


EFFECTS: dict[str, Effect] = {
    "thermal_lag": lag_thermally,
    "thermal_gradient": bend_by_gradient,
    "warm_up": warm_up,
    "excitation_heating": heat_by_excitation,
    "thermal_hysteresis": lie_by_temperature,
    "load_hysteresis": lie_by_load,
    "creep": creep_under_load,
    "span_tempco": stretch_span,
    "load_nonlinearity": bend_by_load,
    "crosstalk": turn_axes,
    "supply_sensitivity": follow_supply,
    "humidity": take_up_water,
    "barometric_pressure": feel_weather,
    "ambient_light": see_light,
    "inertial_load": feel_gravity,
    "dark_current": leak,
    "ageing": grow_old,
}
"""Name in the catalogue -> what it is here."""


def heat_place(air: Array, follows_s: tuple[float, float], step_s: float) -> Array:
    """Return the temperature at the thermometer's place, shape (n,): air, housing, board."""
    housing, board = follows_s
    network = Network(
        np.array([housing, board]),
        np.array([[0.0, 1.0], [1.0, 0.0]]),
        np.array([1.0, 0.15]),
    )
    found: Array = network.respond(air, step_s=step_s)[1]
    return found
