"""What zerodrift takes of zerodrift-proof, the checkers that stand alone; nothing else imports it.

Importing this raises where that distribution is not installed, so it is imported where it is used.

Raises:
    InputError: zerodrift-proof is not installed; says how to install it.
"""

from zerodrift.base.errors import InputError

try:
    from zerodrift_proof import (
        OPEN,
        SYSTEM,
        TESTED,
        BuildError,
        CertificateClaims,
        CertificateOutcome,
        NoCompilerError,
        ObjectBuild,
        ProgramError,
        ShownPart,
        check_certificate,
        is_known,
        is_proven,
        list_shown,
        read_claims,
        read_model,
    )
except ModuleNotFoundError as error:
    if error.name != "zerodrift_proof":
        raise
    raise InputError(
        "the certificate and the proof are checked by zerodrift-proof, which is not installed."
        " Run in zerodrift's checkout: pip install ./proof"
    ) from error

__all__ = [
    "OPEN",
    "SYSTEM",
    "TESTED",
    "BuildError",
    "CertificateClaims",
    "CertificateOutcome",
    "NoCompilerError",
    "ObjectBuild",
    "ProgramError",
    "ShownPart",
    "check_certificate",
    "is_known",
    "is_proven",
    "list_shown",
    "read_claims",
    "read_model",
]
