"""Which sensors there are: the names that stand where `{sensor}` stands, and each one's logs."""

import glob
import hashlib
import json
import os
import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

from zerodrift import __version__
from zerodrift.base.config import TRAIN, USES, Config, load_config, locate_key
from zerodrift.base.errors import InputError, ZerodriftError, nearest
from zerodrift.base.extras import FLEET_URL, require
from zerodrift.base.fleet_config import PLACEHOLDER, URL
from zerodrift.dataset.selectors import expand_selectors
from zerodrift.export.integer_model import FORMAT as MODEL_FORMAT
from zerodrift.fleet.result import FORMAT

if TYPE_CHECKING:
    from fsspec import AbstractFileSystem


# Logs that are named by a URL: listed, and fetched whole, through fsspec.

SUMS = "SHA256SUMS"
"""Beside logs, as `sha256sum` writes it: the hashes that they must have."""
MAGIC = "*?["


def list_names(pattern: str, *, folders: bool) -> list[str]:
    """Return the URLs that match a pattern, sorted.

    Args:
        pattern: a URL with `*`, `?` or `[...]` in parts of its path.
        folders: whether folders or files are looked for.

    Raises:
        InputError: the store is unknown, its library is missing, or it does not answer.
    """
    with _telling_of(pattern):
        store, path = _open(pattern)
        found = store.glob(path, detail=True)
        kind = "directory" if folders else "file"
        names = (name for name, told in found.items() if told.get("type") == kind)
        return sorted(_name(store, pattern, name) for name in names)


def fetch(pattern: str, folder: Path) -> list[Path]:
    """Fetch the files that a pattern matches, or those in the folders that it matches.

    A file is complete: it has the size that the store states, before and after, and the hash that
    `SHA256SUMS` beside it states, if there is one. A local file is linked and not copied.

    Args:
        pattern: a URL, perhaps with `*`, `?` or `[...]`.
        folder: where to put them, `s3://bucket/log.csv` as `s3:/bucket/log.csv`.

    Returns:
        The files here; none where nothing matches.

    Raises:
        InputError: as `list_names`; or a file is incomplete, or changes while it is read.
    """
    with _telling_of(pattern):
        store, path = _open(pattern)
        is_plain = not any(sign in path for sign in MAGIC)
        found = [path] if is_plain and store.exists(path) else store.glob(path)
        files: list[str] = []
        for name in found:
            files += store.find(name, maxdepth=1) if store.isdir(name) else [name]
    sums: dict[str, dict[str, str]] = {}
    return [_fetch_file(store, pattern, name, folder, sums) for name in sorted(set(files))]


def _fetch_file(
    store: "AbstractFileSystem",
    pattern: str,
    name: str,
    folder: Path,
    sums: dict[str, dict[str, str]],
) -> Path:
    url = _name(store, pattern, name)
    scheme, rest = url.split(URL, 1)
    place = Path(os.path.normpath(folder / f"{scheme}:" / rest.lstrip("/")))
    if not place.is_relative_to(folder / f"{scheme}:"):
        raise InputError(f"{url}: leads out of its store; expected a plain path. Rename the log.")
    place.parent.mkdir(parents=True, exist_ok=True)
    if "file" in _list_protocols(store):
        place.unlink(missing_ok=True)
        place.symlink_to(name)
        return place
    with _telling_of(url):
        before = store.info(name)
        content = store.cat_file(name)
        store.invalidate_cache()
        after = store.info(name)
    size, then = before.get("size"), after.get("size")
    if size != then or (size is not None and size != len(content)):
        raise InputError(
            f"{url}: {len(content)} bytes came, the store states {size} before and {then} after;"
            " expected one size, of a log that is whole and no longer written. Run the command"
            " again."
        )
    parent, _, own = name.rpartition("/")
    if parent not in sums:
        sums[parent] = _read_sums(store, pattern, f"{parent}/{SUMS}")
    expected, actual = sums[parent].get(own), hashlib.sha256(content).hexdigest()
    if expected not in (None, actual):
        raise InputError(
            f"{url}: has the SHA-256 {actual}; expected {expected}, as {SUMS} beside it states."
            " Copy the log to the store again, or correct that file."
        )
    place.write_bytes(content)
    return place


def _read_sums(store: "AbstractFileSystem", pattern: str, name: str) -> dict[str, str]:
    """Return file -> SHA-256 as a file of `sha256sum` states them; empty where there is none."""
    with _telling_of(_name(store, pattern, name)):
        if not store.exists(name):
            return {}
        lines = store.cat_file(name).decode().splitlines()
    pairs = (line.split(maxsplit=1) for line in lines if line.strip())
    return {own.lstrip("*"): value.lower() for value, own in pairs}


