"""The effect that a design's model lacks, and the units whose drift has other causes."""

from collections.abc import Callable, Mapping, Sequence, Set
from dataclasses import dataclass

import numpy as np

from zerodrift.base.arrays import Array
from zerodrift.base.config import EffectConfig
from zerodrift.dataset.runs import Dataset
from zerodrift.diagnosis.case import open_case
from zerodrift.diagnosis.changes import extend_model
from zerodrift.diagnosis.diagnose import look
from zerodrift.diagnosis.evidence import compare_runs, flip_signs
from zerodrift.diagnosis.examination import Examination, Judged, share_explained
from zerodrift.diagnosis.revision import try_extension
from zerodrift.diagnosis.rules import (
    ALIKE,
    ALIKE_UNLESS_SURE,
    EXPLAINED,
    EXPLAINED_WITHOUT_DWELL,
    LEFT_WITHOUT_DWELL,
    SIGNIFICANT,
    WORTHWHILE,
    WORTHWHILE_ON_ONE,
    helps,
    is_at_floor,
)
from zerodrift.fleet.outliers import FEWEST, measure_spread
from zerodrift.physics.catalogue import Catalogue
from zerodrift.physics.terms import Term

# Finds the effect that the model of a design lacks, by all of its units together.
#
# A few runs of one unit show little; the units of a design were recorded apart, so each is evidence
# of its own. Every unit is examined as it would be alone, with coefficients and shared values of
# its own and runs left out in turn. What an effect gains there is one figure per unit, and chance
# is judged by flipping the signs of whole units' ranks, over all effects at once: one unit that
# gains a thousand times as much as the others counts as one.
#
# Source: F. Wilcoxon, Biometrics Bulletin 1 (1945), signed ranks; Winkler et al., NeuroImage 92
# (2014), sign flips and the maximum over many candidates.

FEWEST_UNITS = 5
"""Fewer units cannot reach a p-value of 5 % by signs: 2^-4 is more."""
MOST_EFFECTS = 3
"""Effects that are looked for one beside the other."""


@dataclass(frozen=True)
class UnitEffect:
    """One effect in one unit's logs: what remains of its examination."""

    kind: str
    parameters: Mapping[str, float]
    terms: tuple[Term, ...]
    """The whole model with it, as fitted to this unit."""
    gain: float
    """On runs left out, in noise units."""
    ratio: float
    """RMSE on runs left out with it over that without."""
    output_ratios: Array
    """[K] the same by output, within runs."""
    size: float
    """RMS that it takes away, in noise floors."""
    sound: bool
    """Whether its values lie off their bounds and within what the logs can show."""
    stands_alone: bool
    """Whether this unit's logs alone would do to name it, as far as its gain goes."""


@dataclass(frozen=True)
class UnitLook:
    """One look at one unit: its error, and what each effect beside the model shows."""

    shown: Mapping[str, UnitEffect]
    fitted_ratio: float
    """RMSE over the noise floor in the runs that the model was fitted to."""
    floor_ratio: float
    """The same in runs left out."""
    at_floor: bool
    runs: int
    not_testable: Mapping[str, str]
    """Effect -> why."""


@dataclass(frozen=True)
class ExaminedUnit:
    """One unit's logs and what was seen in them."""

    name: str
    dataset: Dataset
    first: UnitLook
    """Beside the design's model."""
    last: UnitLook
    """Beside that model with what the fleet was found to lack."""


