"""firmware/manifest.json: what a firmware was made from and what it consists of, as hashes.

It has no date and no path of this machine in it: the same project gives the same bytes again.
`check_manifest` compares it with the present files; every command that takes a firmware uses it.
"""

import hashlib
import json
import os
import re
import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from zerodrift import __version__
from zerodrift.base.config import USES, Config
from zerodrift.base.errors import CheckError, InputError
from zerodrift.base.files import NOT_THERE
from zerodrift.base.records import from_json, read_format, to_dict
from zerodrift.dataset.selectors import expand_selectors

FILE_NAME = "manifest.json"
FORMAT = 1
CONFIGURATION = "zerodrift.toml"
UNRELATED_TABLES = ("fleet",)
"""Of zerodrift.toml: no single firmware depends on them."""
_NAMED = re.compile(rb'^#define\s+\w+_MANIFEST\s+"', re.MULTILINE)
"""How a header says that it has a manifest beside it."""
_AGAIN = "Run `zerodrift firmware` again."

CHANGED, MISSING, STALE, DAMAGED = "changed", "missing", "stale", "damaged"
"""Kinds of findings: a file is not as it was written, is gone, what it was made from is no longer
the same, the manifest itself cannot be read."""


@dataclass(frozen=True)
class Inputs:
    """What a firmware is made from, each by name -> SHA-256."""

    configuration: Mapping[str, str]
    """Tables of zerodrift.toml, comments and layout aside, and the files of the user's effects."""
    logs: Mapping[str, str]
    network: Mapping[str, str] = field(default_factory=dict)
    """The ONNX file whose network it is, where that was imported."""


@dataclass(frozen=True)
class Manifest:
    """What manifest.json holds."""

    zerodrift: str
    """Version that built the firmware."""
    compiler: str
    """The host compiler by which the C was checked, as it names itself."""
    model_hash: str
    forced: tuple[str, ...]
    """What was found against this firmware and overridden; empty for an ordinary one."""
    inputs: Inputs
    firmware: Mapping[str, str]
    """Path relative to the manifest -> SHA-256."""
    build: Mapping[str, str]
    """Name in build/ -> SHA-256."""

    def to_text(self) -> str:
        """Return the file's text."""
        inputs = self.inputs
        body = _ManifestFile(
            format=FORMAT,
            zerodrift=self.zerodrift,
            compiler=self.compiler,
            model=self.model_hash,
            forced=self.forced,
            firmware=dict(sorted(self.firmware.items())),
            build=dict(sorted(self.build.items())),
            configuration=dict(sorted(inputs.configuration.items())),
            logs=dict(sorted(inputs.logs.items())),
            network=dict(sorted(inputs.network.items())),
        )
        return json.dumps(to_dict(body), indent=1, ensure_ascii=False) + "\n"


@dataclass(frozen=True)
class _ManifestFile:
    """manifest.json, key by key."""

    format: int
    zerodrift: str
    compiler: str
    model: str
    forced: tuple[str, ...]
    firmware: Mapping[str, str]
    build: Mapping[str, str]
    configuration: Mapping[str, str]
    logs: Mapping[str, str]
    network: Mapping[str, str]


@dataclass(frozen=True)
class ManifestFinding:
    """One thing that is not as the manifest says."""

    kind: str
    """changed | missing | stale | damaged."""
    name: str
    """File, as the project sees it, or table of zerodrift.toml."""
    text: str
    """The whole message."""

    @property
    def is_stale(self) -> bool:
        """Whether the files are as they were written, but would be made otherwise today."""
        return self.kind == STALE


@dataclass(frozen=True)
class NotChecked:
    """What could not be checked, and why."""

    what: str
    why: str


@dataclass(frozen=True)
class ManifestCheck:
    """A manifest held against what lies there."""

    manifest: Manifest | None
    """None where there is none, or none that can be read."""
    findings: tuple[ManifestFinding, ...]
    not_checked: tuple[NotChecked, ...]

    def require(self, name: str) -> "ManifestCheck":
        """Return self.

        Args:
            name: of the firmware, for the message.

        Raises:
            CheckError: something is not as the manifest says; names each.
        """
        if self.findings:
            lines = "\n  ".join(finding.text for finding in self.findings)
            raise CheckError(f"{name} is not what was built and checked:\n  {lines}\n{_AGAIN}")
        return self


