"""What reads a user's files, fed with any bytes: a result, or one message; nothing else gets out.

`TARGETS` are plain functions of bytes; `python -m tests.fuzz` runs them under atheris, and
test_corpus.py replays what it kept without it.
"""

import copy
import hashlib
import json
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from zerodrift.base.config import load_config, parse_config
from zerodrift.base.errors import ZerodriftError
from zerodrift.codegen.generate import generate
from zerodrift.dataset.load import load_dataset
from zerodrift.export.integer_model import canonical_json
from zerodrift.export.model_files import load_model
from zerodrift.export.onnx_reader import read_imported
from zerodrift.export.reference import Reference
from zerodrift.verify.vectors import draw_sequences

GOLDEN = Path(__file__).parent.parent / "golden"
STEPS = 50
LOG_TOML = """\
[sensor]
name = "s"
time = "t"
temperature = "T"
sample_period_s = 1.0
[outputs.y]
measured = "y"
reference = "r"
unit = "N"
full_scale = 1
[inputs]
supply = "v"
[logs]
train = ["log.csv"]
"""
VALUES: tuple[Any, ...] = (
    None, True, "", "drift", -1, 0, 1, 2, 31, 32, 2**15, -(2**31), 2**31, 2**62, 2**63, 1e308, 0.5,
    [], {}, [[]], 10**30,
)  # fmt: skip
"""What stands in for a value somewhere in a model file."""


class Draws:
    """Numbers out of the fuzzer's bytes; zeros once they are used up."""

    def __init__(self, data: bytes) -> None:
        self._data, self._at = data, 0

    @property
    def is_empty(self) -> bool:
        """Whether the bytes are used up."""
        return self._at >= len(self._data)

    def below(self, limit: int) -> int:
        """Return a number from 0 up to, not including, `limit`."""
        wanted = 1 if limit <= 256 else 2
        part = self._data[self._at : self._at + wanted]
        self._at += wanted
        return int.from_bytes(part, "little") % limit


def read_model(data: bytes) -> None:
    """Load a model file; what is loaded can be computed and generated.

    The first byte chooses: the rest is the file, or it edits a golden model, whose hash is then set
    right, for a wrong hash is refused before anything else is looked at.
    """
    text = edit_model(data[1:]) if data[:1] > b"\x7f" else data[1:]
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "model.json"
        path.write_bytes(text)
        model = load_model(path)
    generate(model)
    Reference(model).run(draw_sequences(model, STEPS)["noise"][None], settled=False)


def edit_model(data: bytes) -> bytes:
    """Return a golden model with values replaced, removed or repeated as the bytes say."""
    draws = Draws(data)
    names = sorted(GOLDEN.glob("*.model.json"))
    body = json.loads(names[draws.below(len(names))].read_text(encoding="utf-8"))
    while not draws.is_empty:
        edit_one(body, draws)
    body.pop("hash", None)
    hashed = canonical_json({key: body[key] for key in body if key != "notes"})
    body["hash"] = hashlib.sha256(hashed.encode()).hexdigest()
    return canonical_json(body).encode()


def edit_one(body: Any, draws: Draws) -> None:
    """Change one place of nested lists and dicts; takes some of the bytes in any case."""
    draws.below(256)
    for _ in range(12):
        if not isinstance(body, list | dict) or not body:
            return
        key = list(body)[draws.below(len(body))] if isinstance(body, dict) else None
        place: Any = draws.below(len(body)) if key is None else key
        what = draws.below(8)
        if what < 5 and isinstance(body[place], list | dict) and body[place]:
            body = body[place]
        elif what == 5:
            del body[place]
            return
        elif what == 6 and isinstance(body, list):
            body.append(copy.deepcopy(body[place]))
            return
        elif what == 7 and type(body[place]) is int:
            body[place] += draws.below(65536) - 32768
            return
        else:
            body[place] = copy.deepcopy(VALUES[draws.below(len(VALUES))])
            return


def read_onnx(data: bytes) -> None:
    """Read a network."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "net.onnx"
        path.write_bytes(data)
        read_imported(path)


def read_config(data: bytes) -> None:
    """Read a zerodrift.toml."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "zerodrift.toml"
        path.write_bytes(data)
        load_config(path)


def read_csv(data: bytes) -> None:
    """Read a log; the first byte chooses whether invalid rows are dropped."""
    with tempfile.TemporaryDirectory() as folder:
        directory = Path(folder)
        (directory / "log.csv").write_bytes(data[1:])
        config = parse_config(LOG_TOML, directory / "zerodrift.toml")
        dataset = load_dataset(config, skip_invalid=data[:1] > b"\x7f")
    for run in dataset.train:
        assert np.isfinite(run.measured).all() and np.isfinite(run.temperature_degC).all()
        assert (np.diff(run.time_s) > 0).all()


TARGETS: dict[str, Callable[[bytes], None]] = {
    "model": read_model,
    "onnx": read_onnx,
    "config": read_config,
    "csv": read_csv,
}


def list_seeds(target: str) -> list[bytes]:
    """Return what the fuzzer starts from, beside its corpus: sound files."""
    root = GOLDEN.parents[1]
    if target == "model":
        whole = [b"\0" + path.read_bytes() for path in sorted(GOLDEN.glob("*.model.json"))]
        return [*whole, *(bytes([255, k, 8 * k, 9 * k, 2, 3 * k, 5 * k, k]) for k in range(13))]
    if target == "onnx":
        files = sorted((root / "tests/onnx/exported").glob("*.onnx"))
        return [path.read_bytes() for path in files if not path.with_suffix(".onnx.data").exists()]
    if target == "config":
        return [path.read_bytes() for path in root.glob("examples/*/zerodrift.toml")]
    rows = "".join(f"{t},{20 + t / 10:.2f},{t % 3},0,3.3\n" for t in range(14))
    return [mode + b"t,T,y,r,v\n" + rows.encode() for mode in (b"\0", b"\xff")]


def run_one(target: str, data: bytes) -> bool:
    """Run a target; return whether its bytes were read, False if refused with a message."""
    try:
        TARGETS[target](data)
    except ZerodriftError as error:
        assert str(error).strip()
        return False
    return True