@dataclass(frozen=True)
class Pooled:
    """One effect over all units."""

    kind: str
    p_value: float
    """How often random signs rank some effect as high."""
    gains: Array
    """[U] noise units; 0 where a unit cannot test it."""
    ratio: float
    """RMSE in runs left out over that without it: geometric mean over the units."""
    best_output_ratio: float
    """The same within runs, for the output that gains most."""
    shown: Mapping[str, UnitEffect]
    """Unit -> the effect as found there, in units that can test it."""

    @property
    def gaining(self) -> int:
        """Units whose runs left out are predicted better with it."""
        return int((self.gains > 0.0).sum())

    @property
    def typical_gain(self) -> float:
        """The median unit's: one that gains more than all others together does not decide."""
        return float(np.median(self.gains))

    @property
    def size(self) -> float:
        """RMS that it takes away in the median unit, in noise floors."""
        return float(np.median([shown.size for shown in self.shown.values()]))

    @property
    def parameters(self) -> dict[str, float]:
        """Median over the units of each fitted value; a choice that most units made."""
        names = dict.fromkeys(name for s in self.shown.values() for name in s.parameters)
        found = {
            n: [s.parameters[n] for s in self.shown.values() if n in s.parameters] for n in names
        }
        return {n: float(np.median(x)) for n, x in found.items() if 2 * len(x) > len(self.shown)}

    @property
    def is_named(self) -> bool:
        """Whether it is sure, worth having as one unit's diagnosis asks, and sound in most."""
        worthwhile = self.ratio <= WORTHWHILE or self.best_output_ratio <= WORTHWHILE_ON_ONE
        sound = sum(shown.sound for shown in self.shown.values())
        enough = len(self.shown) >= FEWEST_UNITS and 2 * self.gaining > self.gains.size
        return (
            enough and self.p_value <= SIGNIFICANT and worthwhile and 2 * sound >= len(self.shown)
        )


@dataclass(frozen=True)
class JointFindings:
    """What the units show together."""

    units: tuple[ExaminedUnit, ...]
    missing: tuple[Pooled, ...]
    """Effects that the design's model lacks, in the order in which they were found."""
    candidates: tuple[Pooled, ...]
    """All effects beside the model as it is, the smallest p-value first."""
    lookalikes: tuple[str, ...]
    """Effects that the units cannot tell from the first one."""
    explained: bool
    """Whether most units come near their noise with what was found."""


def look_at_unit(
    name: str, dataset: Dataset, catalogue: Catalogue, effects: Sequence[EffectConfig]
) -> ExaminedUnit:
    """Return one unit examined beside the design's model.

    Args:
        name: the unit's.
        dataset: its runs.
        catalogue: the known effects.
        effects: the design's `[[effect]]` tables.

    Raises:
        InputError: as `open_case`.
    """
    case = open_case(dataset, catalogue, effects)
    seen = _keep(look(case, case.terms))
    return ExaminedUnit(name, dataset, seen, seen)


def _keep(examination: Examination) -> UnitLook:
    """Return what is needed of an examination; the rest is large."""
    return UnitLook(
        {j.kind: _keep_effect(examination, j) for j in examination.judged},
        examination.fitted_ratio,
        examination.floor_ratio,
        is_at_floor(examination, examination.fitted_ratio),
        examination.runs,
        {untested.effect: untested.why for untested in examination.untested},
    )


def _keep_effect(examination: Examination, judged: Judged) -> UnitEffect:
    gone = examination.fitted_ratio**2 - judged.fitted_ratio**2
    return UnitEffect(
        judged.kind,
        judged.parameters,
        judged.found.terms,
        judged.gain,
        judged.rmse_ratio,
        np.sqrt(np.maximum(judged.errors, 1e-300) / np.maximum(examination.base_errors, 1e-300)),
        float(np.sqrt(max(gone, 0.0))),
        judged.sound,
        judged.sound and helps(judged, examination),
    )


def pool_units(
    units: Sequence[ExaminedUnit],
    catalogue: Catalogue,
    effects: Sequence[EffectConfig],
    say: Callable[[str], None] = lambda _: None,
) -> JointFindings:
    """Return what the design's model lacks by all units together.

    Args:
        units: from `look_at_unit`.
        catalogue: the known effects.
        effects: the design's `[[effect]]` tables.
        say: called with a description of each stage of the work.
    """
    missing: list[Pooled] = []
    first = pooled = pool(units)
    while len(missing) < MOST_EFFECTS:
        named = [p for p in pooled if p.is_named]
        if not named:
            break
        missing.append(max(named, key=lambda p: p.typical_gain))
        kind = missing[-1].kind
        extended = []
        for unit in units:
            say(f"{unit.name}: what is left beside {kind}")
            extended.append(_extend(unit, kind, catalogue, effects))
        units = extended
        if _are_at_floor(units):
            break
        pooled = pool(units)
    explained = _are_at_floor(units) or (bool(missing) and _is_explained(units, missing))
    lookalikes = _list_lookalikes(missing[0], first) if missing else ()
    return JointFindings(tuple(units), tuple(missing), tuple(first), lookalikes, explained)


