"""A file of effects that is named in the place of an effect: `add my_effect.py`."""

from dataclasses import replace
from pathlib import Path

from zerodrift.base.config import Config
from zerodrift.base.errors import InputError
from zerodrift.physics.catalogue import Catalogue, load_catalogue
from zerodrift.tasks.trust import remember

SUFFIX = ".py"


def open_effect(config: Config, named: str) -> tuple[Config, Catalogue, str]:
    """Return the project, its known effects, and the name of the one that is meant.

    Of a file it is the one that the file declares, and the project is one that has the file among
    its own; `zerodrift.toml` is not changed by this.

    Args:
        config: the project.
        named: an effect, or a file of effects, seen from the current directory or the project's.

    Raises:
        InputError: there is no such file, it cannot be run, or it declares several effects.
    """
    if not named.endswith(SUFFIX):
        return config, load_catalogue(config.plugin_files), named
    file = next((p for p in (Path(named), config.directory / named) if p.is_file()), None)
    if file is None:
        raise InputError(
            f"{named}: there is no such file of effects, here or beside {config.path}. `zerodrift"
            f" propose --write {Path(named).name}` writes a formula as one."
        )
    known = next((p for p in config.plugin_files if p.resolve() == file.resolve()), None)
    place = config.path.parent / _name_in_project(config, file) if known is None else known
    if known is None:
        config = replace(config, plugin_files=(*config.plugin_files, place))
    catalogue = load_catalogue(config.plugin_files)
    declared = [effect.kind for effect in catalogue.listed() if effect.file == str(place)]
    if len(declared) != 1:
        raise InputError(
            f"{named}: declares {len(declared)} effects, {', '.join(declared)}; expected one, as"
            " one is added at a time. Name the file under [plugins] files, then add them by name."
        )
    remember((file,))
    return config, catalogue, declared[0]


def _name_in_project(config: Config, file: Path) -> str:
    """Return how zerodrift.toml names a file: seen from there if it lies below, else whole."""
    whole, home = file.resolve(), config.directory.resolve()
    return (whole.relative_to(home) if whole.is_relative_to(home) else whole).as_posix()
