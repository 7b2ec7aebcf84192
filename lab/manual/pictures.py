"""The manual's pictures: computed when it is built, drawn as those of the report."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from scipy.stats import t as student

from zerodrift.base.arrays import Array
from zerodrift.diagnosis.evidence import flip_signs
from zerodrift.operations.arithmetic import round_shift
from zerodrift.report.pictures import draw_fingerprint
from zerodrift.report.svg import AxisScale, Curve, Panel
from zerodrift.report.svg import Picture as Drawn

TRIALS, RUNS, SAMPLES = 400, 8, 600
"""Of the trial of false alarms."""
MEMORY_STEPS = 60.0
"""Time constant of its noise."""
NOMINAL = 0.05


@dataclass(frozen=True)
class Picture:
    """A picture and what it shows, with the numbers found while drawing it."""

    drawn: Drawn
    caption: str


# --- why a 16-bit state stalls -------------------------------------------------------------------


def follow(target: Array, tau_steps: float, fraction_bits: int | None) -> Array:
    """Return the state [T] of one slow unit that follows a target [T] as the GRU's state does.

    Args:
        target: what the unit moves towards, within -1 .. 1.
        tau_steps: its time constant; the update gate is 1 / tau_steps.
        fraction_bits: of the state, each step rounded to the nearest; None: not rounded.
    """
    state = np.empty(target.size)
    if fraction_bits is None:
        h = float(target[0])
        for step, goal in enumerate(target):
            h += (float(goal) - h) / tau_steps
            state[step] = h
        return state
    u_q31 = round(2.0**31 / tau_steps)
    goals = np.rint(target * 2.0**fraction_bits).astype(np.int64)
    whole = int(goals[0])
    for step, goal in enumerate(goals):
        whole += int(round_shift(u_q31 * (int(goal) - whole), 31))
        state[step] = whole / 2.0**fraction_bits
    return state


def measure_stall(tau_steps: float, fraction_bits: int) -> float:
    """Return how far from its target a unit stays for ever, after a step of a half."""
    u_q31 = round(2.0**31 / tau_steps)
    goal, whole = 0, 2 ** (fraction_bits - 1)
    # Far from the goal the steps are those of the float unit; near it they are walked one by one.
    near = int(4.0 * tau_steps) + 4
    whole = min(whole, near)
    while True:
        move = int(round_shift(u_q31 * (goal - whole), 31))
        if move == 0:
            return whole / 2.0**fraction_bits
        whole += move


def draw_stall() -> Picture:
    """Return a slow unit's answer to a step, in float and in bits, and what it never reaches."""
    tau, count = 3600.0, 40_000
    target = np.where(np.arange(count) < 600, 0.0, 0.5)
    exact = follow(target, tau, None)
    hours = np.arange(count) / 3600.0
    shown = np.linspace(0, count - 1, 700).astype(int)
    lines = (
        ("float", exact, "left", "solid", 4.0),
        ("30 bits", follow(target, tau, 30), "model", "dash", 2.0),
        ("15 bits", follow(target, tau, 15), "effect", "dot", 2.5),
    )
    taus = np.logspace(1.0, 5.0, 17)
    over = {bits: np.array([measure_stall(float(t), bits) for t in taus]) for bits in (15, 30)}
    courses = Panel(
        left=62.0,
        top=44.0,
        width=420.0,
        height=280.0,
        x=AxisScale(0.0, float(hours[-1]), "time at one step a second, h"),
        y=AxisScale(-0.03, 0.55),
        title="state",
        curves=tuple(
            Curve(hours[shown], state[shown], ink, name, dash, width)
            for name, state, ink, dash, width in lines
        ),
        stacked=True,
    )
    ends = np.concatenate([values[values > 0.0] for values in over.values()])
    never = replace(
        courses,
        left=560.0,
        x=AxisScale(8.0, 1.3e5, "time constant, steps", log=True),
        y=AxisScale(0.5 * float(ends.min()), 2.0 * float(ends.max()), log=True),
        title="never reached",
        curves=(
            Curve(taus, over[15], "effect", "15 bits, left over", "dot", 1.0, mark="circle"),
            Curve(taus, over[30], "model", "30 bits, left over", "dot", 1.0, mark="square"),
        ),
    )
    stall = measure_stall(tau, 15)
    caption = (
        f"Left: a unit with a time constant of one hour follows a step of 0.5. With 15 fractional "
        f"bits it stays {stall:.3f} short of it for ever, with 30 bits "
        f"{measure_stall(tau, 30):.1e}. Right: what is never reached, for time constants from ten "
        "seconds to a day."
    )
    words = "A slow unit's answer to a step, and what it never reaches."
    return Picture(Drawn(1000.0, 370.0, (courses, never), words, "stall"), caption)


# --- why runs are the unit of evidence -----------------------------------------------------------


