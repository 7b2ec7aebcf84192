"""Batches that go to where none of the driver's files can be seen, and what comes back of them.

A parcel holds the configuration, the logs that are files, and what the first pass left. The worker
lays them out in a folder of its own, fetches logs that are named by a URL, works there as anywhere,
and returns what it would have written; the driver writes it. Every file travels with its hash.
"""

import hashlib
import os
import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

from zerodrift import __version__
from zerodrift.base.config import USES
from zerodrift.base.errors import CheckError
from zerodrift.base.files import refuse_foreign
from zerodrift.base.fleet_config import URL
from zerodrift.base.journal import gather_changes, write_all
from zerodrift.dataset.selectors import JOINT, expand_selectors
from zerodrift.fleet.result import SensorOutcome
from zerodrift.fleet.sensors import (
    SELECTOR_SUFFIX,
    Design,
    Origin,
    configure_sensor,
    fetch,
    names_urls,
)
from zerodrift.fleet.work import UnitBatch

if TYPE_CHECKING:
    from zerodrift.fleet.block_work import BlockRun

PARTS_TOGETHER = (".db3",)
"""Suffixes of logs that are read together with the files beside them."""


@dataclass(frozen=True)
class Sealed:
    """A file's content on its way."""

    content: bytes
    sha256: str

    @classmethod
    def of(cls, content: bytes) -> "Sealed":
        """Return the content with its hash."""
        return cls(content, hashlib.sha256(content).hexdigest())

    def open(self, name: str) -> bytes:
        """Return the content.

        Raises:
            CheckError: it is not what was sent.
        """
        actual = hashlib.sha256(self.content).hexdigest()
        if actual != self.sha256:
            raise CheckError(
                f"{name}: arrived with the SHA-256 {actual}; expected {self.sha256}, of what was"
                " sent. Run the command again; if it stays so, look at memory and network."
            )
        return self.content


@dataclass(frozen=True)
class Parcel:
    """A batch and all that is needed to work on it."""

    run: "Design | BlockRun"
    sensors: tuple[str, ...]
    mark: str
    """Of the design."""
    shared: Mapping[str, Sealed]
    """Absolute path at the driver -> file: zerodrift.toml, plug-ins."""
    own: Mapping[str, Mapping[str, Sealed]]
    """Sensor -> the same of its logs, and of what an earlier pass wrote."""
    version: str = __version__


@dataclass(frozen=True)
class Delivery:
    """What came of one sensor."""

    outcome: SensorOutcome
    files: Mapping[str, Sealed | None] = field(default_factory=dict)
    """Path relative to the project, or absolute outside of it -> file; None: to be removed."""


def pack(run: "Design | BlockRun", sensors: Sequence[str]) -> tuple[Parcel, list[SensorOutcome]]:
    """Return a batch with its files, and the outcomes of sensors whose files cannot be read.

    Args:
        run: the first pass, or the second, in which blocks are tried.
        sensors: their names.
    """
    design = _get_design(run)
    batch = UnitBatch(sensors)
    own = {}
    for sensor in sensors:
        files = batch.attempt(sensor, _collect, design, sensor, design is not run)
        if files is not None:
            own[sensor] = files
    shared = _seal([design.config.path, *design.config.plugin_files])
    parcel = Parcel(
        _set_design(run, replace(design, spool=None)), tuple(own), design.mark, shared, own
    )
    return parcel, list(batch.outcomes.values())


def work_on_parcel(
    parcel: Parcel, work: "Callable[[Design | BlockRun, tuple[str, ...]], list[SensorOutcome]]"
) -> list[Delivery]:
    """Return what comes of the sensors in a parcel; nothing stays on this machine.

    Args:
        parcel: the batch.
        work: works on it as on any.
    """
    batch = UnitBatch(parcel.sensors)
    try:
        _refuse_wrong(parcel)
    except CheckError as error:
        return [Delivery(SensorOutcome(s, None, str(error))) for s in parcel.sensors]
    with _open_mirror(_get_design(parcel.run), parcel.shared, parcel.mark) as design:
        assert design.origin is not None
        ready = [s for s in parcel.sensors if batch.attempt(s, _unpack, design, parcel, s)]
        with gather_changes(design.directory) as contents:
            for outcome in work(_set_design(parcel.run, design), tuple(ready)):
                batch.outcomes[outcome.sensor] = outcome
        for sensor in ready:
            contents |= _find_left(design, parcel, sensor, contents)
        return [
            Delivery(
                replace(outcome, error=design.tell(outcome.error)),
                _pick(design, outcome.sensor, contents) if outcome.result is not None else {},
            )
            for outcome in batch.list()
        ]


