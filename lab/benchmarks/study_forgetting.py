"""GRUs trained freely: how far is each criterion of forgetting from being met?

    python -m benchmarks.study_forgetting --first 9300 --seeds 4

Specimens of the six-axis twin, all simulated, trained as in `bench_contracting`. Each network is
given temperatures within the range and rate of its logs, which swing between two ends and hold
there, from seconds to hours; each from states that lie anywhere. Printed are, each the largest over
what was tried, so that the truth is no smaller:

- step: the radius of what a step makes of errors, each unit's set against its own update gate u:
  |J_ij| / u_i beside the diagonal and 1 - (1 - |J_ii|) / u_i on it, each the largest that occurred.
  From 1 on no one matrix of bounds, entry by entry, shows that a step shrinks errors, however the
  units are weighed. Bounds that tell inputs and states apart may still.
- product k: the radius of |J_k ... J_1|, each entry the largest that occurred: the same of k steps.
- left k: how far two states are apart, 2 being all there is, after k steps of the same input; and
  how far the answers are, in % of full scale.
- range: what the answers can be off, in % of full scale, if nothing is known of the states but that
  they lie between -1 and 1.
"""

import argparse
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from benchmarks.bench_contracting import SIZES, make_project
from zerodrift.base.arrays import Array
from zerodrift.dataset.runs import Run
from zerodrift.export.compose import describe_compensator
from zerodrift.export.float_model import FloatModel
from zerodrift.export.float_network import FloatNetwork
from zerodrift.operations.gru.cell import FloatGru
from zerodrift.physics.catalogue import load_catalogue
from zerodrift.train.training import train_together

HOLDS = (5, 20, 80, 300, 1200, 6000)
"""Steps at each end, before it goes on to the other."""
STEPS = 3400
AFTER = 200
"""Steps before any Jacobian counts: states anywhere are left behind."""
SPANS = (64, 400)
LEFT = (400, 3000)
PAIRS = 4


@dataclass(frozen=True)
class Forgetting:
    """What was found of a network; see above."""

    step: float
    products: tuple[float, ...]
    left: tuple[float, ...]
    left_percent: tuple[float, ...]
    range_percent: float


def find_jacobians(gru: FloatGru, x: Array, h: Array) -> tuple[Array, Array]:
    """Return d h' / d h [B, H, H] and u [B, H] at features [B, I] and states [B, H]."""
    r, u = (
        1.0 / (1.0 + np.exp(-(x @ gru.w_x[g].T + gru.bias[g] + h @ gru.w_h[g].T))) for g in (0, 1)
    )
    of_r = (r * (1.0 - r))[:, :, None] * gru.w_h[0]
    if gru.reset == "after":
        inside = h @ gru.w_h[2].T + gru.bias[3]
        argument = r * inside
        of_argument = r[:, :, None] * gru.w_h[2] + inside[:, :, None] * of_r
    else:
        argument = (r * h) @ gru.w_h[2].T
        of_argument = gru.w_h[2] @ (of_r * h[:, :, None] + r[:, :, None] * np.eye(h.shape[1]))
    n = np.tanh(x @ gru.w_x[2].T + gru.bias[2] + argument)
    moved = (u * (1.0 - u) * (n - h))[:, :, None] * gru.w_h[1]
    followed = (u * (1.0 - n**2))[:, :, None] * of_argument
    return (1.0 - u)[:, :, None] * np.eye(h.shape[1]) + moved + followed, u


def find_radius(matrix: Array) -> float:
    """Return the largest absolute eigenvalue."""
    return float(np.abs(np.linalg.eigvals(matrix)).max())


def measure(network: FloatNetwork, x: Array, full_scale: Array, seed: int) -> Forgetting:
    """Return what is found with features [B, T, I]."""
    (gru,) = network.grus
    hidden = gru.w_h.shape[1]
    rng = np.random.default_rng(seed)
    x = np.repeat(x, 2 * PAIRS, axis=0)
    h = rng.uniform(-1.0, 1.0, (len(x), hidden))
    worst = np.zeros((hidden, hidden))
    products = {k: np.zeros((hidden, hidden)) for k in SPANS}
    running = {k: np.tile(np.eye(hidden), (len(x), 1, 1)) for k in SPANS}
    left, percent = [], []
    own = np.arange(hidden)
    for t in range(x.shape[1]):
        if t >= AFTER:
            step, u = find_jacobians(gru, x[:, t], h)
            growth = np.abs(step) / u[:, :, None]
            growth[:, own, own] += 1.0 - 1.0 / u
            worst = np.maximum(worst, growth.max(axis=0))
            for k in SPANS:
                running[k] = step @ running[k]
                if (t - AFTER + 1) % k == 0:
                    products[k] = np.maximum(products[k], np.abs(running[k]).max(axis=0))
                    running[k] = np.tile(np.eye(hidden), (len(x), 1, 1))
        h = gru.step(x[:, t], h)
        if t + 1 in LEFT:
            left.append(float(np.abs(h[::2] - h[1::2]).max()))
            answers = network.answer_from(x[:, t], 0, {1: h})
            percent.append(float((np.abs(answers[::2] - answers[1::2]) / full_scale).max()))
    reach = 2.0 * np.abs(network.head).sum(axis=1) / full_scale
    return Forgetting(
        find_radius(worst),
        tuple(find_radius(products[k]) for k in SPANS),
        tuple(left),
        tuple(100.0 * one for one in percent),
        float(100.0 * reach.max()),
    )


