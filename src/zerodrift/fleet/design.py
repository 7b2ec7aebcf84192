"""What all sensors of a fleet share, and the folders of each one's files."""

import hashlib
import json
import re
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from pathlib import Path

from zerodrift import __version__
from zerodrift.base.config import USES, Config
from zerodrift.dataset.selectors import expand_selectors
from zerodrift.export.integer_model import FORMAT as MODEL_FORMAT
from zerodrift.fleet.result import FORMAT
from zerodrift.fleet.sensors import FOLDER

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
