"""`zerodrift-proof FOLDER`: checks the firmware in a folder from its files alone.

Without an option both are done. Exit code 0: all of it holds; 1: something does not, or there is no
rule for it; 2: a file is missing or cannot be read.
"""

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path

from zerodrift_proof.certificate.check import CertificateOutcome, check_certificate
from zerodrift_proof.equality.build import OPEN, TESTED, ShownPart
from zerodrift_proof.equality.model import Model, read_model
from zerodrift_proof.equality.prove import is_proven, list_shown
from zerodrift_proof.equality.reader import SYSTEM
from zerodrift_proof.object.image import ProgramError

CERTIFICATE, DESIGN, MODEL = "certificate.json", "design.json", "model.json"
BUILD, SHARED_RUNTIME = "build", "runtime"
"""Folders beside the firmware's: of the model's file, and of the runtime that a fleet shares."""


class MissingError(Exception):
    """A file is missing, or is not what it is to be; says which and what to do."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command and return its exit code.

    Args:
        arguments: of the command line; None: those of the process.
    """
    given = _parse(arguments)
    try:
        return _run(given)
    except (MissingError, ProgramError) as error:
        sys.stderr.write(f"error: {error}\n")
    except OSError as refusal:
        sys.stderr.write(f"error: {refusal.filename}: cannot be read ({refusal.strerror}).\n")
    return 2


def _parse(arguments: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="zerodrift-proof",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("folder", type=Path, help="of the firmware")
    parser.add_argument(
        "--certificate",
        action="store_true",
        help="this alone: derive every bound of certificate.json again from the C",
    )
    parser.add_argument(
        "--prove",
        action="store_true",
        help="this alone: show for every input that the C is what the specification says of the"
        " model's file",
    )
    parser.add_argument(
        "--model",
        type=Path,
        metavar="FILE",
        help="the model's file; left out, model.json in the folder or in build/ beside it",
    )
    parser.add_argument(
        "--elf",
        type=Path,
        metavar="FILE",
        help="prove the kernels in assembly of this program too, as the linker wrote it",
    )
    parser.add_argument("--json", action="store_true", help="print JSON, an object for each check")
    return parser.parse_args(arguments)


def _run(given: argparse.Namespace) -> int:
    folder: Path = given.folder
    both = given.certificate == given.prove
    good = True
    if both or given.certificate:
        if not (folder / CERTIFICATE).is_file():
            raise MissingError(f"{folder / CERTIFICATE}: there is no certificate.")
        outcome = check_certificate(folder)
        _print_certificate(outcome, given.json)
        good = not outcome.failures
    if both or given.prove:
        model = load_model(path := find_model(folder, given.model))
        texts = read_texts(folder, model.c_prefix)
        try:
            shown = tuple(list_shown(model, texts, program=given.elf))
        except (ArithmeticError, AssertionError, LookupError, TypeError) as error:
            raise MissingError(f"{path}: its parts do not fit together ({error!r:.80}).") from error
        _print_proof(model, shown, given.json)
        good = is_proven(shown) and good
    return 0 if good else 1


def find_model(folder: Path, given: Path | None) -> Path:
    """Return the model's file.

    Raises:
        MissingError: there is none.
    """
    places = [folder / MODEL, folder.parent / BUILD / MODEL] if given is None else [given]
    found = next((path for path in places if path.is_file()), None)
    if found is None:
        raise MissingError(
            f"{' and '.join(map(str, places))}: there is no model. Name its file by --model."
        )
    return found


def load_model(path: Path) -> Model:
    """Read a model's file.

    Raises:
        MissingError: it is no model, or another one than its hash says.
    """
    try:
        return read_model(json.loads(path.read_text(encoding="utf-8")), str(path))
    except (ValueError, KeyError, IndexError, RecursionError) as error:
        raise MissingError(f"{path}: cannot be read as a model ({error}).") from error


def read_texts(folder: Path, prefix: str) -> dict[str, str]:
    """Return the C in a firmware folder: file name -> content, the runtime's too.

    A file that a compiler would take for one of C's own headers is among them, and refused.

    Raises:
        MissingError: the numbers lie in a block, or a file is no text.
    """
    if (folder / DESIGN).is_file():
        raise MissingError(
            f"{folder / DESIGN}: the numbers of this C lie in a block, which --prove does not read"
            " yet. --certificate shows that no block that the chip accepts overflows."
        )
    runtime = sorted(folder.glob("zd_*.[ch]"))
    runtime = runtime or sorted((folder.parent / SHARED_RUNTIME).glob("zd_*.[ch]"))
    paths = [*runtime, folder / f"{prefix}.h", folder / f"{prefix}.c"]
    try:
        texts = {path.name: path.read_bytes().decode() for path in paths}
    except UnicodeDecodeError as error:
        raise MissingError(f"{folder}: a file is no UTF-8 text ({error.reason}).") from error
    return texts | {name: "" for name in SYSTEM if (folder / name).exists()}


def _print_certificate(outcome: CertificateOutcome, as_json: bool) -> None:
    if as_json:
        told = {
            "schema": "verify-certificate/1",
            "certificate": "refused" if outcome.failures else "holds",
            "claims_that_hold": outcome.holds,
            "failures": list(outcome.failures),
        }
        sys.stdout.write(json.dumps(told, indent=2) + "\n")
        return
    lines = [f"NOT SHOWN: {text}" for text in outcome.failures]
    lines.append(f"certificate: {outcome.holds} claims hold, {len(outcome.failures)} do not")
    sys.stdout.write("\n".join([*lines, ""]))


def _print_proof(model: Model, shown: Sequence[ShownPart], as_json: bool) -> None:
    if as_json:
        told = {
            "schema": "verify-prove/1",
            "proven": is_proven(shown),
            "model_hash": model.hash,
            "parts": [vars(one) for one in shown],
        }
        sys.stdout.write(json.dumps(told, indent=2) + "\n")
        return
    words = {TESTED: "TESTED, NOT PROVEN", OPEN: "NOT PROVEN"}
    for one in shown:
        if one.verdict in words:
            what = f"{one.what} ({one.build})" if one.build else one.what
            why = f": {one.why}" if one.why else ""
            sys.stdout.write(f"{words[one.verdict]}: {what}{why}\n")
    counts = [sum(one.verdict == v for one in shown) for v in (TESTED, OPEN)]
    proven = len(shown) - sum(counts)
    sys.stdout.write(
        f"C and specification: {proven} parts proven, {counts[0]} tested, {counts[1]} not proven"
        f" (model {model.hash[:12]})\n"
    )