def _open(url: str) -> "tuple[AbstractFileSystem, str]":
    require(FLEET_URL, f"'{url}'")
    from fsspec.core import url_to_fs

    store, path = url_to_fs(url)
    return store, str(path)


def _name(store: "AbstractFileSystem", pattern: str, name: str) -> str:
    """Return a file's URL, its scheme as the pattern writes it."""
    rest = str(store.unstrip_protocol(name)).split(URL, 1)[1].rstrip("/")
    scheme, given = pattern.split(URL, 1)
    return f"{scheme}{URL}{rest if given.startswith('/') else rest.lstrip('/')}"


def _list_protocols(store: "AbstractFileSystem") -> tuple[str, ...]:
    return (store.protocol,) if isinstance(store.protocol, str) else tuple(store.protocol)


@contextmanager
def _telling_of(url: str) -> Iterator[None]:
    """Put what a store's library raises into words; each has errors of its own."""
    try:
        yield
    except ZerodriftError:
        raise
    except Exception as error:  # stores' libraries raise many kinds
        raise InputError(
            f"{url}: cannot be read ({type(error).__name__}: {error}); expected a store that fsspec"
            " reaches from every machine that works on the fleet. Correct the URL, install what the"
            " store needs there, or see to its address and access."
        ) from error


# Which sensors there are: the names that stand where `{sensor}` stands, and each one's logs.

SELECTOR_SUFFIX = re.compile(r"(#[^#/]+)?(@[^@#/]*:[^@#/]*)?$")
"""Of a selector: the run and the part of it that are meant."""
_GLOB = re.compile(r"\[!?\]?[^\]]*\]|.", re.DOTALL)
FOLDER = "fleet"
"""Below build/: one folder per sensor, and the report."""
FOLDERS_SHOWN = 3
SENSORS_SHOWN = 8
RESERVED = frozenset({"runtime", "program", "blocks", "report.json", "report.csv", "report.md"})
"""What lies beside the sensors' folders, on disks that do not tell capitals apart too."""


def list_selectors(config: Config, use: str) -> tuple[str, ...]:
    """Return the selectors of `[logs] use`, those of a fleet's folders put below the folder."""
    selectors: tuple[str, ...] = getattr(config, f"{use}_logs")
    folder = config.fleet.folder
    if not folder:
        return selectors
    return tuple(s if PLACEHOLDER in s else f"{folder}/{s}" for s in selectors)


def names_urls(config: Config) -> bool:
    """Tell whether any log of the fleet is named by a URL."""
    return any(URL in selector for use in USES for selector in list_selectors(config, use))


def find_sensors(config: Config) -> tuple[str, ...]:
    """Return the sensors' names, sorted: whatever stands in place of `{sensor}`.

    Raises:
        InputError: nothing says where the sensors are, or nothing is there.
    """
    if config.fleet.folder:
        names = match_names(config.directory, config.fleet.folder, folders=True)
        where, pattern = locate_key(config.path, "fleet", "folder"), config.fleet.folder
    else:
        selectors = {use: list_selectors(config, use) for use in USES}
        where = locate_key(config.path, "logs", "train")
        if not any(PLACEHOLDER in text for text in selectors[TRAIN]):
            raise InputError(explain_no_placeholder(config, where))
        named = [text for texts in selectors.values() for text in texts if PLACEHOLDER in text]
        patterns = [SELECTOR_SUFFIX.sub("", text) for text in named]
        names = {n for p in patterns for n in match_names(config.directory, p, folders=False)}
        pattern = patterns[0]
    if not names:
        kind = "folder" if config.fleet.folder else "log"
        raise InputError(
            f"{where}: no {kind} matches '{pattern}'; expected one or more per sensor, its name in"
            f" place of {PLACEHOLDER}. Correct the path, which is relative to"
            f" {config.directory}."
        )
    return tuple(sorted(names))


def match_names(directory: Path, pattern: str, *, folders: bool) -> set[str]:
    """Return what stands for `{sensor}` in the paths that a pattern matches.

    Args:
        directory: what the pattern is relative to.
        pattern: a glob with the placeholder in one or more of its parts; the first one tells.
        folders: whether it names folders rather than files.
    """
    wanted = pattern.replace(PLACEHOLDER, "*")
    expression = re.compile(_translate(pattern))
    if URL in pattern:
        urls = (expression.fullmatch(url) for url in list_names(wanted, folders=folders))
        return {match["sensor"] for match in urls if match}
    found = glob.glob(  # noqa: PTH207 - Path.glob refuses `..` and absolute patterns
        wanted, root_dir=directory, recursive=True
    )
    names = set()
    for text in found:
        match = expression.fullmatch(Path(text).as_posix())
        if match and (directory / text).is_dir() == folders:
            names.add(match["sensor"])
    return names


