"""`verify`: compares the files of a project's firmware folder and of build/ with the model."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Protocol

import numpy as np

from zerodrift.base.config import Config
from zerodrift.base.errors import CheckError, InputError, nearest
from zerodrift.base.fleet_config import SHARED_RUNTIME
from zerodrift.base.lock import make_scratch
from zerodrift.base.records import read_sealed
from zerodrift.blocks.block import apply, decode
from zerodrift.blocks.design import FILE_NAME as DESIGN
from zerodrift.blocks.design import load_design
from zerodrift.blocks.files import BLOCK, read_block_file
from zerodrift.c_runtime.host import render_sources
from zerodrift.codegen.generate import GeneratedCode, generate, generate_again, generate_design
from zerodrift.export.golden import GoldenVectors, compute_golden, load_golden
from zerodrift.export.integer_model import IntegerModel
from zerodrift.export.integer_onnx import build_integer_onnx
from zerodrift.export.model_files import load_model
from zerodrift.verify.certificate import FILE_NAME
from zerodrift.verify.firmware_check import Failure, Progress
from zerodrift.verify.folder_check import (
    SANITIZER,
    FolderCheck,
    check_folder,
    compare_texts,
    is_generated,
)
from zerodrift.verify.header_finding import HeaderFinding
from zerodrift.verify.manifest import (
    DAMAGED,
    ManifestCheck,
    ManifestFinding,
    NotChecked,
    check_manifest,
)
from zerodrift.verify.mismatch import Expected, expect, find_mismatch
from zerodrift.verify.summary import VerifySummary
from zerodrift.verify.vectors import draw_golden, draw_sequences, draw_starts
from zerodrift.verify.ways import HOST

# The certificate of a firmware folder, derived again while `verify` is at it.

CERTIFICATE = "certificate"


@dataclass(frozen=True)
class FolderCertificate:
    """What became of the certificate."""

    holds: int = 0
    """Claims that hold."""
    failures: tuple[str, ...] = ()
    """What does not follow from the C."""
    not_checked: tuple[NotChecked, ...] = ()


NO_CERTIFICATE = FolderCertificate()
"""It did not get that far."""


def check_folder_certificate(folder: Path, runtime: Mapping[str, str]) -> FolderCertificate:
    """Derive the bounds of a firmware folder's certificate again from the C that lies there.

    Args:
        folder: the firmware's. One without certificate.json, or with a runtime that this version
            has no rules for, is not checked.
        runtime: its runtime (zd_*), which units of a fleet share: file name -> text.
    """
    from zerodrift.verify.checkers import check_certificate, is_known

    if not (folder / FILE_NAME).is_file():
        return _leave("there is no certificate.json")
    if not is_known(runtime):
        return _leave("the runtime (zd_*) is of another version, or was changed")
    outcome = check_certificate(folder)
    return FolderCertificate(
        outcome.holds, tuple(f"{FILE_NAME}: {text}" for text in outcome.failures)
    )


def _leave(why: str) -> FolderCertificate:
    return FolderCertificate(not_checked=(NotChecked(CERTIFICATE, why),))


# What commands keep in build/ for later commands: files that carry a hash of themselves.

RECORDS = ("firmware.json", "refused.json", "uncertainty.json", "compensator.json")
"""Not of the firmware, so that the manifest does not name them: who reads one recomputes it, or
says that there is none, where it is gone or damaged."""
_OF_A_MODEL = ("firmware.json", "uncertainty.json")


def check_records(config: Config, model_hash: str) -> Iterator[ManifestFinding]:
    """Yield the records that are damaged, or of another model than the one in build/.

    Args:
        config: the project.
        model_hash: of the integer model; "" if that is not known.
    """
    for name in RECORDS:
        path = config.build_directory / name
        shown = f"{config.build_directory.name}/{name}"
        try:
            body = read_sealed(path.read_bytes())
        except FileNotFoundError:
            continue
        except (OSError, ValueError) as error:
            yield ManifestFinding(DAMAGED, shown, f"{shown}: is damaged ({error}).")
            continue
        if name in _OF_A_MODEL and model_hash and body.get("model_hash") != model_hash:
            theirs = str(body.get("model_hash"))[:12]
            text = f"{shown}: is of model {theirs}, not of {model_hash[:12]}."
            yield ManifestFinding(DAMAGED, shown, text)


# `verify`: compares the files of a project's firmware folder and of build/ with the model.

RANDOM_STEPS = 20_000
COLD_STEPS = 200
"""Of the golden vectors, after init rather than settle."""
BEYOND = ("cortex-m55",)
"""Cores whose kernel runs lane by lane on the host only: nothing installed here emulates them."""
AGAIN = "Run `zerodrift firmware` again."
LACKING = (
    "What was checked agrees. Install what is missing (`zerodrift doctor` names it), or leave it"
    " out of --require."
)
GOLDEN, ONNX = "golden.npz", "integer.onnx"
NOT_RUN = NotChecked(
    HOST,
    "files are not as the manifest says, so nothing was built or run; `zerodrift verify --trust`"
    " does so all the same",
)
MADE_AGAIN = NotChecked(
    f"{GOLDEN}, {ONNX}",
    "`fleet` keeps neither of a unit; both were made again from its model.json",
)


class Consent(Protocol):
    """Whether C that lies in a folder may be built and run: it can do anything."""

    despite_changes: bool
    """Build and run files although they differ from the manifest."""

    def require(self, texts: Mapping[str, str]) -> None:
        """Return if C may be run that this version of zerodrift does not write for the model.

        Args:
            texts: name -> content, of the model's header and source and of the runtime.

        Raises:
            InputError: it may not.
        """


@dataclass(frozen=True)
class Replay:
    """What was checked, what was found, and what could not be checked."""

    vectors: int
    """Steps compared on the host."""
    backends: tuple[str, ...]
    """What ran and agreed, the reference first."""
    model_hash: str
    failures: tuple[str, ...]
    """Back ends that differ, do not compile or do not run."""
    header: tuple[HeaderFinding, ...]
    """Names in the header whose values are not the model's."""
    findings: tuple[ManifestFinding, ...]
    """What is not as the manifest says."""
    forced: tuple[str, ...]
    """What had been found against this firmware when it was built, and was overridden."""
    not_checked: tuple[NotChecked, ...]
    certificate: FolderCertificate = NO_CERTIFICATE
    """Result of the check of the bounds that the firmware claims."""

    @property
    def bit_exact(self) -> bool:
        """Whether everything that ran gave the reference's bits, and something of the C did."""
        return not self.failures and bool({*self.backends} - {"reference", "onnx"})

    @property
    def problems(self) -> tuple[str, ...]:
        """Everything that was found, a line each."""
        header = (f"header: {finding}" for finding in self.header)
        claims = self.certificate.failures
        return (*(f.text for f in self.findings), *header, *self.failures, *claims)

    def summarise(self) -> VerifySummary:
        """Return what the command prints as JSON."""
        return VerifySummary(
            bit_exact=self.bit_exact,
            vectors=self.vectors,
            backends=self.backends,
            model_hash=self.model_hash,
            failures=self.failures,
            header=self.header,
            changed=tuple(f for f in self.findings if not f.is_stale),
            stale=tuple(f for f in self.findings if f.is_stale),
            forced=self.forced,
            not_checked=self.not_checked,
            claims=self.certificate.holds,
            refuted=self.certificate.failures,
        )

    def require(self, wanted: Iterable[str] = ()) -> "Replay":
        """Return self.

        Args:
            wanted: back ends, cores or `manifest` that must have been checked.

        Raises:
            CheckError: something was found, or is wanted and was not checked.
        """
        missing = [
            f"{name}: is required and was not checked ({self._why(name)})"
            for name in wanted
            if name not in self._checked()
        ]
        lines = [*self.problems, *missing]
        if not lines:
            return self
        if not self.problems:
            raise CheckError("\n  ".join(["required, and not checked:", *missing]) + f"\n{LACKING}")
        stopped = NOT_RUN in self.not_checked
        if any(f.is_stale for f in self.findings) and len(lines) == len(self.findings):
            head = "the firmware is stale"
        elif self.failures and not stopped:
            head = "bits differ"
        elif self.certificate.failures:
            head = "the certificate does not follow from the C"
        else:
            head = "the firmware is not what was built"
        remedy = f"{AGAIN} Here {NOT_RUN.why}." if stopped else AGAIN
        raise CheckError("\n  ".join([f"{head}:", *lines]) + f"\n{remedy}")

    def _checked(self) -> set[str]:
        sanitized = {SANITIZER} if HOST in self.backends else set()
        missing = {n.what for n in self.not_checked}
        derived = {CERTIFICATE} if self.certificate.holds else set()
        return {*self.backends, *({"manifest", *sanitized, *derived} - missing)}

    def _why(self, name: str) -> str:
        found = [n.why for n in self.not_checked if n.what == name]
        if not found and name in BEYOND:
            return "no emulator of it is used here"
        return found[0] if found else "it did not get that far"