def write_manifest(
    config: Config,
    model_hash: str,
    firmware: Mapping[str, bytes],
    build: Mapping[str, bytes],
    compiler: str,
    *,
    forced: tuple[str, ...] = (),
    network: tuple[Path, ...] = (),
) -> str:
    """Return the text of manifest.json.

    Args:
        config: the project.
        model_hash: of the integer model.
        firmware: path relative to the manifest -> content.
        build: name in build/ -> content.
        compiler: by which the C was checked.
        forced: what was found against this firmware and overridden.
        network: the ONNX file that the network comes from.

    Raises:
        InputError: a log or another file that it was made from cannot be read.
    """

    def hashes(contents: Mapping[str, bytes]) -> dict[str, str]:
        return {name: hashlib.sha256(content).hexdigest() for name, content in contents.items()}

    inputs = hash_inputs(config, network)
    manifest = Manifest(
        __version__, compiler, model_hash, forced, inputs, hashes(firmware), hashes(build)
    )
    return manifest.to_text()


def hash_inputs(config: Config, network: tuple[Path, ...] = ()) -> Inputs:
    """Return what a firmware of this project is made from.

    Raises:
        InputError: a selector matches no log, or a file cannot be read.
    """
    return Inputs(
        configuration=_hash_configuration(config),
        logs=hash_logs(config),
        network={_name(path, config.directory): hash_file(path) for path in network},
    )


def hash_logs(config: Config) -> dict[str, str]:
    """Return the hash of each log of a project by its name.

    Raises:
        InputError: a selector matches no log, or a file cannot be read.
    """
    paths = {path for use in USES for s in expand_selectors(config, use) for path in s.files}
    return {_name(path, config.directory): hash_file(path) for path in paths}


def _hash_configuration(config: Config) -> dict[str, str]:
    """Return the hash of each table's values, which comments and layout do not change."""
    tables: dict[str, object] = {}
    try:
        tables = tomllib.loads(config.path.read_text(encoding="utf-8-sig"))
    except FileNotFoundError:
        pass  # a network was imported without one; the project is guessed from its logs
    except (OSError, ValueError) as error:
        raise InputError(f"{config.path}: cannot be read ({error}).") from error
    found = {}
    for name, table in tables.items():
        if name not in UNRELATED_TABLES:
            text = json.dumps(table, sort_keys=True, default=str)
            found[f"{CONFIGURATION} [{name}]"] = hashlib.sha256(text.encode()).hexdigest()
    for path in config.plugin_files:
        found[_name(path, config.directory)] = hash_file(path)
    return found


def hash_file(path: Path) -> str:
    """Return the SHA-256 of a file.

    Raises:
        InputError: it cannot be read.
    """
    try:
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        raise InputError(
            f"{path}: cannot be read ({error.strerror}); expected a file that this user may read."
        ) from error


def _name(path: Path, directory: Path) -> str:
    """Return a path as the project sees it, so that the project may be moved."""
    try:
        return Path(os.path.relpath(path, directory)).as_posix()
    except ValueError:  # another drive
        return path.as_posix()


def load_manifest(path: Path) -> Manifest:
    """Read a manifest.

    Raises:
        InputError: it is missing, damaged, or of a later format.
        OSError: it exists and cannot be read.
    """
    try:
        content = path.read_bytes()
        if read_format(content) != FORMAT:
            raise ValueError(f"format {read_format(content)!r}; expected {FORMAT}")
        body = from_json(_ManifestFile, json.loads(content))
        return Manifest(
            zerodrift=body.zerodrift,
            compiler=body.compiler,
            model_hash=body.model,
            forced=body.forced,
            inputs=Inputs(body.configuration, body.logs, body.network),
            firmware=body.firmware,
            build=body.build,
        )
    except FileNotFoundError as error:
        raise InputError(f"{path}: there is no manifest. {_AGAIN}") from error
    except (*NOT_THERE, ValueError, RecursionError) as error:
        raise InputError(
            f"{path}: cannot be read as a manifest ({type(error).__name__}: {error}). {_AGAIN}"
        ) from error


