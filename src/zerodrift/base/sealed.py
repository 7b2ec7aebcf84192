"""JSON files that carry a hash of themselves: what does not match is damaged or was edited."""

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass

from zerodrift.base.records import Json, from_json

SEAL = "sha256"


def render_sealed(body: Mapping[str, object]) -> bytes:
    """Return the file of a JSON object, its hash last; the same object gives the same bytes.

    Raises:
        ValueError: a number is NaN or infinite.
    """
    whole = {**body, SEAL: _hash(body)}
    return (json.dumps(whole, indent=1, ensure_ascii=False, allow_nan=False) + "\n").encode()


@dataclass(frozen=True)
class _Mark:
    """The key `format` of a file."""

    format: int | str | None = None


def read_format(content: bytes) -> int | str | None:
    """Return the format that a JSON file names; None where it names none.

    Raises:
        ValueError: it is no JSON object.
    """
    return from_json(_Mark, json.loads(content)).format


def read_sealed(content: bytes) -> dict[str, Json]:
    """Return the object of a sealed file, without its hash.

    Raises:
        ValueError: it is no JSON object, has no hash, or the hash does not match.
    """
    try:
        body = json.loads(content)
    except RecursionError as error:
        raise ValueError("nested too deep") from error
    if not isinstance(body, dict) or SEAL not in body:
        raise ValueError("it carries no hash of itself")
    if body.pop(SEAL) != _hash(body):
        raise ValueError("its hash is not its own: it was edited or damaged")
    return body


def _hash(body: Mapping[str, object]) -> str:
    text = json.dumps(body, sort_keys=True, ensure_ascii=False)
    return hashlib.sha256(text.encode("utf-8", "surrogatepass")).hexdigest()
