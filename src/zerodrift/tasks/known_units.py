"""The other units of a design that the fleet or the registry knows, with their models."""

from collections.abc import Iterator
from pathlib import Path

from zerodrift.base.config import Config, load_config
from zerodrift.base.errors import InputError
from zerodrift.blocks.block import apply, decode
from zerodrift.blocks.design import find_design, load_design
from zerodrift.export.integer_model import IntegerModel
from zerodrift.export.model_files import load_model
from zerodrift.field.registry import FILE_NAME as REGISTRY
from zerodrift.field.registry import open_registry
from zerodrift.fleet.sensors import FOLDER, find_sensors
from zerodrift.tasks.built import load_uncertainty
from zerodrift.tasks.monitored_log import Deployed
from zerodrift.tasks.swapped import KnownUnit, find_systematic

SHOWN = 3
"""Units that a note names."""


def find_known(
    directory: Path, deployed: Deployed, *, in_fleet: bool
) -> tuple[tuple[KnownUnit, ...], tuple[str, ...]]:
    """Return the other units, sorted by serial number, and notes on those that cannot be tried.

    The fleet's models come first, then the newest block of each further unit in the registry.

    Args:
        directory: of zerodrift.toml.
        deployed: the unit that should be there; is not among them.
        in_fleet: whether it is a unit of a fleet.

    Raises:
        InputError: the registry cannot be read.
    """
    config = load_config(directory)
    own = {deployed.sensor, deployed.serial}
    known: dict[str, IntegerModel] = {}
    wrong: dict[str, str] = {}
    for serial, model in (
        *(_list_fleet(config, wrong) if in_fleet else ()),
        *_list_registry(directory, config, wrong),
    ):
        if serial in own or serial in known:
            continue
        names = tuple(output.name for output in model.outputs)
        if names != tuple(output.name for output in deployed.model.outputs):
            wrong[serial] = f"its model has other outputs: {', '.join(names)}"
            continue
        known[serial] = model
    left = [f"{serial} is not tried: {why}" for serial, why in wrong.items() if serial not in known]
    notes = left[:SHOWN]
    if len(left) > SHOWN:
        notes.append(f"{len(left) - SHOWN} more units are not tried")
    place = config.build_directory / FOLDER
    measured = {s: load_uncertainty(place / s, model.hash) for s, model in known.items()}
    units = [KnownUnit(s, known[s], find_systematic(measured[s])) for s in sorted(known)]
    return tuple(units), tuple(notes)


def _list_fleet(config: Config, wrong: dict[str, str]) -> Iterator[tuple[str, IntegerModel]]:
    """Yield the fleet's units with their models; enter those without one."""
    for sensor in find_sensors(config):
        path = config.build_directory / FOLDER / sensor / "model.json"
        try:
            yield sensor, load_model(path)
        except InputError as error:
            wrong[sensor] = str(error)


def _list_registry(
    directory: Path, config: Config, wrong: dict[str, str]
) -> Iterator[tuple[str, IntegerModel]]:
    """Yield the registry's units with the models that their blocks hold; enter those without."""
    path = directory / REGISTRY
    if not path.is_file():
        return
    with open_registry(path) as registry:
        blocks = registry.list_blocks(config.sensor_name)
    place = find_design(config.firmware_out)
    if place is None or not blocks:
        return
    design = load_design(place)
    for serial, content in blocks.items():
        try:
            yield serial, apply(design, decode(design, content, f"{path.name}, {serial}"))
        except InputError as error:
            wrong[serial] = str(error)
