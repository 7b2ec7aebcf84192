"""The elastic structure: from load and temperatures to the gaps in front of the couplers."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from zerodrift_lab.twin.sensor import FULL_SCALE, REFERENCE_TEMPERATURE, draw_stream
from zerodrift_lab.twin.six_axis.heat import NODE
from zerodrift_lab.twin.six_axis.optics import AZIMUTH, SIDE_A, VERTICAL

Array = NDArray[np.float64]

#: N/mm and Nmm/rad: 24 um at 600 N, 100 um at 2000 N, 40 um at the couplers at 14 Nm, 24 um there
#: at 20 Nm.
STIFFNESS: Array = np.array([25_000.0, 25_000.0, 20_000.0, 4.2e6, 4.2e6, 11.7e6])
#: N or Nmm per unit of the outputs, which are in N and Nm.
TO_NEWTON_MM: Array = np.array([1.0, 1.0, 1.0, 1000.0, 1000.0, 1000.0])
VERTICAL_RADIUS_MM = 12.0
HORIZONTAL_RADIUS_MM = 14.0

MODULUS_PERCENT_PER_K = -0.05
"""Aluminium 7075: some 5 % less at 120 than at 20 degC."""
ALUMINIUM_PPM_PER_K = 23.4
BOARD_THICKNESS_PPM_PER_K = 60.0
"""Glass-epoxy across its plane, below the glass transition."""
BOARD_PLANE_PPM_PER_K = 15.0
COUPLER_PPM_PER_K = 60.0
"""Epoxy package."""

COLUMN_MM = 9.0
"""From the board's seat up to the reflector: half beams, half top plate."""
PEDESTAL_MM = 5.9
BOARD_MM = 1.0
COUPLER_MM = 1.1
#: mm between the fixed points of reflector and coupler along the circumference.
SIDE_LEVER_MM: Array = np.array([0.0, 0.3, 0.0, -0.2, 0.0, 0.4])

CROSS_TALK = 0.02
"""Standard deviation of the compliance's off-diagonal entries, as a share of full scale."""


@dataclass(frozen=True)
class Structure:
    """The elastic structure of one specimen."""

    sensitivity: Array
    """[6, 6] gap in mm per unit of each output's load, at 25 degC."""
    modulus_percent_per_k: float
    aluminium_ppm_per_k: float
    column_mm: Array
    """[6]."""
    side_lever_mm: Array
    """[6]."""

    def open_gaps(self, load: Array, nodes: Array) -> Array:
        """Return by how much the gaps [n, 6] have opened, mm.

        `load` [n, 6] in the outputs' units, `nodes` [n, 13] in degC.
        """
        away = nodes - REFERENCE_TEMPERATURE

        def side(a: str, b: str) -> Array:
            mixed: Array = SIDE_A * away[:, NODE[a], None] + (1.0 - SIDE_A) * away[:, NODE[b], None]
            return mixed

        beams, top = away[:, NODE["beams"], None], away[:, NODE["top"], None]
        rim, base = side("rim_a", "rim_b"), side("base_a", "base_b")
        softer = 1.0 - 1e-2 * self.modulus_percent_per_k * beams
        bent = (load @ self.sensitivity.T) * softer
        grown = 0.5 * (beams + top) * self.column_mm * self.aluminium_ppm_per_k
        grown = grown - PEDESTAL_MM * self.aluminium_ppm_per_k * base
        grown = grown - BOARD_MM * BOARD_THICKNESS_PPM_PER_K * rim
        grown = grown - COUPLER_MM * COUPLER_PPM_PER_K * side("couplers_a", "couplers_b")
        turned = self.side_lever_mm * (
            self.aluminium_ppm_per_k * 0.5 * (beams + top) - BOARD_PLANE_PPM_PER_K * rim
        )
        opened: Array = bent + 1e-6 * np.where(VERTICAL, grown, turned)
        return opened


def draw_structure(seed: int | None) -> Structure:
    """Draw the structure of one specimen; None gives the nominal one."""
    # Couplers by columns: x, y, z, turns about x, y, z. A pressing load closes the vertical gaps.
    sine, cosine, zero = np.sin(AZIMUTH), np.cos(AZIMUTH), np.zeros(6)
    ones = np.ones(6)
    upward = np.stack(
        [zero, zero, -ones, VERTICAL_RADIUS_MM * sine, -VERTICAL_RADIUS_MM * cosine, zero], axis=1
    )
    sideways = np.stack(
        [-sine, cosine, zero, zero, zero, HORIZONTAL_RADIUS_MM * ones],
        axis=1,
    )
    geometry = np.where(VERTICAL[:, None], upward, sideways)
    compliance = np.diag(TO_NEWTON_MM / STIFFNESS)
    modulus, aluminium = MODULUS_PERCENT_PER_K, ALUMINIUM_PPM_PER_K
    column, lever = COLUMN_MM * ones, SIDE_LEVER_MM
    if seed is not None:
        rng = draw_stream(seed, "six axis", "structure")
        softness = np.diag(compliance) * np.exp(rng.normal(0.0, 0.05, 6))
        stretch = softness * FULL_SCALE
        cross = rng.normal(0.0, CROSS_TALK, (6, 6)) * stretch[:, None] / FULL_SCALE[None, :]
        np.fill_diagonal(cross, softness)
        compliance = cross
        geometry = geometry * (1.0 + 0.01 * rng.standard_normal((6, 6)))
        modulus = modulus * float(np.exp(rng.normal(0.0, 0.05)))
        aluminium = aluminium * float(np.exp(rng.normal(0.0, 0.02)))
        column = column * (1.0 + 0.005 * rng.standard_normal(6))
        lever = lever + np.where(VERTICAL, 0.0, 0.1) * rng.standard_normal(6)
    return Structure(geometry @ compliance, modulus, aluminium, column, lever)