@cache
def count_alarms() -> tuple[Array, Array]:
    """Return the p-values [TRIALS] of an effect that is not there: by samples, and by runs.

    Each trial has `RUNS` runs of `SAMPLES` samples of noise with memory, and a slow signal that has
    nothing to do with it. By samples: the t-test of a straight line through all of them. By runs:
    the gain of that line in each run, fitted to the others, with signs of whole runs flipped.
    """
    rng = np.random.default_rng(0)
    keep = np.exp(-1.0 / MEMORY_STEPS)
    p_samples, p_runs = np.empty(TRIALS), np.empty(TRIALS)
    for trial in range(TRIALS):
        noise = _filter(rng.standard_normal((RUNS, SAMPLES)), keep)
        signal = _filter(rng.standard_normal((RUNS, SAMPLES)), keep)
        noise -= noise.mean(axis=1, keepdims=True)
        signal -= signal.mean(axis=1, keepdims=True)
        along, power = (signal * noise).sum(axis=1), (signal**2).sum(axis=1)
        slope = along.sum() / power.sum()
        left = ((noise - slope * signal) ** 2).sum()
        freedom = RUNS * (SAMPLES - 1) - 1
        error = np.sqrt(left / freedom / power.sum())
        p_samples[trial] = 2.0 * student.sf(abs(slope) / error, freedom)
        others = (along.sum() - along) / (power.sum() - power)
        gains = 2.0 * others * along - others**2 * power
        p_runs[trial] = float(flip_signs(gains[None])[0])
    return p_samples, p_runs


def _filter(x: Array, keep: float) -> Array:
    """Return noise of variance one with memory, along the last axis."""
    y = np.empty_like(x)
    y[:, 0] = x[:, 0]
    for step in range(1, x.shape[1]):
        y[:, step] = keep * y[:, step - 1] + np.sqrt(1.0 - keep**2) * x[:, step]
    return y


def draw_alarms() -> Picture:
    """Return how often an effect that is not there is found, against how often it should be."""
    by_samples, by_runs = count_alarms()
    levels = np.linspace(0.0, 0.5, 101)
    lines = (
        ("samples as evidence", by_samples, "effect", "solid"),
        ("runs as evidence", by_runs, "model", "dash"),
    )
    percent = 100.0 * levels
    curves = [Curve(percent, percent, "floor", "as promised", "dot")]
    for name, values, ink, dash in lines:
        found = 100.0 * (values[None] <= levels[:, None]).mean(axis=1)
        curves.append(Curve(percent, found, ink, name, dash, 2.5))
    panel = Panel(
        left=62.0,
        top=26.0,
        width=690.0,
        height=280.0,
        x=AxisScale(0.0, 50.0, "false alarms promised, %"),
        y=AxisScale(0.0, 100.0),
        title="false alarms found, %",
        curves=tuple(curves),
    )
    caption = (
        f"{TRIALS} simulated trials of {RUNS} runs, noise with a memory of {MEMORY_STEPS:g} "
        f"samples, and a slow signal that has nothing to do with it. At a promised {NOMINAL:.0%} "
        f"the test of samples raises a false alarm in {(by_samples <= NOMINAL).mean():.0%} of the "
        f"trials, the flipped signs of held-out runs in {(by_runs <= NOMINAL).mean():.1%}."
    )
    words = "How often an effect that is not there is found, against how often it should be."
    return Picture(Drawn(764.0, 352.0, (panel,), words, "alarms"), caption)


# --- all of them ---------------------------------------------------------------------------------


def draw_effect(kind: str) -> Picture:
    """Return an effect's fingerprint in the experiment that shows it best."""
    from zerodrift.diagnosis import fingerprint
    from zerodrift.physics.catalogue import load_catalogue

    catalogue = load_catalogue()
    effect = catalogue[kind]
    picture = fingerprint.draw_fingerprint(effect, catalogue)
    if picture is None:
        raise KeyError(f"effect {kind}")
    caption = f"{effect.title[0].upper()}{effect.title[1:]}, computed from the declaration."
    return Picture(draw_fingerprint(effect.title, picture), caption)


def draw_loop(name: str) -> Picture:
    """Return one picture of the loop on a simulated sensor with a hidden lag."""
    from manual.example import draw_example

    return Picture(*draw_example()[name])


PICTURES: dict[str, Callable[[], Picture]] = {
    "stall": draw_stall,
    "alarms": draw_alarms,
    **{name: lambda name=name: draw_loop(name) for name in ("run", "candidates", "staircase")},
}


def draw_picture(name: str) -> Picture:
    """Return a picture by its name; `effect KIND` is the one of an effect.

    Raises:
        KeyError: there is none of this name.
    """
    what, _, kind = name.partition(" ")
    return draw_effect(kind) if what == "effect" else PICTURES[name]()
