"""What an effect looks like: its drift in a simple experiment, drawn with characters."""

from dataclasses import dataclass

import numpy as np

from zerodrift.base.arrays import Array
from zerodrift.base.config import EffectConfig
from zerodrift.operations.backend import NumpyOperations
from zerodrift.physics.catalogue import Catalogue
from zerodrift.physics.effect import Effect, Signals
from zerodrift.physics.terms import build_features, start_term

DURATION_S = 7200.0
STEPS = 3600
LOWEST_DEGC, HIGHEST_DEGC = -20.0, 60.0
FULL_LOAD = 100.0
RAIL_SHARE = 0.6
TURN_ON = (0.7, -1.0, 1.0, -0.3)
"""Zeros at one power-on after the other."""
LOAD_LABEL = "load, % of full scale"

DOTS = ((0x01, 0x08), (0x02, 0x10), (0x04, 0x20), (0x40, 0x80))
"""Bits of a Braille character's dots, by row and column."""


@dataclass(frozen=True)
class Fingerprint:
    """A drift in an experiment, against what it is seen best."""

    x: Array
    y: Array
    """Drift, scaled to -1 .. 1."""
    x_label: str
    experiment: str


def draw_fingerprint(effect: Effect, catalogue: Catalogue) -> Fingerprint | None:
    """Return what the effect does in the experiment that shows it, at typical values.

    An effect that only changes what others see is shown by what a straight line against the
    temperature leaves of a linear zero shift.
    """
    t: Array = np.asarray(np.arange(STEPS) * (DURATION_S / (STEPS - 1)), dtype=np.float64)
    load: Array = np.zeros(STEPS)
    channel: Array = np.zeros(STEPS)
    temperature: Array = np.full(STEPS, 0.5 * (LOWEST_DEGC + HIGHEST_DEGC))
    minutes: Array = np.asarray(t / 60.0, dtype=np.float64)
    against = minutes
    if effect.sets_aside:
        load = _rise_and_fall(t)
        clipped = np.clip(load, -RAIL_SHARE * FULL_LOAD, RAIL_SHARE * FULL_LOAD)
        experiment = f"load up and down, rails at {100.0 * RAIL_SHARE:.0f} %"
        return _scale(load, clipped - load, LOAD_LABEL, experiment)
    elapsed = t
    label, experiment = "time, min", "at rest since power-on"
    if "load" in effect.needs:
        load = _rise_and_fall(t)
        against, label, experiment = load, LOAD_LABEL, "load up and down, then a smaller loop"
        if "temperature" in effect.needs:
            temperature = _loop(t)
            load = FULL_LOAD * (np.floor(t / DURATION_S * 12.0) % 2.0)
            against, label = temperature, "temperature, degC"
            experiment = "a load hung on and off while the temperature runs a loop"
        elif effect.kind == "creep":
            load = FULL_LOAD * ((t > 600.0) & (t < 3600.0)).astype(np.float64)
            against, label = minutes, "time, min"
            experiment = "a load held for 50 min and taken off"
    elif "temperature" in effect.needs:
        temperature = _two_loops(t)
        against, label = temperature, "temperature, degC"
        experiment = "a fast and a slow loop of temperature"
    elif effect.kind == "turn_on_bias":
        turn = np.minimum(t * len(TURN_ON) / DURATION_S, len(TURN_ON) - 1).astype(np.int64)
        channel, elapsed = np.array(TURN_ON)[turn], t % (DURATION_S / len(TURN_ON))
        experiment = f"power off and on every {DURATION_S / len(TURN_ON) / 60.0:.0f} min"
    elif not {"elapsed", "clock"} & set(effect.needs):
        channel = (np.floor(t / DURATION_S * 4.0) % 2.0).astype(np.float64)
        experiment = "the input stepped up and down"
    drift = _simulate(effect, catalogue, elapsed, temperature, load, channel)
    if effect.rewrite is not None:
        drift = drift - np.polyval(np.polyfit(temperature, drift, 1), temperature)
        experiment += "; what a straight line leaves"
    return _scale(against, drift, label, experiment)