def _translate(pattern: str) -> str:
    """Return a regular expression for a glob, `{sensor}` as a group that holds no separator."""
    parts = []
    seen = False
    for part in pattern.split("/"):
        pieces = part.split(PLACEHOLDER)
        text = ""
        for number, piece in enumerate(pieces):
            if number:
                text += "(?P=sensor)" if seen else "(?P<sensor>[^/]+?)"
                seen = True
            text += _translate_piece(piece)
        parts.append("(?:.*/)?" if part == "**" else text + "/")
    return "".join(parts).removesuffix("/")


def _translate_piece(piece: str) -> str:
    """Return a regular expression for a part of a glob that holds neither `/` nor `**`."""

    def translate(match: re.Match[str]) -> str:
        text = match[0]
        if text[0] == "[" and len(text) > 1:
            inside = text[1:-1].replace("\\", r"\\")
            return f"[^{inside[1:]}]" if inside.startswith("!") else f"[{inside}]"
        return {"*": "[^/]*", "?": "[^/]"}.get(text) or re.escape(text)

    return _GLOB.sub(translate, piece)


def configure_sensor(config: Config, sensor: str) -> Config:
    """Return the project of one sensor of the fleet: the design, with this sensor's logs.

    Raises:
        InputError: the name means something else in a selector.
    """
    if re.search(r"[#@{}\x00-\x1f]", sensor):
        raise InputError(
            f"sensor {sensor!r}: a sensor's name has none of # @ {{ }}, which mean something else"
            " in the selectors of [logs]. Rename its folder or logs."
        )
    if sensor.casefold() in RESERVED:
        raise InputError(
            f"sensor {sensor!r}: the fleet keeps files of its own under this name; expected any"
            f" other than {', '.join(sorted(RESERVED))}. Rename its folder or logs."
        )
    literal = glob.escape(sensor)
    logs = {
        f"{use}_logs": tuple(s.replace(PLACEHOLDER, literal) for s in list_selectors(config, use))
        for use in USES
    }
    prefix = config.firmware_prefix.replace(PLACEHOLDER, sensor)
    return replace(config, firmware_prefix=prefix, **logs)  # type: ignore[arg-type]  # the three are tuples of text


def open_sensor(config: Config, sensor: str) -> Config:
    """Return the project of one sensor, its model and its C where `fleet` writes them.

    Raises:
        InputError: the project is no fleet, or has no such sensor.
    """
    names = find_sensors(config)
    if sensor not in names:
        shown = ", ".join(names[:SENSORS_SHOWN]) + (", ..." if len(names) > SENSORS_SHOWN else "")
        raise InputError(
            f"--sensor {sensor}: {config.path} has no such sensor{nearest(sensor, names) or '.'} "
            f"It has {shown}; expected one of {len(names)}."
        )
    return replace(
        configure_sensor(config, sensor),
        unit_build=config.build_directory / FOLDER / sensor,
        firmware_out=config.firmware_out / sensor,
    )


def load_unit(path: Path, sensor: str | None) -> Config:
    """Return the project of a directory, or that of one of its sensors.

    Raises:
        InputError: as `load_config` and `open_sensor`.
    """
    config = load_config(path)
    return config if sensor is None else open_sensor(config, sensor)


def explain_no_placeholder(config: Config, where: str) -> str:
    """Return the message that shows how a fleet is described, from what lies in the directory."""
    guess = guess_folder(config.directory)
    found = ""
    if guess is not None:
        parent, names = guess
        shown = ", ".join(names[:FOLDERS_SHOWN]) + (", ..." if len(names) > FOLDERS_SHOWN else "")
        found = f" {parent}/ has {len(names)} folders with logs ({shown})."
    folder = f"{guess[0] if guess else 'fleet'}/{PLACEHOLDER}"
    return (
        f"{where}: nothing says which logs are which sensor's; expected {PLACEHOLDER} in the place"
        f" of the sensor's name.{found} Add to {config.path.name}\n\n"
        f'    [fleet]\n    folder = "{folder}"\n\n'
        "and name the logs relative to that folder in [logs], for example"
        f' train = ["chamber_*.csv"]; or, where all logs lie together, write'
        f' train = ["logs/{PLACEHOLDER}_*.csv"].'
    )


def guess_folder(directory: Path) -> tuple[str, tuple[str, ...]] | None:
    """Return the folder with the most subfolders that hold logs, and these; None without any."""
    from zerodrift.dataset.selectors import list_files  # the page's first sight waits for no NumPy

    best: tuple[str, tuple[str, ...]] | None = None
    for parent in sorted(path for path in directory.iterdir() if path.is_dir()):
        if parent.name.startswith(".") or parent.name in ("build", "firmware"):
            continue
        names = tuple(
            sorted(
                folder.name for folder in parent.iterdir() if folder.is_dir() and list_files(folder)
            )
        )
        if names and (best is None or len(names) > len(best[1])):
            best = (parent.name, names)
    return best


