"""Complete models whose runs have offsets of their own: is one of them given an ageing?

Cases of the third simulator that lack nothing, with a clock and an offset drawn for each run and
output: `normal`; `heavy` (Student's t of two degrees of freedom: one run is far off); `handled`
(the sensor was mounted anew two or three times, runs in between share an offset); `walk` (each run
begins where the last one ended, and drifts on: no tare, but no law of the clock either). Or with
`line`, `root` and `logarithm`, ageings by these laws. Sizes are 1 to 30 times the noise.

    python -m benchmarks.study_offsets KIND [--count N] [--seed N] [--minutes M]

All logs are simulated. Rates stand beside their one-sided 95 % Clopper-Pearson bound.
"""

import argparse
import time
from collections import Counter
from dataclasses import replace

import numpy as np

from benchmarks.evidence.conditions import Ask, Condition
from benchmarks.evidence.sources import Drawn, draw
from benchmarks.evidence.tables import tell_least, tell_most
from zerodrift.base.arrays import Array
from zerodrift.base.errors import InputError
from zerodrift.dataset.runs import Dataset, Run
from zerodrift.diagnosis.diagnose import diagnose

AGEING = ("line", "root", "logarithm")
KINDS = ("normal", "heavy", "handled", "walk", *AGEING)
DAY_S = 86400.0


def draw_offsets(kind: str, days: Array, outputs: int, rng: np.random.Generator) -> Array:
    """Return offsets [R, outputs] of an RMS of 1 over the runs, by when these were (days [R])."""
    runs = days.size
    if kind in AGEING:
        age = days - days.min() + rng.uniform(0.3, 3.0)
        law = {"line": age, "root": np.sqrt(age), "logarithm": np.log(age)}[kind]
        offsets = law[:, None] * rng.choice([-1.0, 1.0], outputs) * rng.uniform(0.3, 1.0, outputs)
    elif kind == "handled":
        mounts = np.sort(rng.choice(np.arange(1, runs), min(runs - 1, int(rng.integers(1, 3)))))
        times = np.searchsorted(mounts, np.argsort(np.argsort(days)), side="right")
        offsets = rng.normal(size=(runs, outputs))[times]
    elif kind == "walk":
        order = np.argsort(days)
        steps = rng.normal(size=(runs, outputs))
        offsets = np.empty_like(steps)
        offsets[order] = np.cumsum(steps, axis=0)
    elif kind == "heavy":
        offsets = rng.standard_t(2.0, size=(runs, outputs))
    else:
        offsets = rng.normal(size=(runs, outputs))
    return np.asarray(offsets / np.sqrt(np.mean((offsets - offsets.mean(axis=0)) ** 2)))


def displace(drawn: Drawn, kind: str, rng: np.random.Generator) -> Dataset:
    """Return a case's logs with a clock and with offsets."""
    groups = list(dict.fromkeys(run.group for run in drawn.dataset.train))
    days = rng.permutation(np.cumsum(rng.uniform(0.3, 3.0, len(groups))))
    size = float(np.exp(rng.uniform(0.0, np.log(30.0))))
    offsets = size * drawn.noise * draw_offsets(kind, days, drawn.noise.size, rng)

    def move(run: Run) -> Run:
        """Return a stretch of a run, and the one before it, with clock and offset."""
        place = groups.index(run.group)
        clock = run.time_s + DAY_S * days[place]
        return replace(
            run,
            measured=run.measured + offsets[place],
            inputs={**run.inputs, "clock": clock},
            before=None if run.before is None else move(run.before),
        )

    train = tuple(move(run) for run in drawn.dataset.train)
    dwell = tuple(
        replace(run, inputs={**run.inputs, "clock": run.time_s}, before=None)
        for run in drawn.dataset.dwell
    )
    return replace(drawn.dataset, train=train, dwell=dwell)


def main() -> None:
    """Print how often an ageing is named, and the verdicts."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("kind", choices=KINDS)
    parser.add_argument("--count", type=int, default=300)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--minutes", type=float, default=60.0)
    options = parser.parse_args()
    rng = np.random.default_rng([options.seed, KINDS.index(options.kind)])
    begin, named, count = time.monotonic(), 0, 0
    verdicts: Counter[str] = Counter()
    while count < options.count and time.monotonic() - begin < 60.0 * options.minutes:
        runs, seed = int(rng.integers(3, 13)), int(rng.integers(2**31))
        logs = Condition(runs, runs, dwell=bool(rng.random() < 0.6))
        try:
            drawn = draw(Ask(3, "offsets", "complete", (), 0.0, runs, logs, seed))
        except InputError:
            continue
        dataset = displace(drawn, options.kind, rng)
        found = diagnose(drawn.config.effects, dataset)
        count += 1
        group = (found.effect, *found.also, *found.lookalikes)
        named += "ageing" in group
        verdicts[f"{found.verdict} {found.effect or ''}".strip()] += 1
        if ("ageing" in group) is not (options.kind in AGEING):
            print(f"  {runs} runs, seed {seed}: {found.verdict} {found.effect or ''}", flush=True)
    told = (tell_least if options.kind in AGEING else tell_most)(named, count)
    print(f"{options.kind}: ageing named {told} (simulated)")
    print(f"  {dict(verdicts.most_common())}")


if __name__ == "__main__":
    main()