def _scale(x: Array, drift: Array, label: str, experiment: str) -> Fingerprint | None:
    """Return the picture with the drift scaled to -1 .. 1; None where there is none."""
    middle = 0.5 * (float(drift.max()) + float(drift.min()))
    reach = float(np.abs(drift - middle).max())
    if reach == 0.0:
        return None
    return Fingerprint(x, (drift - middle) / reach, label, experiment)


def _simulate(
    effect: Effect,
    catalogue: Catalogue,
    t: Array,
    temperature: Array,
    load: Array,
    channel: Array,
) -> Array:
    """Return the drift [n] of the effect alone, beside a linear zero shift if it rewrites that."""
    names = {name for need in effect.needs for name in need.split("|")}
    signals = Signals(
        temperature_degC=temperature,
        elapsed_s=t,
        clock_s=t,
        load={"load": load},
        saturated={},
        channels=dict.fromkeys(names - {"temperature", "load", "elapsed", "clock"}, channel),
        outputs=("load",),
        full_scale={"load": FULL_LOAD},
        reference_temperature_degC=0.5 * (LOWEST_DEGC + HIGHEST_DEGC),
    )
    terms = [start_term(catalogue, EffectConfig(effect.kind))]
    if effect.rewrite is not None:
        terms.insert(0, start_term(catalogue, EffectConfig("zero_tempco")))
    ops = NumpyOperations(DURATION_S / (STEPS - 1), t.shape)
    features = build_features(ops, signals, terms, list(catalogue))[1:]
    total = np.zeros(STEPS)
    for feature in features:
        spread = float(np.std(feature.signal))
        total += feature.signal / spread if spread > 0.0 else 0.0
    return total


def _loop(t: Array) -> Array:
    """Return one loop of temperature from the middle to hot, to cold and back."""
    share = np.interp(t / DURATION_S, [0.0, 0.25, 0.75, 1.0], [0.5, 1.0, 0.0, 0.5])
    return np.asarray(LOWEST_DEGC + (HIGHEST_DEGC - LOWEST_DEGC) * share)


def _two_loops(t: Array) -> Array:
    """Return a fast loop, a rest, and a slow loop of temperature."""
    knots = [0.0, 0.05, 0.15, 0.2, 0.35, 0.5, 0.8, 0.95, 1.0]
    share = np.interp(t / DURATION_S, knots, [0.5, 1.0, 0.0, 0.5, 0.5, 1.0, 0.0, 0.5, 0.5])
    return np.asarray(LOWEST_DEGC + (HIGHEST_DEGC - LOWEST_DEGC) * share)


def _rise_and_fall(t: Array) -> Array:
    """Return a load up to full scale, down to its negative and back, and a loop half as wide."""
    knots = [0.0, 0.15, 0.45, 0.6, 0.675, 0.825, 0.9, 1.0]
    share = np.interp(t / DURATION_S, knots, [0.0, 1.0, -1.0, 0.0, 0.5, -0.5, 0.0, 0.0])
    return np.asarray(FULL_LOAD * share)


def draw_characters(fingerprint: Fingerprint, width: int = 60, height: int = 14) -> list[str]:
    """Return the picture as lines of Braille characters in a frame.

    Args:
        fingerprint: what to draw.
        width: characters across.
        height: lines.
    """
    x, y = fingerprint.x, fingerprint.y
    low, high = float(x.min()), float(x.max())
    columns = np.round((x - low) / max(high - low, 1e-300) * (2 * width - 1)).astype(int)
    rows = np.round((1.0 - y) / 2.0 * (4 * height - 1)).astype(int)
    cells = np.zeros((height, width), dtype=int)
    for row, column in zip(rows.tolist(), columns.tolist(), strict=True):
        cells[row // 4, column // 2] |= DOTS[row % 4][column % 2]
    lines = [f"drift ({fingerprint.experiment})"]
    lines += ["│" + "".join(chr(0x2800 + cell) for cell in line) for line in cells.tolist()]
    lines.append("└" + "─" * width)
    left, right = f"{low:.3g}", f"{high:.3g}"
    gap = width + 1 - len(left) - len(right) - len(fingerprint.x_label)
    lines.append(left + " " * (gap // 2) + fingerprint.x_label + " " * (gap - gap // 2) + right)
    return lines