def replay(
    config: Config,
    progress: Progress = lambda _: None,
    required: Iterable[str] = (),
    *,
    consent: Consent,
) -> Replay:
    """Check everything that a project has built, as the files are now.

    Where a file is not as the manifest says, nothing is built or run, and the lines are told in
    which the C differs from what is generated.

    Args:
        config: the project.
        progress: is told what is being done.
        required: names that the caller will ask for; unknown ones are refused here.
        consent: whether the C may be built and run.

    Raises:
        InputError: nothing was built yet, a file is damaged or belongs to another model, a
            required name is unknown, or the C may not be run.
    """
    refuse_unknown(required)
    progress("comparing the files with the manifest")
    files = check_manifest(config)
    try:
        model, golden, code, onnx = _read(config)
    except (InputError, CheckError) as error:
        if not files.findings and files.manifest is None:  # nothing was built, or long ago
            raise
        return _conclude(files, FolderCheck(backends=[]), "", (str(error),))
    fresh = generate_again(model, code)
    if any(not f.is_stale for f in files.findings) and not consent.despite_changes:
        files = replace(files, not_checked=(*files.not_checked, NOT_RUN))
        return _conclude(files, FolderCheck(backends=[]), model.hash, compare_texts(code, fresh))
    if not is_generated(code, fresh):
        consent.require(render_sources(code))
    progress("running the reference over the golden vectors")
    expected, failure = check_golden(model, golden)
    if failure is not None:
        return _conclude(files, FolderCheck(), model.hash, (str(failure),))
    cold = expect(model, golden.codes[:COLD_STEPS], settled=False)
    starts = [expect(model, codes) for codes in draw_starts(model)]
    sequences = draw_sequences(model, RANDOM_STEPS)
    with make_scratch(config.directory) as scratch:
        vectors = (expected, cold, *starts)
        check = check_folder(model, code, vectors, sequences, onnx, scratch, progress)
    records = check_records(config, model.hash)
    files = replace(files, findings=(*files.findings, *records))
    if is_lean(config):
        files = replace(files, not_checked=(*files.not_checked, MADE_AGAIN))
    progress("deriving the certificate's bounds again from the C")
    certificate = check_folder_certificate(config.firmware_out, code.runtime or {})
    return _conclude(files, check, model.hash, (), certificate)


