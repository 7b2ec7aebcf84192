"""What tells a missing effect from what imitates it, where something else is missing too.

    python -m benchmarks.study_beside [--count N] [--seed N] [--jobs N]

From N cases of each of the twelve conditions of `benchmarks.evidence`: a catalogue effect beside a
cause outside the catalogue, such a cause alone (all three simulators), and a hidden play alone.
Each gets one examination, and the sound effect that gains most is held against what
`rules.is_there` and `rules.is_enough` ask. All logs are simulated; nothing is named here.
"""

import argparse
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import islice

import numpy as np

from benchmarks import open_pool
from benchmarks.evidence.conditions import CONDITIONS, Ask, list_asks
from benchmarks.evidence.sources import CannotDrawError, draw
from zerodrift.base.errors import InputError
from zerodrift.diagnosis.case import open_case
from zerodrift.diagnosis.diagnose import look
from zerodrift.diagnosis.examination import share_explained
from zerodrift.diagnosis.rules import SIGNIFICANT, SURE_SHARE, is_at_floor
from zerodrift.physics.catalogue import load_catalogue

PLAYS = ("thermal_hysteresis", "load_hysteresis")
PLAY, RICHER, OTHER = "a play", "a richer form of what the model has", "another effect"


@dataclass(frozen=True)
class Seen:
    """The sound effect that gains most.

    Attributes:
        ask: the case.
        effect: its name.
        is_hidden: whether it is what is hidden.
        sort: PLAY, RICHER or OTHER.
        passes: whether it gains in nearly all runs, beyond chance, and in likelihood.
        nats: gain in likelihood.
        share: of the excess, as fitted.
        left_out: of the excess in runs left out.
    """

    ask: Ask
    effect: str
    is_hidden: bool
    sort: str
    passes: bool
    nats: float
    share: float
    left_out: float


def see(ask: Ask) -> Seen | None:
    """Return what one examination of a case shows.

    None where there is no case, nothing sound, or nothing that is left above the floor.
    """
    try:
        drawn = draw(ask)
        case = open_case(drawn.dataset, load_catalogue(), drawn.config.effects)
    except (CannotDrawError, InputError):
        return None
    found = look(case, case.terms)
    best = next((judged for judged in found.judged if judged.sound), None)
    if best is None or is_at_floor(found, found.fitted_ratio):
        return None
    own = [term for term in best.found.terms if term.effect.kind == best.kind]
    sort = OTHER
    if any(term.effect.kind == best.kind for term in case.terms):
        sort = RICHER
    elif any(parameter.slack_in for term in own for parameter in term.free):
        sort = PLAY
    passes = best.gain > 0.0 and best.positive_share >= SURE_SHARE and best.nats > 0.0
    passes = passes and best.p_value <= max(SIGNIFICANT, 2.0 ** -float(best.gains.size))
    left_out = share_explained(found.floor_ratio**2, best.floor_ratio**2)
    is_hidden = best.kind in ask.listed
    return Seen(ask, best.kind, is_hidden, sort, passes, best.nats, best.share, left_out)


def list_wanted(count: int, seed: int) -> Iterator[Ask]:
    """Give the cases."""
    for name in CONDITIONS:
        yield from islice(list_asks(3, name, "beside", seed), count)
        for simulator in (1, 2, 3):
            yield from islice(list_asks(simulator, name, "outside", seed), count)
        for play in PLAYS:
            yield from islice(list_asks(3, name, "one", seed, play), count)


def tell(title: str, seen: Sequence[Seen], cases: int) -> str:
    """Return a line on what was seen of a kind, out of so many cases."""
    if not seen:
        return f"{title}: 0 of {cases}"
    nats = ", ".join(f"{x:.0f}" for x in np.quantile([s.nats for s in seen], (0.0, 0.5, 1.0)))
    shares = [
        f"{name} {min(values):.2f} .. {max(values):.2f}"
        for name, values in (
            ("fitted", [s.share for s in seen]),
            ("left out", [s.left_out for s in seen]),
        )
    ]
    few = sum(s.ask.runs < 6 for s in seen)
    return (
        f"{title}: {len(seen)} of {cases} ({few} of them with fewer than six runs); least, median "
        f"and most nats {nats}; share of the excess {', '.join(shares)}"
    )


def main() -> None:
    """Print what passes, by what it is."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=3)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--jobs", type=int, default=2)
    options = parser.parse_args()
    with open_pool(options.jobs) as pool:
        rows = [row for row in pool.map(see, list_wanted(options.count, options.seed)) if row]
    beside = [row for row in rows if row.ask.purpose == "beside"]
    outside = [row for row in rows if row.ask.purpose == "outside"]
    alone = [row for row in rows if row.ask.purpose == "one"]
    print(tell("hidden, beside another cause", _pass(beside, hidden=True), len(beside)))
    print(tell("not hidden, beside another cause", _pass(beside, hidden=False), len(beside)))
    for sort in (PLAY, RICHER, OTHER):
        mine = [row for row in _pass(outside, hidden=False) if row.sort == sort]
        print(tell(f"outside the catalogue, {sort}", mine, len(outside)))
    print(tell("a hidden play alone", _pass(alone, hidden=True), len(alone)))


def _pass(rows: Sequence[Seen], *, hidden: bool) -> list[Seen]:
    return [row for row in rows if row.passes and row.is_hidden == hidden]


if __name__ == "__main__":
    main()
