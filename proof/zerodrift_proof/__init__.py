"""Checks the firmware of zerodrift from its files alone, with Python's standard library alone.

What stands here is what others import; the packages inside are the checkers' own.
"""

from zerodrift_proof.certificate.check import (
    CertificateClaims,
    CertificateOutcome,
    check_certificate,
    compare,
    judge_each,
    read_claims,
)
from zerodrift_proof.equality.build import OPEN, PROVEN, TESTED, ShownPart
from zerodrift_proof.equality.model import Model, read_model
from zerodrift_proof.equality.prove import is_proven, list_shown
from zerodrift_proof.equality.reader import SYSTEM
from zerodrift_proof.known_runtime import is_known
from zerodrift_proof.object.image import ProgramError
from zerodrift_proof.object.program import BuildError, NoCompilerError, ObjectBuild

__all__ = [
    "OPEN",
    "PROVEN",
    "SYSTEM",
    "TESTED",
    "BuildError",
    "CertificateClaims",
    "CertificateOutcome",
    "Model",
    "NoCompilerError",
    "ObjectBuild",
    "ProgramError",
    "ShownPart",
    "check_certificate",
    "compare",
    "is_known",
    "is_proven",
    "judge_each",
    "list_shown",
    "read_claims",
    "read_model",
]
