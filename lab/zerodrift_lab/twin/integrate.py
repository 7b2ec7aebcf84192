"""Integration of linear storages: exact between fine steps, for inputs that are straight there.

This is the generator's own integrator. It runs on a grid several times finer than the logs and
shares nothing with the code that fits models to them.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

Array = NDArray[np.float64]


def relax(signal: Array, tau_s: float, step_s: float, start: Array | float | None = None) -> Array:
    """Solve tau dx/dt = signal - x on a uniform grid, exactly for a piecewise linear signal.

    `signal` is [n] or [n, m], `step_s` the grid's step. `start` is x at the first instant; left
    out, the storage begins at rest, x = signal[0].

    Returns x, shaped as `signal`.

    Source: variation of constants; over one step of q = step/tau,
    x1 = e^-q x0 + ((1 - e^-q)/q - e^-q) u0 + (1 - (1 - e^-q)/q) u1.
    """
    q = step_s / tau_s
    decay = float(np.exp(-q))
    mean_decay = float(-np.expm1(-q) / q)
    weight_old, weight_new = mean_decay - decay, 1.0 - mean_decay
    first = signal[0] if start is None else np.broadcast_to(start, signal[0].shape)
    state: Any = np.asarray(first - weight_new * signal[0])[None]
    solution, _ = lfilter([weight_new, weight_old], [1.0, -decay], signal, axis=0, zi=state)
    return np.asarray(solution, dtype=np.float64)


def solve_network(system: Array, drive: Array, step_s: float, start: Array) -> tuple[Array, Array]:
    """Solve dx/dt = system x + drive by its modes, each of them exactly.

    `system` is [m, m] of a passive thermal network, hence with real negative eigenvalues; `drive`
    is [n, m], straight between grid points; `start` is x [m] at the first instant.

    Returns x [n, m] and dx/dt [n, m].
    """
    eigenvalues, modes = np.linalg.eig(system)
    if np.any(eigenvalues.imag != 0.0) or np.any(eigenvalues.real >= 0.0):
        raise ValueError("a passive thermal network has real negative eigenvalues only")
    eigenvalues, modes = eigenvalues.real, modes.real  # complex in type since NumPy 2.5
    to_modes = np.linalg.inv(modes)
    modal_drive = drive @ to_modes.T
    modal_start = to_modes @ start
    modal = np.empty_like(modal_drive)
    for j, eigenvalue in enumerate(eigenvalues):
        tau_s = -1.0 / float(eigenvalue)
        modal[:, j] = relax(modal_drive[:, j] * tau_s, tau_s, step_s, float(modal_start[j]))
    solution = modal @ modes.T
    return solution, solution @ system.T + drive
