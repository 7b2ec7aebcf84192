"""One specimen of the sensor: drawn by its seed, calibrated with test weights at room temperature.

The calibration is what the maker would do: weights of up to a fifth of full scale along every axis
and some in between, and a least-squares fit from converter codes to loads. Nothing of it is shared
with the command that fits real calibration logs.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from zerodrift.base.errors import InputError
from zerodrift_lab.twin.sensor import FULL_SCALE, draw_stream
from zerodrift_lab.twin.six_axis.electronics import (
    THERMOMETER_OFFSET,
    Noise,
    Reference,
    draw_noise,
    draw_reference,
    round_codes,
)
from zerodrift_lab.twin.six_axis.heat import ThermalNetwork, draw_network
from zerodrift_lab.twin.six_axis.optics import Couplers, draw_couplers
from zerodrift_lab.twin.six_axis.structure import Structure, draw_structure

Array = NDArray[np.float64]

CALIBRATION_ROOM = 23.0
"""degC of the room in which the test weights are hung on."""
CALIBRATION_SHARE = 0.2
"""Heaviest test weight as a share of full scale."""
READINGS = 50
"""Values averaged per test weight."""
STILL_AIR = 10.0
"""W/m2K in a room: natural convection and radiation together."""


@dataclass(frozen=True)
class Hidden:
    """One effect that is switched on in a specimen, beyond what its physics does by itself."""

    name: str
    parameters: Mapping[str, float]
    coefficients: Array | None
    """[6, m] for effects that add to the outputs; None for those on temperatures or converter."""
    size: float | None = None
    """RMS over the noise RMS in the bundled protocol `exercise`, pooled over outputs."""


@dataclass(frozen=True)
class Sensor:
    """One specimen."""

    seed: int | None
    """None: the nominal specimen, without unit-to-unit spread."""
    network: ThermalNetwork
    couplers: Couplers
    structure: Structure
    noise: Noise
    reference: Reference
    thermometer_offset: float
    """degC."""
    body_thermometer_offset: float
    """degC."""
    calibration: Array
    """[6, 6] each output's unit per code."""
    zero: Array
    """[6] codes without load at the calibration."""
    effects: tuple[Hidden, ...] = field(default=())

    @property
    def name(self) -> str:
        """How files call the specimen."""
        return "nominal" if self.seed is None else f"sensor_{self.seed}"

    @property
    def noise_rms(self) -> Array:
        """[6] RMS of the noise per output in its unit, the converter's steps included."""
        variance = self.noise.white**2 + self.noise.flicker**2 + 1.0 / 12.0
        rms: Array = np.sqrt((self.calibration**2) @ variance)
        return rms

    def stream(self, *names: str) -> np.random.Generator:
        """Return this specimen's random stream of that name."""
        return draw_stream(0 if self.seed is None else self.seed, "six axis", *names)

    def sense(self, load: Array, nodes: Array) -> Array:
        """Return the converter's codes [n, 6] before noise and rounding.

        `load` [n, 6] in the outputs' units, `nodes` [n, 13] in degC.
        """
        gap = self.couplers.rest_distance_mm + self.structure.open_gaps(load, nodes)
        return self.couplers.convert(gap, nodes)

    def to_load(self, codes: Array) -> Array:
        """Return raw forces and moments [n, 6] by the calibration matrix."""
        return (codes - self.zero) @ self.calibration.T

    def to_codes(self, load: Array) -> Array:
        """Return the codes [n, 6] that the calibration matrix would turn into this load."""
        return np.asarray(np.linalg.solve(self.calibration, load.T).T)

    def drift_span(self) -> Array:
        """Return the settled drift [6] from -20 to 60 degC without load."""
        ends = np.stack([self.network.settle(STILL_AIR, air) for air in (-20.0, 60.0)])
        cold, hot = self.to_load(self.sense(np.zeros((2, 6)), ends))
        return np.asarray(hot - cold)


def list_test_weights() -> Array:
    """Return the loads [m, 6] of a calibration: every axis both ways, and weights off the axis."""
    shares = np.array([0.25, 0.5, 0.75, 1.0]) * CALIBRATION_SHARE
    loads = [np.zeros(6)]
    for axis in range(6):
        for share in (*shares, *-shares):
            load = np.zeros(6)
            load[axis] = share * FULL_SCALE[axis]
            loads.append(load)
    # A weight on an arm presses and bends at once.
    for axis in (3, 4):
        for share in (*shares, *-shares):
            load = np.zeros(6)
            load[2] = abs(share) * FULL_SCALE[2]
            load[axis] = share * FULL_SCALE[axis]
            loads.append(load)
    return np.stack(loads)


def _calibrate(
    seed: int | None,
    network: ThermalNetwork,
    couplers: Couplers,
    structure: Structure,
    noise: Noise,
) -> tuple[Array, Array]:
    """Return the calibration matrix [6, 6] and the codes without load [6]."""
    loads = list_test_weights()
    nodes = np.repeat(network.settle(STILL_AIR, CALIBRATION_ROOM)[None], loads.shape[0], axis=0)
    gap = couplers.rest_distance_mm + structure.open_gaps(loads, nodes)
    codes = couplers.convert(gap, nodes)
    if seed is not None:
        rng = draw_stream(seed, "six axis", "calibration")
        scatter = rng.standard_normal((READINGS, *codes.shape)) * noise.white
        drifting = rng.standard_normal(codes.shape) * noise.flicker
        codes = round_codes(codes + scatter + drifting).mean(axis=0)
    design = np.column_stack([codes, np.ones(loads.shape[0])])
    solution, *_ = np.linalg.lstsq(design, loads, rcond=None)
    matrix = np.asarray(solution[:6].T)
    return matrix, np.asarray(-np.linalg.solve(matrix, solution[6]))


def draw_specimen(seed: int | None, noise: float = 1.0) -> Sensor:
    """Draw one specimen without any effect switched on; see `draw_sensor`."""
    if seed is not None and not 0 <= seed < 2**63:
        raise InputError(f"twin: sensor {seed}; expected a seed from 0 to 2^63 - 1.")
    if not 1e-3 <= noise <= 1e3:
        raise InputError(f"twin: noise factor is {noise:g}; expected 0.001 to 1000.")
    return _draw_specimen(seed, noise)


@lru_cache(maxsize=64)
def _draw_specimen(seed: int | None, noise_factor: float) -> Sensor:
    network, couplers, structure = draw_network(seed), draw_couplers(seed), draw_structure(seed)
    noise = draw_noise(seed, noise_factor)
    calibration, zero = _calibrate(seed, network, couplers, structure, noise)
    offsets = np.zeros(2)
    if seed is not None:
        rng = draw_stream(seed, "six axis", "thermometers")
        offsets = THERMOMETER_OFFSET * rng.standard_normal(2)
    return Sensor(
        seed,
        network,
        couplers,
        structure,
        noise,
        draw_reference(seed),
        float(offsets[0]),
        float(offsets[1]),
        calibration,
        zero,
    )
