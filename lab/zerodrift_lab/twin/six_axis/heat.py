"""Thirteen thermal nodes between sole and top plate, with two ways in for heat.

The air reaches the sensor from all sides; a plate under the sole or an infrared lamp reaches it
from one side. Side A faces the lamp. Capacities are masses times specific heats, conductances
follow from sections, lengths and film coefficients; docs/reference/six-axis-twin.md lists them.
"""

import itertools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from zerodrift_lab.twin.integrate import solve_network
from zerodrift_lab.twin.sensor import draw_stream

Array = NDArray[np.float64]

NODES = (
    "sole",
    "cover",
    "base_a",
    "base_b",
    "beams",
    "top",
    "inner_air",
    "board",
    "rim_a",
    "rim_b",
    "couplers_a",
    "couplers_b",
    "mcu",
)
NODE = {name: k for k, name in enumerate(NODES)}

#: J/K. Aluminium 0.9 J/gK: sole with its rubber 6 g, cover 6 g, base 10 g, beams 3.5 g, top 11 g;
#: board 3 g of glass-epoxy and copper at 1 J/gK; couplers 30 mg each; 45 g with screws and plug.
CAPACITY = {
    "sole": 6.0,
    "cover": 5.4,
    "base_a": 4.5,
    "base_b": 4.5,
    "beams": 3.2,
    "top": 9.9,
    "inner_air": 0.1,
    "board": 1.2,
    "rim_a": 0.9,
    "rim_b": 0.9,
    "couplers_a": 0.09,
    "couplers_b": 0.09,
    "mcu": 0.15,
}

#: W/K between nodes.
CONDUCTANCE = {
    ("sole", "base_a"): 0.30,
    ("sole", "base_b"): 0.30,
    ("base_a", "base_b"): 0.50,
    ("base_a", "cover"): 0.12,
    ("base_b", "cover"): 0.12,
    ("base_a", "beams"): 0.35,
    ("base_b", "beams"): 0.35,
    ("beams", "top"): 0.60,
    ("base_a", "rim_a"): 0.06,
    ("base_b", "rim_b"): 0.06,
    ("rim_a", "board"): 0.06,
    ("rim_b", "board"): 0.06,
    ("rim_a", "couplers_a"): 0.02,
    ("rim_b", "couplers_b"): 0.02,
    ("board", "mcu"): 0.05,
    ("inner_air", "cover"): 0.015,
    ("inner_air", "beams"): 0.010,
    ("inner_air", "top"): 0.010,
    ("inner_air", "board"): 0.008,
    ("inner_air", "rim_a"): 0.004,
    ("inner_air", "rim_b"): 0.004,
    ("inner_air", "couplers_a"): 0.0015,
    ("inner_air", "couplers_b"): 0.0015,
    ("inner_air", "mcu"): 0.001,
}

#: m2 that the outer air washes; a cylinder of 40 mm and 25 mm height.
OUTER_AREA = {"cover": 19e-4, "base_a": 6e-4, "base_b": 6e-4, "top": 12.6e-4, "sole": 12.6e-4}

PLATE_CONDUCTANCE = 0.15
"""W/K from a plate into the sole: 2 mm of rubber, 0.25 W/mK, over 12.6 cm2."""

#: Where the power of the lamp lands, which stands at side A.
LAMP_SHARE = {"cover": 0.50, "base_a": 0.35, "top": 0.15}

#: W that the electronics turn into heat: six LEDs, microcontroller, regulator and transceiver.
OWN_POWER = {"couplers_a": 0.024, "couplers_b": 0.024, "mcu": 0.040, "board": 0.030}

UNIT_SPREAD = 0.10
"""Unit-to-unit spread (log standard deviation) of every capacity and conductance."""


@dataclass(frozen=True)
class ThermalNetwork:
    """The thermal network of one specimen."""

    capacity: Array
    """[13] J/K."""
    inner: Array
    """[13, 13] W/K between nodes, symmetric, zero diagonal."""
    outer_area: Array
    """[13] m2 to the outer air, contact resistances included as a spread."""
    plate_conductance: float
    """W/K from a plate into the sole."""

    def _outside(self, airflow: float, on_plate: bool) -> tuple[Array, Array]:
        """Return the conductances [13] to the air and to the plate, W/K."""
        to_air = self.outer_area * airflow
        to_plate = np.zeros_like(to_air)
        if on_plate:
            to_air = to_air.copy()
            to_air[NODE["sole"]] = 0.0
            to_plate[NODE["sole"]] = self.plate_conductance
        return to_air, to_plate

    def build_system(self, airflow: float, on_plate: bool) -> Array:
        """Return the matrix [13, 13] of dT/dt = system T + drive, per second.

        `airflow` is the film coefficient of the outer air, W/m2K.
        """
        to_air, to_plate = self._outside(airflow, on_plate)
        balance = self.inner - np.diag(self.inner.sum(axis=1) + to_air + to_plate)
        return balance / self.capacity[:, None]

    def build_drive(
        self,
        airflow: float,
        on_plate: bool,
        air: Array,
        plate: Array,
        lamp: Array,
        power: Array,
    ) -> Array:
        """Return what drives the nodes [n, 13], K/s.

        `air` and `plate` in degC, `lamp` in W onto the sensor, `power` the electronics' on/off
        share, all [n].
        """
        to_air, to_plate = self._outside(airflow, on_plate)
        watts = air[:, None] * to_air + plate[:, None] * to_plate
        for name, share in LAMP_SHARE.items():
            watts[:, NODE[name]] += share * lamp
        for name, own in OWN_POWER.items():
            watts[:, NODE[name]] += own * power
        return watts / self.capacity

    def settle(self, airflow: float, air: float, power: float = 1.0) -> Array:
        """Return the temperatures [13] at rest in still surroundings, degC."""
        one = np.ones(1)
        drive = self.build_drive(airflow, False, air * one, air * one, 0 * one, power * one)
        return -np.linalg.solve(self.build_system(airflow, False), drive[0])