# What all sensors of a fleet share, and the folders of each one's files.

_SCHEME = "[a-z][a-z0-9+.-]+"
ROOTED = ("file", "local")
"""Schemes of URLs whose path begins with a slash."""


@dataclass(frozen=True)
class Origin:
    """Where work on a fleet was sent from, for a process that sees none of that machine's files."""

    root: Path
    """Here: the folder that stands for the root of its file system; `config` is below it."""
    mark: str
    """Of the design, as it is there."""


@dataclass(frozen=True)
class Design:
    """One design and how its sensors are to be worked on; goes to other processes as it is."""

    config: Config
    """Of the fleet: selectors still hold `{sensor}`."""
    firmware: bool = True
    """Whether C is generated and checked."""
    skip_invalid: bool = False
    device: str = "cpu"
    """Where the networks are trained."""
    force: bool = False
    """Whether a unit's firmware is written although the gate refuses it."""
    uncertainty: bool = True
    """Whether models leave training runs out for it; without firmware there is none."""
    spool: Path | None = None
    """With blocks: a folder for what a second pass would have to read or compute again."""
    origin: Origin | None = None
    """Where the work was sent from; None: from here."""

    @property
    def directory(self) -> Path:
        """Where zerodrift.toml lies."""
        return self.config.directory

    @property
    def in_block(self) -> bool:
        """Whether one program serves all sensors, each with a block of its own."""
        return self.firmware and self.config.block.in_block

    @property
    def build(self) -> Path:
        """Folder of the fleet's results and report."""
        return self.config.build_directory / FOLDER

    def build_folder(self, sensor: str) -> Path:
        """Return the folder of one sensor's model and result."""
        return self.build / sensor

    def firmware_folder(self, sensor: str) -> Path:
        """Return the folder of one sensor's C."""
        return self.config.firmware_out / sensor

    def place(self, config: Config, sensor: str) -> Config:
        """Return a sensor's project with its own build directory, for what keeps files there."""
        path = self.build_folder(sensor) / config.path.name
        return replace(config, path=path)

    @cached_property
    def mark(self) -> str:
        """Mark of everything about the design that a sensor's result depends on."""
        if self.origin is not None:
            return self.origin.mark
        c = self.config
        values = [
            [FORMAT, MODEL_FORMAT, __version__, self.firmware, self.skip_invalid, self.device],
            [self.uncertainty],
            [c.sensor_name, c.time_column, c.temperature_column, c.sample_period_s],
            [[o.name, o.measured, o.reference, o.unit, o.full_scale] for o in c.outputs],
            [dict(c.inputs), dict(c.where), c.weights, self._name(c.firmware_out)],
            [asdict(c.temperature_codes), {n: asdict(v) for n, v in c.input_codes.items()}],
            [[getattr(c, f"{use}_logs") for use in USES], c.fleet.folder],
            [[e.kind, dict(e.held), dict(e.options)] for e in c.effects],
            [c.network.kind, c.network.hidden, c.network.memory, c.network.seed],
            [dict(c.network.options), list(c.network.lags_s)],
            [c.firmware_prefix, c.firmware_guard, *([True] if c.block.in_block else [])],
            *([[c.variable_step, c.firmware_tare]] if c.variable_step or c.firmware_tare else []),
        ]
        digest = hashlib.sha256(json.dumps(values, sort_keys=True).encode())
        for file in c.plugin_files:
            digest.update(file.read_bytes())
        return digest.hexdigest()

    def mark_sensor(self, config: Config) -> str:
        """Return the mark of the design and of one sensor's logs, their bytes included.

        Raises:
            InputError: the sensor lacks logs.
        """
        digest = hashlib.sha256(self.mark.encode())
        for use in USES:
            for selection in expand_selectors(config, use):
                for path in selection.files:
                    digest.update(f"{use} {self._name(path)} {selection.run_pattern}".encode())
                    with path.open("rb") as file:
                        digest.update(hashlib.file_digest(file, "sha256").digest())
        return digest.hexdigest()

    def _name(self, path: Path) -> str:
        """Return a path as the project sees it, so that the whole project may be moved."""
        inside = path.is_relative_to(self.directory)
        return path.relative_to(self.directory).as_posix() if inside else self.tell(str(path))

    def tell(self, text: str) -> str:
        """Return a text in which paths are those of the machine that the work was sent from."""
        if self.origin is None:
            return text
        own = re.escape(str(self.directory))
        text = re.sub(rf"(?:{own}/)?\b({_SCHEME}):/(?![/\s])", _write_url, text)
        return text.replace(str(self.origin.root), "")


def _write_url(match: re.Match[str]) -> str:
    """Return a URL's beginning for that of the path by which a fetched log lies here."""
    return f"{match[1]}://{'/' if match[1] in ROOTED else ''}"
