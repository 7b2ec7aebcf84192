"""The block of coefficients that is on a unit, as the integer model that its chip computes."""

from dataclasses import dataclass
from pathlib import Path

from zerodrift.base.config import Config, load_config
from zerodrift.base.errors import InputError
from zerodrift.blocks.block import apply, decode, decode_header
from zerodrift.blocks.design import BlockDesign, find_design, load_design
from zerodrift.blocks.files import BLOCK, find_design_file, read_block_file
from zerodrift.export.integer_model import IntegerModel
from zerodrift.field.registry import FILE_NAME as REGISTRY
from zerodrift.field.registry import LoadedBlock, open_registry
from zerodrift.fleet.blocks import BLOCKS


@dataclass(frozen=True)
class DeployedBlock:
    """What a chip computes with its block."""

    model: IntegerModel
    """In the design's common format."""
    note: str
    """Which block it is, and where it was found."""


def find_serial(config: Config) -> str:
    """Return the serial number under which the registry knows a project's unit."""
    return _find_sensor(config) or config.block.serial or config.sensor_name


def find_deployed_block(config: Config, file: Path | None = None) -> DeployedBlock | None:
    """Return what is on a unit: the block that is named, else that which the registry says was
    loaded, else that which was written last; None where a unit's coefficients are constants.

    Args:
        config: of the unit.
        file: of the block, where the user names one.

    Raises:
        InputError: there is no block or no design, or no chip of the design would take the block.
    """
    directory, sensor, serial = config.directory, _find_sensor(config), find_serial(config)
    if file is not None:
        design = find_design_file(file) or _find_own_design(directory)
        if design is None:
            raise InputError(
                f"{file}: a block is read with its design, and no design.json lies beside it, above"
                " it or in the firmware's folder. Put that of its program beside it."
            )
        content = read_block_file(file, design)
        owner = decode_header(content, str(file)).serial
        whose = f" of {owner}" if owner == serial else f" of {owner}, another unit's than {serial},"
        model = apply(design, decode(design, content, str(file)))
        return DeployedBlock(model, f"run with the block{whose} in {file}")
    if not config.block.in_block:
        return None
    design = _find_own_design(directory)
    if design is None:
        command = "firmware" if sensor is None else "fleet"
        raise InputError(
            f"{config.firmware_out}: holds no design.json, with which a block is read. Run"
            f" `zerodrift {command}`, or name a block beside its design.json by --block FILE."
        )
    loaded = _find_loaded(directory, serial)
    if loaded is not None:
        return _read_loaded(loaded, design, serial)
    own = config.firmware_out / f"{BLOCK}.bin"
    if sensor is not None:
        own = load_config(directory).firmware_out / BLOCKS / f"{sensor}.bin"
    if not own.is_file():
        raise InputError(
            f"{own}: there is no block of {serial}, so that it is not known what its chip computes."
            " Name its block by --block FILE."
        )
    model = apply(design, decode(design, read_block_file(own, design), str(own)))
    return DeployedBlock(model, f"run with the block of {serial} that was written last, {own}")


def _find_sensor(config: Config) -> str | None:
    """Return the unit's name in its fleet; None without one."""
    return config.unit_build.name if config.unit_build is not None else None


def _read_loaded(loaded: LoadedBlock, design: BlockDesign, serial: str) -> DeployedBlock:
    number = loaded.sha256[:12]
    where = f"{REGISTRY}, block {number} on {serial}"
    try:
        model = apply(design, decode(design, loaded.content, where))
    except InputError as error:
        raise InputError(
            f"{error} If another block is on {serial} now, enter it by `zerodrift registry"
            f" block {serial} FILE --loaded`; or name one, its design.json beside it, by"
            " --block FILE."
        ) from error
    loaded_at = loaded.loaded_at[:16].replace("T", " ")
    note = f"run with the block {number} that {REGISTRY} says is on {serial} since {loaded_at} UTC"
    return DeployedBlock(model, note)


def _find_own_design(directory: Path) -> BlockDesign | None:
    place = find_design(load_config(directory).firmware_out)
    return load_design(place) if place is not None else None


def _find_loaded(directory: Path, serial: str) -> LoadedBlock | None:
    path = directory / REGISTRY
    if not path.is_file():
        return None
    with open_registry(path) as registry:
        return registry.find_loaded(serial)
