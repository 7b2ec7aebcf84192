"""Networks of heat, of water in a solid, and of viscoelastic strain, by their exact modes.

Each is linear with real modes: capacities and conductances between nodes, one boundary from which
the network is driven, and a source within. A mode is stepped exactly for an input that is a
straight line over the step, and the step is a fraction of that at which logs are written, so that
what comes out is no first-order closed form at the log's own step.

Source: Incropera, DeWitt, Fundamentals of Heat and Mass Transfer, ch. 5 (lumped capacities, finite
volumes); Crank, The Mathematics of Diffusion, ch. 4 (a plane sheet); Ferry, Viscoelastic Properties
of Polymers, ch. 3 and 11 (Prony series, shift of time with temperature).
"""

from dataclasses import dataclass
from functools import cached_property
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

Array: TypeAlias = NDArray[np.float64]
Flags: TypeAlias = NDArray[np.bool_]
BLOCK = 128


def recur(factor: float, driven: Array, start: float) -> Array:
    """Return x of x[n] = factor x[n-1] + driven[n] with x[-1] = `start`; shape (n,).

    Blocks of samples are one product with a triangle of powers; nothing is approximated.
    """
    size = driven.size
    blocks = -(-size // BLOCK)
    padded = np.zeros(blocks * BLOCK)
    padded[:size] = driven
    powers = factor ** np.arange(BLOCK + 1)
    index = np.subtract.outer(np.arange(BLOCK), np.arange(BLOCK))
    triangle = np.where(index >= 0, powers[np.abs(index)], 0.0)
    inner = padded.reshape(blocks, BLOCK) @ triangle.T
    state = start
    for row in range(blocks):
        inner[row] += powers[1:] * state
        state = float(inner[row, -1])
    return inner.ravel()[:size]


def relax(driven: Array, tau_s: float, step_s: float, start: float | None = None) -> Array:
    """Return x of tau dx/dt + x = driven, a straight line between samples; shape (n,).

    Args:
        driven: shape (n,), its samples `step_s` apart.
        tau_s: time constant, s.
        step_s: s.
        start: x at the first sample; left out, at rest with the first of `driven`.
    """
    x0 = float(driven[0]) if start is None else start
    ratio = step_s / tau_s
    factor = np.exp(-ratio)
    mean = -np.expm1(-ratio) / ratio
    moved = np.empty_like(driven)
    moved[0] = 0.0
    moved[1:] = (mean - factor) * driven[:-1] + (1.0 - mean) * driven[1:]
    found = recur(float(factor), moved[1:], x0) if driven.size > 1 else np.empty(0)
    return np.concatenate([[x0], found])


@dataclass(frozen=True, eq=False)
class Network:
    """Nodes that store heat (or water), joined by conductances, driven at one boundary.

    Attributes:
        capacity: shape (nodes,), J/K.
        joined: shape (nodes, nodes), symmetric, W/K between nodes.
        outside: shape (nodes,), W/K to the boundary.
    """

    capacity: Array
    joined: Array
    outside: Array

    @cached_property
    def modes(self) -> tuple[Array, Array]:
        """Rates (nodes,), 1/s, and the modes (nodes, nodes), orthonormal in heat."""
        laplacian = np.diag(self.joined.sum(axis=1) + self.outside) - self.joined
        root = np.sqrt(self.capacity)
        rates, modes = np.linalg.eigh(laplacian / np.outer(root, root))
        return rates, modes / root[:, None]

    def respond(
        self, boundary: Array, power: Array | None = None, at: int = 0, step_s: float = 1.0
    ) -> Array:
        """Return the nodes' temperatures, shape (nodes, n), at rest at the first sample.

        Args:
            boundary: shape (n,), the temperature that drives the network.
            power: shape (n,), W into node `at`; before the first sample it was 0.
            at: node.
            step_s: s.
        """
        rates, modes = self.modes
        found = np.zeros((self.capacity.size, boundary.size))
        for rate, mode in zip(rates, modes.T, strict=True):
            drive = (mode @ self.outside) * boundary / rate
            start = float(drive[0])
            if power is not None:
                drive = drive + mode[at] * power / rate
            found += mode[:, None] * relax(drive, 1.0 / float(rate), step_s, start)
        return found


def build_chain(nodes: int, tau_s: float, last_share: float = 1.0) -> Network:
    """Return `nodes` equal volumes in a row, driven at the first one's end.

    Args:
        nodes: at least 2.
        tau_s: the slowest mode's time constant, s.
        last_share: capacity of the last node over that of the others.
    """
    capacity = np.ones(nodes)
    capacity[-1] = last_share
    joined = np.zeros((nodes, nodes))
    for node in range(nodes - 1):
        joined[node, node + 1] = joined[node + 1, node] = 1.0
    outside = np.zeros(nodes)
    outside[0] = 2.0
    slowest = 1.0 / float(Network(capacity, joined, outside).modes[0].min())
    return Network(capacity * tau_s / slowest, joined, outside)


def creep(load: Array, shift: Array, terms: list[tuple[float, float]], step_s: float) -> Array:
    """Return the delayed strain of a Prony series under `load`, shape (n,).

    Args:
        load: shape (n,).
        shift: shape (n,), how many times faster the material is than at its reference temperature.
        terms: (share, time constant in s) of each retarded element.
        step_s: s.
    """
    shares = np.array([share for share, _ in terms])
    rates = 1.0 / np.array([tau for _, tau in terms])
    decay = np.exp(-np.outer(shift * step_s, rates))
    middle = 0.5 * (load[1:] + load[:-1])
    state = np.full(shares.size, load[0])
    found = np.empty_like(load)
    found[0] = shares @ state
    for row, now in enumerate(middle, start=1):
        state = now + (state - now) * decay[row]
        found[row] = shares @ state
    return found
