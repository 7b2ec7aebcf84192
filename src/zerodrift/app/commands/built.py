"""What `firmware` and `diagnose` left in build/, where it still is of this project."""

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from zerodrift.base.config import Config
from zerodrift.base.records import from_json
from zerodrift.base.sealed import read_sealed
from zerodrift.verify.summary import (
    REFUSED,
    CertificateSummary,
    CertifiedBound,
    FirmwareSummary,
    Refusal,
)

FIRMWARE, CERTIFICATE = "firmware.json", "certificate.json"
TIGHTEST = 8
AGAIN = "`zerodrift firmware` builds it again."


def read_kept(path: Path) -> dict[str, Any] | None:
    """Return what a file of build/ holds that carries its hash; None where it does not match."""
    try:
        return read_sealed(path.read_bytes())
    except (OSError, ValueError):
        return None


def _read_json(path: Path) -> dict[str, Any] | None:
    """Return what a file of build/ holds; None where it is missing or damaged."""
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return content if isinstance(content, dict) else None


def read_firmware(
    config: Config,
) -> tuple[FirmwareSummary | None, CertificateSummary | None, str]:
    """Return the last `firmware --json`, the certificate's summary, and what is to be said of them.

    Firmware that is not as its manifest says, files, logs and configuration alike, is not shown,
    and no certificate but its own. Where a later one was refused, that is said.
    """
    firmware, certificate, note = _read_written(config)
    refused = _tell_refusal(config, shown=firmware is not None)
    return firmware, certificate, " ".join(text for text in (refused, note) if text)


def _tell_refusal(config: Config, *, shown: bool) -> str:
    """Return what the gate said against the last firmware; "" where that was written."""
    kept = read_kept(config.build_directory / REFUSED)
    if kept is None:
        return ""
    try:
        refusal = from_json(Refusal, kept)
    except ValueError:
        return ""
    reasons = " ".join(statement.text for statement in refusal.refused)
    older = " What is shown here is the firmware before that one." if shown else ""
    return f"The last `zerodrift firmware` was refused and wrote nothing: {reasons}{older}"


def _read_written(
    config: Config,
) -> tuple[FirmwareSummary | None, CertificateSummary | None, str]:
    """Return what `read_firmware` does, of firmware that was written."""
    kept = read_kept(config.build_directory / FIRMWARE)
    if kept is None:
        return None, None, "No firmware was built yet: `zerodrift firmware` builds and checks it."
    from zerodrift.verify.manifest import check_manifest

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


def read_certificate(path: Path, model_hash: str) -> tuple[CertificateSummary | None, str]:
    """Return the summary of a model's certificate.json, or None and why it is not shown."""
    certificate = _read_json(path)
    if certificate is None:
        return None, (
            f"No bounds are shown: {path.name} is missing in build/, or damaged."
            " `zerodrift firmware` writes it again."
        )
    if certificate.get("model") != model_hash:
        return None, (
            f"No bounds are shown: {path.name} in build/ is of another model than model.json."
            " `zerodrift firmware` writes both again."
        )
    try:
        return summarise_certificate(certificate), ""
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        return None, (
            f"No bounds are shown: {path.name} in build/ is not built like a certificate"
            f" ({type(error).__name__}: {error}). `zerodrift firmware` writes it again."
        )


def summarise_certificate(certificate: Mapping[str, Any]) -> CertificateSummary:
    """Return how many bounds are claimed, and those that come closest to their limits."""
    bounds = []
    for bound in certificate["bounds"]:
        low, high, bits = (int(bound[key]) for key in ("low", "high", "bits"))
        headroom = float(bits - 1 - math.log2(max(-low, high + 1, 1)))
        bounds.append(CertifiedBound(str(bound["where"]), low, high, bits, headroom))
    bounds.sort(key=lambda bound: (bound.headroom_bits, bound.where))
    return CertificateSummary(certificate["model"], len(bounds), tuple(bounds[:TIGHTEST]))