def _refuse_wrong(parcel: Parcel) -> None:
    """Refuse a parcel that this machine cannot work on.

    Raises:
        CheckError: another zerodrift has packed it, or a shared file is not what was sent.
    """
    if parcel.version != __version__:
        raise CheckError(
            f"a worker has zerodrift {__version__}; expected {parcel.version}, as where the command"
            " runs. Install the same on every machine of the cluster."
        )
    for name, sealed in parcel.shared.items():
        sealed.open(name)


def deliver(run: "Design | BlockRun", deliveries: Iterable[Delivery]) -> list[SensorOutcome]:
    """Write what came back, each sensor's files as one change; return the outcomes.

    Args:
        run: as it was packed, on the machine whose project it is; its lock is held.
        deliveries: of a batch.
    """
    design = _get_design(run)
    arrived = list(deliveries)
    batch = UnitBatch([delivery.outcome.sensor for delivery in arrived])
    for delivery in arrived:
        sensor = delivery.outcome.sensor
        if batch.attempt(sensor, _write, design, sensor, delivery.files):
            batch.outcomes[sensor] = delivery.outcome
    return batch.list()


@contextmanager
def at_hand(design: Design, sensor: str) -> Iterator[Design]:
    """Yield the design with a sensor's logs on this machine; the design itself where they are.

    Raises:
        InputError: a log cannot be fetched.
    """
    if not names_urls(design.config):
        yield design
        return
    shared = _seal([design.config.path, *design.config.plugin_files])
    with _open_mirror(design, shared, design.mark) as near:
        _lay_out(near, _collect(design, sensor, with_build=False))
        _fetch_logs(near, sensor)
        yield near


@contextmanager
def _open_mirror(design: Design, shared: Mapping[str, Sealed], mark: str) -> Iterator[Design]:
    """Yield the design below a folder that stands for the driver's file system."""
    with tempfile.TemporaryDirectory(prefix="zerodrift-parcel-") as folder:
        root = Path(folder).resolve()
        config = design.config
        path, out = _mirror(root, config.path), config.firmware_out
        if out.is_relative_to(config.directory):
            out = path.parent / out.relative_to(config.directory)
        near = replace(
            config,
            path=path,
            plugin_files=tuple(_mirror(root, path) for path in config.plugin_files),
            firmware_out=out,
            fleet=replace(config.fleet, folder=_move(root, config.fleet.folder)),
            train_logs=tuple(_move(root, text) for text in config.train_logs),
            test_logs=tuple(_move(root, text) for text in config.test_logs),
            dwell_logs=tuple(_move(root, text) for text in config.dwell_logs),
        )
        mirrored = replace(design, config=near, spool=None, origin=Origin(root, mark))
        _lay_out(mirrored, shared)
        yield mirrored


def _mirror(root: Path, path: Path) -> Path:
    """Return where a file of the driver lies below a worker's folder."""
    plain = Path(os.path.normpath(path.absolute()))
    return root / plain.relative_to(plain.anchor)


def _move(root: Path, selector: str) -> str:
    """Return a selector whose absolute paths are those below a worker's folder."""
    parts = selector.split(JOINT)
    return JOINT.join(str(root) + p if Path(p).is_absolute() else p for p in parts)