def refuse_unknown(required: Iterable[str]) -> None:
    """Refuse names that can never be checked.

    Raises:
        InputError: which, and the nearest known one.
    """
    from zerodrift.c_runtime.cores import list_emulated

    known = ["manifest", HOST, SANITIZER, CERTIFICATE, "onnx", *list_emulated(), *BEYOND]
    for name in required:
        if name not in known:
            raise InputError(
                f"--require {name}: is unknown{nearest(name, known)}; known are {', '.join(known)}"
            )


def _conclude(
    files: ManifestCheck,
    check: FolderCheck,
    model_hash: str,
    more: Sequence[str] = (),
    certificate: FolderCertificate = NO_CERTIFICATE,
) -> Replay:
    beyond = [
        NotChecked(
            core,
            "no emulator of its vector extension is used here; its kernel ran lane"
            " by lane on the host",
        )
        for core in BEYOND
        if any("rows" in b for b in check.backends)
    ]
    return Replay(
        vectors=check.vectors,
        backends=tuple(check.backends),
        model_hash=model_hash,
        failures=(*more, *check.failures),
        header=tuple(check.header),
        findings=files.findings,
        forced=files.manifest.forced if files.manifest else (),
        not_checked=(*files.not_checked, *check.not_checked, *beyond, *certificate.not_checked),
        certificate=certificate,
    )


