"""Checks the firmware of zerodrift from its files alone, with Python's standard library alone.

What stands here is what others import; the packages inside are the checkers' own.
"""

from zerodrift_proof.certificate.check import (
    CertificateOutcome,
    check_certificate,
    compare,
    judge_each,
)
from zerodrift_proof.certificate.claims import CertificateClaims, read_claims
from zerodrift_proof.known_runtime import is_known

__all__ = [
    "CertificateClaims",
    "CertificateOutcome",
    "check_certificate",
    "compare",
    "is_known",
    "judge_each",
    "read_claims",
]
