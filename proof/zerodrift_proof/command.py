"""`zerodrift-proof FOLDER`: checks a firmware folder from its files alone."""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from zerodrift_proof.certificate.check import check_certificate


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; return its exit code: 0 all holds, 1 something does not, 2 unreadable.

    Args:
        arguments: of the command line; None: those of the process.
    """
    parser = argparse.ArgumentParser(prog="zerodrift-proof", description=__doc__)
    parser.add_argument("folder", type=Path, help="of the firmware: certificate.json and its C")
    try:
        outcome = check_certificate(parser.parse_args(arguments).folder)
    except OSError as refusal:
        sys.stderr.write(f"error: {refusal.filename}: cannot be read ({refusal.strerror}).\n")
        return 2
    sys.stdout.write("\n".join([*outcome.failures, f"{outcome.holds} claims hold", ""]))
    return 1 if outcome.failures else 0