def draw_features(described: FloatModel, runs: Sequence[Run], rate: float, seed: int) -> Array:
    """Return the network's features [B, T, I] of temperatures that swing at the largest rate.

    Args:
        described: the model.
        runs: that it was trained on.
        rate: the largest change of temperature in a step, K.
        seed: of the ends and of the place to begin at.
    """
    rng = np.random.default_rng(seed)
    known = np.concatenate([run.temperature_degC for run in runs])
    low, high = known.min(), known.max()
    pattern, found = runs[0], []
    length = min(STEPS, len(pattern.temperature_degC))
    for number, hold in enumerate(HOLDS * 2):
        ends = (low, high) if number < len(HOLDS) else np.sort(rng.uniform(low, high, 2))
        now, first, course = rng.uniform(*ends), int(rng.integers(2 * hold)), []
        for t in range(length):
            wanted = ends[(t + first) // hold % 2]
            now += np.clip(wanted - now, -rate, rate)
            course.append(now)
        temperature = pattern.temperature_degC.copy()
        temperature[:length] = course
        run = replace(pattern, temperature_degC=temperature)
        found.append(described.compute_network_inputs(run)[:length])
    return np.stack(found)


def study(first: int, seeds: int, sizes: Sequence[int]) -> None:
    """Train and print."""
    projects = [make_project(number) for number in range(first, first + seeds)]
    every = []
    for hidden in sizes:
        given = [
            (replace(c, network=replace(c.network, kind="gru", hidden=hidden, seed=first + k)), d)
            for k, (c, d) in enumerate(projects)
        ]
        for number, ((config, dataset), answer) in enumerate(
            zip(given, train_together(given, load_catalogue()), strict=True), first
        ):
            if isinstance(answer, Exception):
                raise answer
            described = describe_compensator(answer.compensator, config, dataset.train)
            if described.network is None:
                print(f"{hidden} units, specimen {number}: training left the network out")
                continue
            rate = max(float(np.abs(np.diff(r.temperature_degC)).max()) for r in dataset.train)
            x = draw_features(described, dataset.train, rate, number)
            found = measure(described.network, x, np.array(answer.scores.full_scale), number)
            every.append(found)
            print(f"{hidden:3d} units, specimen {number}: {_tell(found)}", flush=True)
    _sum_up(every)


def _tell(found: Forgetting) -> str:
    products = ", ".join(f"product {k} {x:.2g}" for k, x in zip(SPANS, found.products, strict=True))
    left = ", ".join(
        f"left {k} {x:.2g} ({y:.2g} %)"
        for k, x, y in zip(LEFT, found.left, found.left_percent, strict=True)
    )
    return f"step {found.step:.2f}, {products}, {left}, range {found.range_percent:.2f} %"


def _sum_up(every: Sequence[Forgetting]) -> None:
    steps = np.array([one.step for one in every])
    print(f"of {len(every)}: step below 1 in {(steps < 1.0).sum()}, least {steps.min():.2f}")
    for place, k in enumerate(SPANS):
        products = np.array([one.products[place] for one in every])
        print(
            f"  product {k} below 1 in {(products < 1.0).sum()}, median {np.median(products):.2g}"
        )
    for place, k in enumerate(LEFT):
        left = np.array([one.left[place] for one in every])
        print(f"  left {k} at most 0.001 in {(left <= 1e-3).sum()}, median {np.median(left):.2g}")
    reach = np.array([one.range_percent for one in every])
    print(
        f"  range at most 0.5 % in {(reach <= 0.5).sum()}, {reach.min():.2f} to {reach.max():.2f} %"
    )


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--first", type=int, default=9300)
    parser.add_argument("--seeds", type=int, default=4)
    parser.add_argument("--sizes", type=int, nargs="+", default=SIZES)
    options = parser.parse_args()
    study(options.first, options.seeds, options.sizes)