def _collect(design: Design, sensor: str, with_build: bool) -> dict[str, Sealed]:
    """Return a sensor's logs that are files, and what lies in its folder below build/."""
    config = configure_sensor(design.config, sensor)
    here = replace(
        config,
        train_logs=_leave_out_urls(config.train_logs),
        test_logs=_leave_out_urls(config.test_logs),
        dwell_logs=_leave_out_urls(config.dwell_logs),
    )
    paths: set[Path] = set()
    for selection in (selection for use in USES for selection in expand_selectors(here, use)):
        paths.update(selection.files)
        beside = {p.parent for p in selection.files if p.suffix.lower() in PARTS_TOGETHER}
        for folder in {*beside, *([selection.path] if selection.path.is_dir() else [])}:
            paths.update(path for path in folder.iterdir() if path.is_file())
    if with_build:
        build = design.build_folder(sensor)
        paths.update(path for path in build.rglob("*") if path.is_file())
    return _seal(sorted(paths))


def _leave_out_urls(selectors: Sequence[str]) -> tuple[str, ...]:
    return tuple(selector for selector in selectors if URL not in selector)


def _seal(paths: Iterable[Path]) -> dict[str, Sealed]:
    return {str(path): Sealed.of(path.read_bytes()) for path in paths}


def _unpack(design: Design, parcel: Parcel, sensor: str) -> bool:
    """Lay out a sensor's files where the worker looks for them."""
    _lay_out(design, parcel.own[sensor])
    _fetch_logs(design, sensor)
    return True


def _lay_out(design: Design, files: Mapping[str, Sealed]) -> None:
    assert design.origin is not None
    for name, sealed in files.items():
        place = _mirror(design.origin.root, Path(name))
        place.parent.mkdir(parents=True, exist_ok=True)
        place.write_bytes(sealed.open(name))


def _fetch_logs(design: Design, sensor: str) -> None:
    """Fetch what a sensor's selectors name by URL.

    Raises:
        CheckError: a log cannot be fetched, or none matches; the message names sensor and URL.
    """
    config = configure_sensor(design.config, sensor)
    for use in USES:
        for selector in getattr(config, f"{use}_logs"):
            for part in selector.split(JOINT):
                url = SELECTOR_SUFFIX.sub("", part.strip())
                if URL in url and not fetch(url, design.directory):
                    raise CheckError(
                        f"sensor {sensor}: nothing matches '{url}', a URL of [logs] {use}; expected"
                        " one log or more. Copy them there, or correct the URL."
                    )


def _find_left(
    design: Design, parcel: Parcel, sensor: str, contents: Mapping[Path, bytes | None]
) -> dict[Path, bytes]:
    """Return what the work has written by itself, such as checkpoints that are kept."""
    assert design.origin is not None
    sent = {_mirror(design.origin.root, Path(name)) for name in parcel.own[sensor]}
    found = (path for path in design.build_folder(sensor).rglob("*") if path.is_file())
    return {p: p.read_bytes() for p in found if p not in sent and p not in contents}


def _pick(
    design: Design, sensor: str, contents: Mapping[Path, bytes | None]
) -> dict[str, Sealed | None]:
    """Return a sensor's files by the names that the driver knows them by."""
    folders = (design.build_folder(sensor), design.firmware_folder(sensor))
    return {
        _name(design, path): None if content is None else Sealed.of(content)
        for path, content in contents.items()
        if any(path.is_relative_to(folder) for folder in folders)
    }


def _name(design: Design, path: Path) -> str:
    inside = path.is_relative_to(design.directory)
    return str(path.relative_to(design.directory)) if inside else str(path)


def _write(design: Design, sensor: str, files: Mapping[str, Sealed | None]) -> bool:
    contents = {
        design.directory / name: None if sealed is None else sealed.open(f"sensor {sensor}: {name}")
        for name, sealed in files.items()
    }
    out = design.firmware_folder(sensor)
    refuse_foreign((path for path in contents if path.is_relative_to(out)), out)
    write_all(design.directory, contents, durable=False, under_lock=True)
    return True


def _get_design(run: "Design | BlockRun") -> Design:
    return run if isinstance(run, Design) else run.design


def _set_design(run: "Design | BlockRun", design: Design) -> "Design | BlockRun":
    return design if isinstance(run, Design) else replace(run, design=design)
