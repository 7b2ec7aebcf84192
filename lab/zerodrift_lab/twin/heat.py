"""The sensor's heat: shell, elastic body and board, warmed by air, by contact and by radiation.

Heat reaches the board, where the thermometer sits, on two paths: through the body's structure
and straight from the air inside. About 45 g of aluminium, so everything moves within minutes.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from zerodrift_lab.twin.integrate import solve_network
from zerodrift_lab.twin.sensor import draw_stream

Array = NDArray[np.float64]

SHELL, BODY, BOARD = 0, 1, 2


@dataclass(frozen=True)
class HeatNetwork:
    """Heat capacities and conductances of one sensor."""

    capacity_j_per_k: Array
    """[3] of shell, body and board."""
    air_to_shell: float
    """W/K."""
    contact_to_shell: float
    """W/K, through the sole of the foot."""
    shell_to_body: float
    """W/K."""
    body_to_board: float
    """W/K."""
    air_to_board: float
    """W/K."""

    def build_system(self) -> Array:
        """Return the matrix [3, 3] of dx/dt = system x + ..., per second."""
        conductance = np.zeros((3, 3))
        for a, b, value in (
            (SHELL, BODY, self.shell_to_body),
            (BODY, BOARD, self.body_to_board),
        ):
            conductance[a, b] = conductance[b, a] = value
        to_outside = np.array([self.air_to_shell + self.contact_to_shell, 0.0, self.air_to_board])
        balance = conductance - np.diag(conductance.sum(axis=1) + to_outside)
        return balance / self.capacity_j_per_k[:, None]

    def build_drive(self, air: Array, contact: Array, infrared: Array, board: Array) -> Array:
        """Return what drives the nodes [n, 3], in K/s.

        `air` and `contact` are temperatures in degC, `infrared` (onto the shell) and `board` (the
        electronics' own heat) powers in W, all [n].
        """
        power = np.zeros((air.size, 3))
        power[:, SHELL] = self.air_to_shell * air + self.contact_to_shell * contact + infrared
        power[:, BOARD] = self.air_to_board * air + board
        return power / self.capacity_j_per_k


@dataclass(frozen=True)
class HeatHistory:
    """Temperatures of one run on the fine grid, all [n]."""

    body: Array
    """degC of the elastic body."""
    chip: Array
    """degC of the board, which is what the thermometer feels."""
    chip_rate: Array
    """K/s of the board."""
    body_rate: Array
    """K/s of the elastic body."""


def draw_heat_network(seed: int) -> HeatNetwork:
    """Draw the heat network of the sensor with this seed; unit-to-unit spread of some 15 %."""
    rng = draw_stream(seed, "heat network")
    spread = np.exp(rng.normal(0.0, 0.15, 8))
    return HeatNetwork(
        capacity_j_per_k=np.array([18.0, 20.0, 4.0]) * spread[:3],
        air_to_shell=0.10 * float(spread[3]),
        contact_to_shell=0.12 * float(spread[4]),
        shell_to_body=0.50 * float(spread[5]),
        body_to_board=0.08 * float(spread[6]),
        air_to_board=0.04 * float(spread[7]),
    )


def warm(
    network: HeatNetwork,
    step_s: float,
    air: Array,
    contact: Array,
    infrared: Array,
    board: Array,
    powered_before: bool,
) -> HeatHistory:
    """Integrate one run that begins at rest in the first instant's surroundings.

    With `powered_before` the electronics' own heat has already spread; otherwise the run begins
    with the power-on and everything is at the temperature of the surroundings.
    """
    system = network.build_system()
    drive = network.build_drive(air, contact, infrared, board)
    cold_board = np.zeros_like(board[:1])
    first = drive[:1]
    if not powered_before:
        first = network.build_drive(air[:1], contact[:1], infrared[:1], cold_board)
    start = -np.linalg.solve(system, first[0])
    temperature, rate = solve_network(system, drive, step_s, start)
    return HeatHistory(
        body=temperature[:, BODY],
        chip=temperature[:, BOARD],
        chip_rate=rate[:, BOARD],
        body_rate=rate[:, BODY],
    )


def measure_response(network: HeatNetwork, input_name: str, after_s: float) -> float:
    """Return how far the chip has warmed `after_s` after a unit step of one input.

    `input_name` is `infrared` (K per W) or `contact` (K per K).
    """
    count = 2001
    zero, one = np.zeros(count), np.ones(count)
    infrared, contact = (one, zero) if input_name == "infrared" else (zero, one)
    system = network.build_system()
    drive = network.build_drive(zero, contact, infrared, zero)
    temperature, _ = solve_network(system, drive, after_s / (count - 1), np.zeros(3))
    return float(temperature[-1, BOARD])