def check_manifest(
    config: Config,
    *,
    folder: Path | None = None,
    build: Path | None = None,
    wants_inputs: bool = True,
) -> ManifestCheck:
    """Hold a firmware's manifest against its files, and against what it was made from.

    Args:
        config: the project.
        folder: where the C lies; by default `[firmware] out`.
        build: where the model lies; by default the project's build/.
        wants_inputs: whether configuration and logs are compared, too.

    Raises:
        InputError, OSError: a file is there and cannot be read, so that nothing is known of it.
    """
    folder, build = folder or config.firmware_out, build or config.build_directory
    path = folder / FILE_NAME
    shown = _name(path, config.directory)
    try:
        manifest = load_manifest(path)
    except InputError as error:
        if path.exists():
            return ManifestCheck(None, (ManifestFinding(DAMAGED, shown, str(error)),), ())
        named = find_naming_header(folder)
        if named is not None:
            text = f"{shown}: is missing; {named} says that it lies beside it."
            return ManifestCheck(None, (ManifestFinding(MISSING, shown, text),), ())
        why = f"there is no {shown}: the firmware is from before manifests"
        return ManifestCheck(None, (), (NotChecked("manifest", why),))
    findings = [
        *_check_files(manifest.firmware, folder, config.directory),
        *_check_files(manifest.build, build, config.directory),
    ]
    if wants_inputs:
        findings += _check_inputs(manifest.inputs, config)
    return ManifestCheck(manifest, tuple(findings), ())


def find_naming_header(folder: Path) -> str | None:
    """Return the header in a folder that names a manifest, if there is one."""
    for path in sorted(folder.glob("*.h")):
        try:
            if _NAMED.search(path.read_bytes()):
                return path.name
        except NOT_THERE:
            continue
    return None


def _check_files(
    known: Mapping[str, str], folder: Path, project: Path
) -> Iterator[ManifestFinding]:
    for name, expected in known.items():
        path = folder / name
        shown = _name(path, project)
        found = _hash_if_there(path)
        if not found:
            text = "is a directory; expected a file." if path.exists() else "is missing."
            yield ManifestFinding(MISSING, shown, f"{shown}: {text}")
        elif found != expected:
            yield ManifestFinding(CHANGED, shown, f"{shown}: was changed since it was written.")


def _check_inputs(known: Inputs, config: Config) -> Iterator[ManifestFinding]:
    try:
        configuration = _hash_configuration(config)
    except InputError as error:
        if isinstance(error.__cause__, OSError) and not isinstance(error.__cause__, NOT_THERE):
            raise
        yield ManifestFinding(STALE, CONFIGURATION, str(error))
        configuration = dict(known.configuration)
    yield from _compare(known.configuration, configuration)
    current: dict[str, Path] = {}
    for use in USES:
        try:
            selected = expand_selectors(config, use)
        except InputError as error:
            yield ManifestFinding(STALE, f"{CONFIGURATION} [logs] {use}", str(error))
            continue
        current |= {_name(path, config.directory): path for s in selected for path in s.files}
    listed = {**known.logs, **known.network}
    found = {name: _hash_if_there(config.directory / name) for name in listed}
    if not known.network:  # an imported network may have been calibrated on other logs
        found |= {
            name: _hash_if_there(path) for name, path in current.items() if name not in listed
        }
    there = {name: digest for name, digest in found.items() if digest}
    yield from _compare(listed, there)


def _hash_if_there(path: Path) -> str:
    """Return the SHA-256 of a file, or "" where there is none.

    Raises:
        InputError: it is there and cannot be read, which says nothing of what it holds.
    """
    try:
        return hash_file(path)
    except InputError as error:
        if isinstance(error.__cause__, NOT_THERE):
            return ""
        raise


def _compare(known: Mapping[str, str], found: Mapping[str, str]) -> Iterator[ManifestFinding]:
    """Yield what was changed, is gone or is new since the firmware was built."""
    for name in sorted({*known, *found}):
        if name not in found:
            yield ManifestFinding(STALE, name, f"{name}: is gone since the firmware was built.")
        elif name not in known:
            yield ManifestFinding(
                STALE, name, f"{name}: is new; the firmware was built without it."
            )
        elif known[name] != found[name]:
            yield ManifestFinding(STALE, name, f"{name}: was changed since the firmware was built.")