def _read(config: Config) -> tuple[IntegerModel, GoldenVectors, GeneratedCode, bytes]:
    """Return model, golden vectors, C and ONNX as they lie there."""
    model = load_model(config.build_directory / "model.json")
    if is_lean(config):
        drawn = np.concatenate(list(draw_sequences(model, RANDOM_STEPS).values()))
        golden = compute_golden(model, draw_golden(model, drawn))
        return model, golden, read_code(model, config.firmware_out), build_integer_onnx(model)
    path = config.build_directory / GOLDEN
    golden = load_golden(path)
    if golden.model_hash != model.hash:
        raise InputError(
            f"{path}: belongs to model {golden.model_hash[:12]}, model.json is {model.hash[:12]}."
            f" {AGAIN}"
        )
    widths = golden.codes.shape[1], golden.drift.shape[1]
    if widths != (model.columns, len(model.outputs)):
        raise InputError(
            f"{path}: has {widths[0]} inputs and {widths[1]} outputs, model.json has"
            f" {model.columns} and {len(model.outputs)}. {AGAIN}"
        )
    return (
        model,
        golden,
        read_code(model, config.firmware_out),
        _read_bytes(config.build_directory / ONNX),
    )


def is_lean(config: Config) -> bool:
    """Return whether this is a unit of a fleet as `fleet` leaves it: C and model.json alone."""
    build = config.build_directory
    return config.unit_build is not None and not any((build / n).exists() for n in (GOLDEN, ONNX))


def check_golden(model: IntegerModel, golden: GoldenVectors) -> tuple[Expected, Failure | None]:
    """Return what the reference computes for the golden codes, and where the vectors differ."""
    expected = expect(model, golden.codes)
    labels = [f"drift[{k}]" for k in range(len(model.outputs))] + ["flags"]
    labels += [f"gru[{j}]" for j in range(golden.hidden.shape[1])]
    written = np.column_stack([golden.drift, golden.flags.astype(np.int64), golden.hidden])
    found = np.column_stack([expected.drift, expected.flags.astype(np.int64), expected.hidden])
    if written.shape != found.shape:
        raise InputError(f"golden.npz has {golden.hidden.shape[1]} states; {found.shape}. {AGAIN}")
    mismatch = find_mismatch(model, written.astype(np.int64), found.astype(np.int64), labels)
    return expected, None if mismatch is None else Failure("reference", "golden", mismatch)


def read_code(model: IntegerModel, folder: Path) -> GeneratedCode:
    """Return the C and the runtime that lie in `folder`, with the harness that the model needs.

    Units of a fleet share a runtime, which lies beside their folders.

    Raises:
        InputError: the model's header or source is missing, or a file is no UTF-8 text.
    """
    fresh = _generate(model, folder)
    own = sorted(folder.glob("zd_*.[ch]")) or sorted(
        (folder.parent / SHARED_RUNTIME).glob("zd_*.[ch]")
    )
    paths = [*own, folder / fresh.header_name, folder / fresh.source_name]
    texts = {path.name: _read_text(path) for path in paths}
    header, source = texts.pop(fresh.header_name), texts.pop(fresh.source_name)
    return replace(fresh, header=header, source=source, runtime=texts)


def _generate(model: IntegerModel, folder: Path) -> GeneratedCode:
    """Return the C of a model, or of the design and block in a folder that has them.

    Raises:
        InputError: design or block is damaged, or the block is not the model's.
    """
    if not (folder / DESIGN).is_file():
        return generate(model)
    design, path = load_design(folder / DESIGN), folder / f"{BLOCK}.bin"
    content = read_block_file(path, design)
    if apply(design, decode(design, content, str(path))).hash != model.hash:
        raise InputError(
            f"{path}: its numbers are not those of model.json ({model.hash[:12]}). {AGAIN}"
        )
    return generate_design(design, content)


def _read_text(path: Path) -> str:
    try:
        return _read_bytes(path).decode("utf-8")
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: is no UTF-8 text ({error.reason}). {AGAIN}") from error


def _read_bytes(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}). {AGAIN}") from error
