"""Stores float parameters and hashes of what they become; only for a change meant to change bits.

python -m tests.frozen.store            hashes again, from the stored parameters
python -m tests.frozen.store --fit      fits the parameters again too
"""

import json
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from tests.frozen.projects import (
    EXPECTED,
    NAMES,
    STORED,
    Digests,
    digest,
    render_texts,
    write_project,
)

KEPT = ("compensator.json", "network.onnx")


def fit(name: str, folder: Path) -> None:
    """Train a project and keep its parameters."""
    subprocess.run([sys.executable, "-m", "zerodrift", "train", "-C", str(folder)], check=True)
    place = STORED / name
    place.mkdir(parents=True, exist_ok=True)
    for file in KEPT:
        if (folder / "build" / file).is_file():
            shutil.copy(folder / "build" / file, place)


def main() -> None:
    """Write the stored files."""
    found: Digests = {}
    for name in NAMES:
        with tempfile.TemporaryDirectory() as scratch:
            folder = write_project(name, Path(scratch) / name)
            if "--fit" in sys.argv and name != "imported":
                fit(name, folder)
            found[name] = {part: digest(text) for part, text in render_texts(name, folder).items()}
    EXPECTED.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