def draw_network(seed: int | None) -> ThermalNetwork:
    """Draw the thermal network of one specimen; None gives the nominal one."""
    count = len(NODES) + len(CONDUCTANCE) + len(OUTER_AREA) + 1
    spread = np.ones(count)
    if seed is not None:
        rng = draw_stream(seed, "six axis", "heat")
        spread = np.exp(rng.normal(0.0, UNIT_SPREAD, count))
    draws = iter(spread.tolist())
    capacity = np.array([CAPACITY[name] * next(draws) for name in NODES])
    inner = np.zeros((len(NODES), len(NODES)))
    for (a, b), value in CONDUCTANCE.items():
        inner[NODE[a], NODE[b]] = inner[NODE[b], NODE[a]] = value * next(draws)
    area = np.zeros(len(NODES))
    for name, value in OUTER_AREA.items():
        area[NODE[name]] = value * next(draws)
    return ThermalNetwork(capacity, inner, area, PLATE_CONDUCTANCE * next(draws))


@dataclass(frozen=True)
class Surroundings:
    """What a run exposes the sensor to, on a uniform fine grid of `step_s`, [n] each."""

    step_s: float
    air: Array
    """degC."""
    plate: Array
    """degC of what the sole stands on, where it stands on a plate."""
    on_plate: NDArray[np.bool_]
    lamp: Array
    """W."""
    airflow: Array
    """W/m2K, constant between switches."""
    powered_before: bool
    """False: everything begins at the air's temperature and the electronics are switched on."""


def warm(network: ThermalNetwork, around: Surroundings) -> Array:
    """Return the temperatures [n, 13] of one run in degC, from rest in the first surroundings.

    Between switches of plate and airflow the network is linear and every mode is solved exactly
    for a drive that is straight between grid points.
    """
    count = around.air.size
    power = np.ones(count)
    first = slice(0, 1)

    def drive(part: slice, on: Array) -> Array:
        at = part.start
        return network.build_drive(
            float(around.airflow[at]),
            bool(around.on_plate[at]),
            around.air[part],
            around.plate[part],
            around.lamp[part],
            on,
        )

    system = network.build_system(float(around.airflow[0]), bool(around.on_plate[0]))
    start_power = power[first] if around.powered_before else np.zeros(1)
    state = -np.linalg.solve(system, drive(first, start_power)[0])
    changed = (np.diff(around.airflow) != 0) | (np.diff(around.on_plate.astype(np.int8)) != 0)
    bounds = [0, *(np.flatnonzero(changed) + 1).tolist(), count - 1]
    temperatures = np.empty((count, len(NODES)))
    temperatures[0] = state
    for begin, end in itertools.pairwise(bounds):
        if end <= begin:
            continue
        part = slice(begin, end + 1)
        system = network.build_system(float(around.airflow[begin]), bool(around.on_plate[begin]))
        solved, _ = solve_network(system, drive(part, power[part]), around.step_s, state)
        temperatures[part] = solved
        state = solved[-1]
    return temperatures


RESPONSE_STEPS = 4000


def measure_rise(
    network: ThermalNetwork,
    what: str,
    airflow: float,
    on_plate: bool,
    after_s: float,
    ramp_s: float,
) -> float:
    """Return how far the board has moved `after_s` after a unit change that took `ramp_s`.

    `what` is `lamp` (K per W) or `plate` (K per K of the plate); all else at rest.
    """
    time_s = np.linspace(0.0, after_s, RESPONSE_STEPS + 1)
    zero, change = np.zeros_like(time_s), np.minimum(time_s / ramp_s, 1.0)
    lamp, plate = (change, zero) if what == "lamp" else (zero, change)
    system = network.build_system(airflow, on_plate)
    drive = network.build_drive(airflow, on_plate, zero, plate, lamp, zero)
    solved, _ = solve_network(system, drive, after_s / RESPONSE_STEPS, np.zeros(len(NODES)))
    return float(solved[-1, NODE["board"]])


def measure_touch(network: ThermalNetwork, airflow: float, after_s: float) -> float:
    """Return how far the board has moved `after_s` after rest ended on a plate as warm as the air.

    The sensor's own heat then leaves through the plate too, K.
    """
    count = RESPONSE_STEPS + 1
    zero, one = np.zeros(count), np.ones(count)
    start = network.settle(airflow, 0.0)
    drive = network.build_drive(airflow, True, zero, zero, zero, one)
    system = network.build_system(airflow, True)
    solved, _ = solve_network(system, drive, after_s / RESPONSE_STEPS, start)
    return float(solved[-1, NODE["board"]] - start[NODE["board"]])
