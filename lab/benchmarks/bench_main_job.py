"""The main job after set-up: simulated logs of the example to host-checked C, training included."""

import json
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from zerodrift_lab.twin.example import ensure_example_logs

EXAMPLE = Path(__file__).parents[2] / "examples" / "ft40"


def copy_example(project: Path) -> None:
    """Write the bundled example and its simulated logs into a folder."""
    project.mkdir()
    for name in ("zerodrift.toml", "twin.json"):
        shutil.copy(EXAMPLE / name, project / name)
    ensure_example_logs(project)


def main(quick: bool) -> None:
    """Print the whole-process time of `zerodrift firmware` on a fresh copy of examples/ft40.

    The target is 90 s on two cores. `quick` changes nothing: this is what a user waits for.
    """
    del quick
    with tempfile.TemporaryDirectory() as scratch:
        project = Path(scratch) / "ft40"
        copy_example(project)
        start = time.perf_counter()
        command = [sys.executable, "-m", "zerodrift", "firmware", "-C", str(project), "--json"]
        done = subprocess.run(command, check=True, capture_output=True, text=True)
        seconds = time.perf_counter() - start
    result = json.loads(done.stdout)
    print(f"make firmware-model on examples/ft40 (simulated): {seconds:.1f} s (target 90 s)")
    print(f"bit-exact {result['bit_exact']}, {result['vectors']} steps compared")
    print(
        f"flash {result['flash_bytes']} B, RAM {result['ram_bytes']} B,"
        f" stack {result['stack_bytes']} B on {result['core']}"
    )
    for name, unit in result["units"].items():
        rmse = {key: result["rmse"][key][name] for key in ("uncompensated", "float", "integer")}
        text = ", ".join(f"{key} {value:.4g}" for key, value in rmse.items())
        print(f"  {name} [{unit}] held-out RMSE: {text}")


if __name__ == "__main__":
    main(False)
