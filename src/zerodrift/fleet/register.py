"""What a fleet's run adds to the registry: each unit's calibration, its logs and its block."""

from collections.abc import Sequence

from zerodrift.field.registry import FILE_NAME, Registry, open_registry
from zerodrift.fleet.design import Design
from zerodrift.fleet.parcels import at_hand
from zerodrift.fleet.result import SensorOutcome, SensorResult
from zerodrift.fleet.sensors import configure_sensor
from zerodrift.verify.manifest import hash_logs


def enter_fleet(design: Design, outcomes: Sequence[SensorOutcome]) -> None:
    """Enter the units that went through into the registry beside zerodrift.toml, if there is one.

    A unit without firmware, or whose firmware was refused, has no calibration to enter.

    Raises:
        InputError: the registry cannot be written, or a unit is of another design there.
    """
    path = design.directory / FILE_NAME
    if not path.is_file():
        return
    with open_registry(path) as registry:
        known = {(unit.serial, unit.model_hash) for unit in registry.list_units()}
        for outcome in outcomes:
            result = outcome.result
            if result is None or not result.model_hash or (result.refused and not result.forced):
                continue
            if (outcome.sensor, result.model_hash) not in known:
                _enter_calibration(registry, design, outcome.sensor, result)
            if outcome.tried is not None and outcome.tried.content:
                registry.add_block(outcome.sensor, outcome.tried.content, result.model_hash)


def _enter_calibration(
    registry: Registry, design: Design, sensor: str, result: SensorResult
) -> None:
    with at_hand(design, sensor) as near:
        logs = hash_logs(configure_sensor(near.config, sensor))
    registry.add_calibration(
        sensor,
        design.config.sensor_name,
        result.model_hash,
        tuple((sha256, name) for name, sha256 in logs.items()),
    )