def pool(units: Sequence[ExaminedUnit]) -> list[Pooled]:
    """Return every effect over all units' last looks, the smallest p-value first."""
    looks = [unit.last for unit in units]
    kinds = list(dict.fromkeys(kind for seen in looks for kind in seen.shown))
    if not kinds:
        return []
    gains = np.array([[s.shown[k].gain if k in s.shown else 0.0 for s in looks] for k in kinds])
    p_values = flip_signs(rank_gains(gains))
    pooled = []
    for kind, row, p_value in zip(kinds, gains, p_values.tolist(), strict=True):
        shown = {u.name: u.last.shown[kind] for u in units if kind in u.last.shown}
        logs = np.log([s.ratio for s in shown.values()])
        by_output = np.log([s.output_ratios for s in shown.values()])
        # A unit that cannot test it keeps its error.
        part = len(shown) / len(units)
        pooled.append(
            Pooled(
                kind,
                p_value,
                row,
                float(np.exp(part * logs.mean())),
                float(np.exp(part * by_output.mean(axis=0)).min()),
                shown,
            )
        )
    return sorted(pooled, key=lambda p: (p.p_value, -p.typical_gain))


def rank_gains(gains: Array) -> Array:
    """Return signed ranks [M, U]: each effect's gains ranked by size over the units, sign kept."""
    from scipy.stats import rankdata

    return np.asarray(rankdata(np.abs(gains), axis=1) * np.sign(gains), dtype=np.float64)


def _extend(
    unit: ExaminedUnit, kind: str, catalogue: Catalogue, effects: Sequence[EffectConfig]
) -> ExaminedUnit:
    """Return the unit examined beside one more effect; as it is where it cannot test that."""
    shown = unit.last.shown.get(kind)
    if shown is None:
        return unit
    case = open_case(unit.dataset, catalogue, effects)
    return ExaminedUnit(unit.name, unit.dataset, unit.first, _keep(look(case, shown.terms)))


def _are_at_floor(units: Sequence[ExaminedUnit]) -> bool:
    """Return whether most units have come near their noise."""
    return 2 * sum(unit.last.at_floor for unit in units) > len(units)


def _is_explained(units: Sequence[ExaminedUnit], missing: Sequence[Pooled]) -> bool:
    """Return whether the effects found explain enough of the excess error, in the median unit."""
    shares = [share_explained(u.first.fitted_ratio**2, u.last.fitted_ratio**2) for u in units]
    if all(unit.dataset.dwell for unit in units):
        return float(np.median(shares)) >= EXPLAINED
    # Without a dwell the floor is a lower bound and cannot refuse; see `rules`.
    large = missing[0].ratio ** 2 <= LEFT_WITHOUT_DWELL
    return large or float(np.median(shares)) >= EXPLAINED_WITHOUT_DWELL


def _list_lookalikes(leading: Pooled, pooled: Sequence[Pooled]) -> tuple[str, ...]:
    """Return the effects that the units cannot tell from the leading one."""
    most = leading.typical_gain
    alike = []
    for other in pooled:
        if other.kind == leading.kind or not other.is_named:
            continue
        behind = most - other.typical_gain
        unsure = compare_runs(leading.gains, other.gains) > SIGNIFICANT
        if behind <= ALIKE * most or (unsure and behind <= ALIKE_UNLESS_SURE * most):
            alike.append(other.kind)
    return tuple(alike)


# Finds the units whose drift has other causes than that of the others.

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
