"""Finds the units whose drift has other causes than that of the others."""

from collections.abc import Sequence, Set
from dataclasses import dataclass

import numpy as np

from zerodrift.base.arrays import Array
from zerodrift.base.config import EffectConfig
from zerodrift.diagnosis.changes import extend_model
from zerodrift.diagnosis.revision import try_extension
from zerodrift.fleet.evidence import ExaminedUnit, Pooled
from zerodrift.fleet.outliers import FEWEST, measure_spread
from zerodrift.physics.catalogue import Catalogue

SIZE, GAIN, ERROR = "size", "gain", "error"
LARGER = 1.1
"""An error that is unlike the others' must also be larger than the median by this factor."""


@dataclass(frozen=True)
class Difference:
    """One unit that is unlike the others."""

    sensor: str
    effect: str
    """In which it differs; of an `error` the one that comes nearest, empty where none does."""
    quantity: str
    """`size`: RMS in noise floors of what the design lacks; a parameter's name: its value; `gain`:
    noise units that an effect of this unit alone gains on runs left out; `error`: RMSE in noise
    floors that no effect with a name explains."""
    value: float
    median: float
    """Of the fleet."""
    z: float
    """Robust z-score, signed."""


def find_differences(
    units: Sequence[ExaminedUnit],
    missing: Sequence[Pooled],
    catalogue: Catalogue,
    effects: Sequence[EffectConfig],
    limit: float,
) -> tuple[Difference, ...]:
    """Return the units unlike the others, the farthest first; none where the units are few.

    A unit differs by the size of an effect that the design lacks, by one of its values, or by an
    effect of its own: one that its logs alone would name, that `add` would keep there, and that
    gains far more there than in the others. Where no effect explains the difference, the unit's
    error is reported.

    Args:
        units: as `pool_units` left them.
        missing: effects that the design lacks.
        catalogue: the known effects.
        effects: the design's `[[effect]]` tables.
        limit: robust z-score from which a unit differs.
    """
    if len(units) < FEWEST:
        return ()
    found: list[Difference] = []
    for pooled in missing:
        have = [unit.name for unit in units if unit.name in pooled.shown]
        sizes = np.array([pooled.shown[name].size for name in have])
        found += _judge(have, sizes, pooled.kind, SIZE, limit)
        found += _compare_values(pooled, limit)
    found += _find_own(units, missing, catalogue, effects, limit)
    found += _compare_errors(units, {one.sensor for one in found}, limit)
    return tuple(sorted(found, key=lambda d: -abs(d.z)))


def _compare_values(pooled: Pooled, limit: float) -> list[Difference]:
    """Return the units in which a fitted value of the effect is unlike the others'.

    A value at its bound is not determined by this unit, and is left out.
    """
    found: list[Difference] = []
    for name in pooled.parameters:
        have, values, is_log = [], [], False
        for sensor, shown in pooled.shown.items():
            own = next(t for t in shown.terms if t.effect.kind == pooled.kind)
            free = {p.name: p for p in own.free if not p.is_setting}
            if name in free and shown.sound:
                have.append(sensor)
                values.append(shown.parameters[name])
                is_log = free[name].scale == "log"
        x = np.log(values) if is_log else np.array(values)
        for one in _judge(have, x, pooled.kind, name, limit):
            value, median = float(np.exp(one.value)), float(np.exp(one.median))
            found.append(
                Difference(one.sensor, one.effect, name, value, median, one.z) if is_log else one
            )
    return found


def _compare_errors(
    units: Sequence[ExaminedUnit], known: Set[str], limit: float
) -> list[Difference]:
    """Return the units that leave more than the others, without those that have a reason."""
    logs = np.log([unit.last.fitted_ratio for unit in units])
    found = []
    for one in _judge([unit.name for unit in units], logs, "", ERROR, limit):
        if one.sensor in known or one.value - one.median <= np.log(LARGER):
            continue
        unit = next(unit for unit in units if unit.name == one.sensor)
        gains = {kind: shown.gain for kind, shown in unit.last.shown.items() if shown.gain > 0.0}
        nearest = max(gains, key=lambda kind: gains[kind]) if gains else ""
        value, median = float(np.exp(one.value)), float(np.exp(one.median))
        found.append(Difference(one.sensor, nearest, ERROR, value, median, one.z))
    return found


def _judge(
    names: Sequence[str], values: Array, kind: str, quantity: str, limit: float
) -> list[Difference]:
    """Return the units whose value is far from the others', by robust z-scores."""
    if len(names) < FEWEST:
        return []
    middle, spread = measure_spread(values)
    if spread <= 0.0:
        return []
    return [
        Difference(name, kind, quantity, value, middle, (value - middle) / spread)
        for name, value in zip(names, values.tolist(), strict=True)
        if abs(value - middle) > limit * spread
    ]


def _find_own(
    units: Sequence[ExaminedUnit],
    missing: Sequence[Pooled],
    catalogue: Catalogue,
    effects: Sequence[EffectConfig],
    limit: float,
) -> list[Difference]:
    """Return effects that single units lack beside what the design lacks: the best of each."""
    by_name = {unit.name: unit for unit in units}
    best: dict[str, Difference] = {}
    for kind in dict.fromkeys(kind for unit in units for kind in unit.last.shown):
        have = [unit.name for unit in units if kind in unit.last.shown]
        gains = np.array([by_name[name].last.shown[kind].gain for name in have])
        for one in _judge(have, gains, kind, GAIN, limit):
            alone = one.z > 0.0 and by_name[one.sensor].last.shown[kind].stands_alone
            if alone and (one.sensor not in best or one.value > best[one.sensor].value):
                best[one.sensor] = one
    kept = []
    for sensor, one in best.items():
        unit = by_name[sensor]
        model = tuple(effects)
        for pooled in missing:
            if sensor in pooled.shown:
                model = extend_model(model, catalogue, pooled.kind, pooled.shown[sensor].parameters)
        extended = extend_model(
            model, catalogue, one.effect, unit.last.shown[one.effect].parameters
        )
        if try_extension(model, (extended,), unit.dataset, catalogue)[0]:
            kept.append(one)
    return kept
