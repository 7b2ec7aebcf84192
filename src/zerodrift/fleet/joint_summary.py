"""The result of `diagnose` for a fleet."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import ClassVar

from zerodrift.fleet.evidence import FEWEST_UNITS, Difference, JointFindings, Pooled
from zerodrift.fleet.outliers import FEWEST


@dataclass(frozen=True)
class PooledCandidate:
    """One effect that the design's model lacks, over all units."""

    effect: str
    p_value: float
    """How often signs by chance rank some effect as high over the units."""
    rmse_left_out_ratio: float
    """RMSE on runs left out with it over that without: geometric mean over the units."""
    units: int
    """That can test it."""
    gaining: int
    """Units whose runs left out are predicted better with it."""
    size: float
    """RMS that it takes away in the median unit, in noise floors."""
    parameters: Mapping[str, float]
    """Median over the units."""


@dataclass(frozen=True)
class UnitErrors:
    """One unit's error over its noise floor."""

    runs: int
    floor_ratio_before: float
    """RMSE on runs left out, pooled over outputs, of the design's model fitted to the unit."""
    floor_ratio_after: float
    """The same with what the design lacks."""
    differs: tuple[Difference, ...]
    """In what it is unlike the others, the farthest first."""


@dataclass(frozen=True)
class FleetDiagnosis:
    """What the model of a design lacks, by all of its units together."""

    SCHEMA: ClassVar = "diagnose-fleet/1"

    design: str
    verdict: str
    """missing | complete | unknown."""
    effect: str | None
    """The effect that is missing; null unless the verdict is `missing`."""
    parameters: Mapping[str, float]
    """Its values: the median over the units, choices included."""
    p_value: float | None
    lookalikes: tuple[str, ...]
    """Effects that these units cannot tell from it."""
    also: tuple[str, ...]
    """Further effects that are missing beside it."""
    nearest: str | None
    """For `unknown`: the effect that comes nearest."""
    candidates: tuple[PooledCandidate, ...]
    """The smallest p-value first."""
    not_testable: Mapping[str, str]
    """Effects that no unit's logs can test, and why."""
    units: Mapping[str, UnitErrors]
    differ: tuple[Difference, ...]
    """Units unlike the others, the farthest first."""
    errors: Mapping[str, str] = field(default_factory=dict)
    """Units that could not be examined, and why."""
    evidence: str = ""
    """How many units spoke, and whether that is thin."""


def summarise_joint(
    design: str,
    found: JointFindings,
    differ: Sequence[Difference],
    errors: Mapping[str, str],
) -> FleetDiagnosis:
    """Return the verdict on a design.

    Args:
        design: its name.
        found: from `pool_units`.
        differ: from `find_differences`.
        errors: unit -> why it could not be examined.
    """
    leading = found.missing[0] if found.missing else None
    named = leading if found.explained else None
    nearest = None
    if named is None and not found.explained:
        nearest = leading.kind if leading else _find_nearest(found.candidates)
    verdict = "missing" if named else "complete" if found.explained else "unknown"
    tested = {kind for unit in found.units for kind in unit.first.shown}
    return FleetDiagnosis(
        design,
        verdict,
        named.kind if named else None,
        named.parameters if named else {},
        named.p_value if named else None,
        found.lookalikes if named else (),
        tuple(pooled.kind for pooled in found.missing[1:]) if named else (),
        nearest,
        tuple(_summarise(pooled) for pooled in found.candidates),
        {
            kind: why
            for unit in found.units
            for kind, why in unit.first.not_testable.items()
            if kind not in tested
        },
        {
            unit.name: UnitErrors(
                unit.first.runs,
                unit.first.floor_ratio,
                unit.last.floor_ratio,
                tuple(d for d in differ if d.sensor == unit.name),
            )
            for unit in found.units
        },
        tuple(differ),
        dict(errors),
        _tell_evidence(len(found.units)),
    )


def _find_nearest(candidates: Sequence[Pooled]) -> str | None:
    """Return the effect that gains most in the median unit; None where none gains."""
    gaining = [pooled for pooled in candidates if pooled.typical_gain > 0.0]
    return max(gaining, key=lambda p: p.typical_gain).kind if gaining else None


def _summarise(pooled: Pooled) -> PooledCandidate:
    return PooledCandidate(
        pooled.kind,
        pooled.p_value,
        pooled.ratio,
        len(pooled.shown),
        pooled.gaining,
        pooled.size,
        pooled.parameters,
    )


def _tell_evidence(units: int) -> str:
    """Return what so many units are worth, in a sentence."""
    told = f"{units} unit{'s' if units != 1 else ''}"
    if units < FEWEST_UNITS:
        return (
            f"thin: {told}; by signs alone {FEWEST_UNITS} units are the fewest that can name an "
            "effect. Diagnose each one by --sensor"
        )
    if units < FEWEST:
        return f"{told}; from {FEWEST} on, units that differ are named"
    return told
