"""Results of `firmware` and `diagnose` in build/, where they still belong to this project."""

import json
import math
from pathlib import Path
from typing import TYPE_CHECKING

from zerodrift.base.config import Config
from zerodrift.base.files import NOT_THERE
from zerodrift.base.records import Json, from_json, read_sealed
from zerodrift.verify.manifest import check_manifest
from zerodrift.verify.summary import (
    REFUSED,
    CertificateSummary,
    CertifiedBound,
    FirmwareSummary,
    Refusal,
    StatedUncertainty,
)
from zerodrift.verify.uncertainty import FILE_NAME, Uncertainty

if TYPE_CHECKING:
    from zerodrift.verify.checkers import CertificateClaims

FIRMWARE, CERTIFICATE = "firmware.json", "certificate.json"
TIGHTEST = 8
AGAIN = "`zerodrift firmware` builds it again."


def read_kept(path: Path) -> dict[str, Json] | None:
    """Return the content of a file of build/ that carries its hash; None where that does not match.

    Raises:
        OSError: it exists and cannot be read.
    """
    try:
        return read_sealed(path.read_bytes())
    except (*NOT_THERE, ValueError):
        return None


def read_firmware(
    config: Config,
) -> tuple[FirmwareSummary | None, CertificateSummary | None, str]:
    """Return the last `firmware --json`, the certificate's summary, and a note on them.

    Firmware whose files, logs or configuration differ from its manifest is not shown, nor is a
    certificate of another model. A later firmware that was refused is mentioned in the note.
    """
    firmware, certificate, note = _read_written(config)
    refused = _tell_refusal(config, shown=firmware is not None)
    return firmware, certificate, " ".join(text for text in (refused, note) if text)


def _tell_refusal(config: Config, *, shown: bool) -> str:
    """Return why the gate refused the last firmware; "" where it was written."""
    kept = read_kept(config.build_directory / REFUSED)
    if kept is None:
        return ""
    try:
        refusal = from_json(Refusal, kept)
    except ValueError:
        return ""
    reasons = " ".join(f"{statement.text.rstrip('.')}." for statement in refusal.refused)
    older = " What is shown here is the firmware before that one." if shown else ""
    return f"The last `zerodrift firmware` was refused and wrote nothing: {reasons}{older}"


def _read_written(
    config: Config,
) -> tuple[FirmwareSummary | None, CertificateSummary | None, str]:
    """Return what `read_firmware` returns, for firmware that was written."""
    kept = read_kept(config.build_directory / FIRMWARE)
    if kept is None:
        return None, None, "No firmware was built yet: `zerodrift firmware` builds and checks it."
    check = check_manifest(config)
    if check.manifest is None or check.findings:
        reasons = [f.text for f in check.findings] or [n.why for n in check.not_checked]
        return None, None, f"The firmware cannot be shown: {' '.join(reasons)} {AGAIN}"
    try:
        firmware = from_json(FirmwareSummary, kept)
        is_current = check.manifest.model_hash == firmware.model_hash
    except ValueError:
        is_current = False
    if not is_current:
        why = f"{FIRMWARE} is of another model or of an earlier version."
        return None, None, f"The firmware cannot be shown: {why} {AGAIN}"
    certificate, note = read_certificate(
        config.build_directory / CERTIFICATE, check.manifest.model_hash
    )
    return firmware, certificate, note


def load_uncertainty(folder: Path, model_hash: str) -> Uncertainty | None:
    """Return the uncertainty of a model that lies in a folder; None without a sound one of it."""
    kept = read_kept(folder / FILE_NAME)
    if kept is None:
        return None
    try:
        found = from_json(Uncertainty, kept)
    except ValueError:
        return None
    return found if found.model_hash == model_hash else None


def read_uncertainty(config: Config, model_hash: str) -> tuple[Uncertainty | None, str]:
    """Return the uncertainty of a model, or None and why there is none.

    Every command states this one.

    Args:
        config: the project.
        model_hash: of the integer model.
    """
    path = config.build_directory / FILE_NAME
    found = load_uncertainty(config.build_directory, model_hash)
    if found is not None:
        return found, ""
    if path.exists():
        return None, (
            f"no uncertainty is stated: {path.name} in build/ is damaged, or of another model; "
            "`zerodrift firmware` writes it again"
        )
    return None, (
        "no uncertainty is stated: it comes from models that leave a training run out, which "
        "`zerodrift firmware` and `zerodrift fleet` fit unless --no-uncertainty is given; what was "
        "learnt beside the effects takes two training runs, and a network from an ONNX file cannot "
        "be trained again"
    )


def state_uncertainty(
    config: Config, firmware: FirmwareSummary | None
) -> dict[str, StatedUncertainty] | None:
    """Return the uncertainty of each output of a current firmware; None where none is known."""
    model_hash = _find_unit_hash(config) if firmware is None else firmware.model_hash
    if not model_hash:
        return None
    found, _ = read_uncertainty(config, model_hash)
    return None if found is None else found.state()


def _find_unit_hash(config: Config) -> str:
    """Return the hash of the current model of a unit that `fleet` built; "" without one.

    `fleet` keeps no firmware.json.
    """
    if config.unit_build is None:
        return ""
    check = check_manifest(config)
    return "" if check.manifest is None or check.findings else check.manifest.model_hash


def read_certificate(path: Path, model_hash: str) -> tuple[CertificateSummary | None, str]:
    """Return the summary of a model's certificate.json, or None and why it is not shown."""
    from zerodrift.verify.checkers import read_claims  # zerodrift-proof may be missing

    try:
        claims = read_claims(json.loads(path.read_text(encoding="utf-8")))
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        return None, (
            f"No bounds are shown: {path.name} is missing in build/, or damaged"
            f" ({type(error).__name__}: {error}). `zerodrift firmware` writes it again."
        )
    if claims.model != model_hash:
        return None, (
            f"No bounds are shown: {path.name} in build/ is of another model than model.json."
            " `zerodrift firmware` writes both again."
        )
    return summarise_certificate(claims), ""


def summarise_certificate(claims: "CertificateClaims") -> CertificateSummary:
    """Return how many bounds are claimed, and the bounds closest to their limits."""
    bounds = []
    for bound in claims.bounds:
        headroom = float(bound.bits - 1 - math.log2(max(-bound.low, bound.high + 1, 1)))
        bounds.append(CertifiedBound(bound.where, bound.low, bound.high, bound.bits, headroom))
    bounds.sort(key=lambda bound: (bound.headroom_bits, bound.where))
    return CertificateSummary(claims.model, len(bounds), tuple(bounds[:TIGHTEST]))
