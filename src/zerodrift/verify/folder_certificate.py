"""The certificate of a firmware folder, derived again while `verify` is at it."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from zerodrift.verify.certificate import FILE_NAME
from zerodrift.verify.manifest import NotChecked

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
