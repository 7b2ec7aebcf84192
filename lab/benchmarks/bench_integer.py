"""Held-out errors of the *integer* model on real measurements, beside simple fits on the same logs.

The measurements are third-party data that are not part of the repository (see the header of each
example's zerodrift.toml for their source and licence); without them this benchmark says so.
"""

import json
import re
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from zerodrift.base.arrays import Array
from zerodrift.base.config import load_config
from zerodrift.dataset.load import load_dataset
from zerodrift.dataset.runs import Run

EXAMPLES = Path(__file__).parents[2] / "examples"
MARKS = {
    "real_resistor": "target 2.5 ppm; marks to beat: linear 4.71, cubic + lag 2.53",
    "real_loadcell": "target 11.4 g (linear + lag), mean bias removed; linear 16.2 g",
}


def main(quick: bool) -> None:
    """Run `zerodrift firmware` on each real example and print its held-out errors."""
    del quick
    for name, mark in MARKS.items():
        directory = EXAMPLES / name
        try:
            dataset = load_dataset(load_config(directory))
        except Exception as error:
            if "shared/data" not in str(error):
                raise
            print(f"{name}: skipped, its measurements are not here ({error})")
            continue
        result = build_firmware(directory)
        runs = ", ".join(result["runs"])
        print(f"{name} ({mark}); held out: {runs}; bit-exact {result['bit_exact']}")
        for output, unit in result["units"].items():
            integer, bias = result["rmse"]["integer"][output], result["bias"][output]
            scatter = float(np.sqrt(max(integer**2 - bias**2, 0.0)))
            k = dataset.outputs.index(output)
            for degree, label in ((1, "linear"), (3, "cubic")):
                rmse, plain = fit_polynomial(dataset.train, dataset.test, k, degree)
                print(f"  {label:>8}: RMSE {rmse:.4g} {unit}, mean bias removed {plain:.4g} {unit}")
            floats = result["rmse"]["float"][output]
            print(f"  {'float':>8}: RMSE {floats:.4g} {unit}")
            text = f"RMSE {integer:.4g} {unit}, mean bias removed {scatter:.4g} {unit}"
            print(f"  {'integer':>8}: {text}")
        print_lag_bank(directory)


def build_firmware(directory: Path) -> dict[str, Any]:
    """Return what `zerodrift firmware --json` prints of a project."""
    command = [sys.executable, "-m", "zerodrift", "firmware", "-C", str(directory), "--json"]
    done = subprocess.run(command, check=True, capture_output=True, text=True)
    found: dict[str, Any] = json.loads(done.stdout)
    return found


def print_lag_bank(directory: Path) -> None:
    """Print the errors of the same project with the network that `zerodrift init` writes."""
    config = load_config(directory)
    with tempfile.TemporaryDirectory() as folder:
        text = config.path.read_text(encoding="utf-8")
        for selector in (*config.train_logs, *config.test_logs):
            text = text.replace(f'"{selector}"', f'"{(directory / selector).resolve()}"')
        head, tail = re.split(r"^\[network\].*$", text, maxsplit=1, flags=re.MULTILINE)
        tail = tail[tail.index("[") :]
        place = Path(folder) / config.path.name
        place.write_text(f'{head}[network]\nkind = "lag_bank"\n\n{tail}', encoding="utf-8")
        result = build_firmware(Path(folder))
    for output, unit in result["units"].items():
        integer, bias = result["rmse"]["integer"][output], result["bias"][output]
        scatter = float(np.sqrt(max(integer**2 - bias**2, 0.0)))
        print(f"  lag bank, integer: RMSE {integer:.4g}, mean bias removed {scatter:.4g} {unit}")


def fit_polynomial(
    train: tuple[Run, ...], test: tuple[Run, ...], output: int, degree: int
) -> tuple[float, float]:
    """Return RMSE and scatter on `test` of a polynomial in temperature fitted to `train`."""
    temperature, drift = _join(train, output)
    coefficients = np.polynomial.Polynomial.fit(temperature, drift, degree)
    temperature, drift = _join(test, output)
    residual = drift - coefficients(temperature)
    return float(np.sqrt(np.mean(residual**2))), float(np.std(residual))


def _join(runs: tuple[Run, ...], output: int) -> tuple[Array, Array]:
    temperature = np.concatenate([run.temperature_degC for run in runs])
    return temperature, np.concatenate([run.drift[:, output] for run in runs])


if __name__ == "__main__":
    main(False)
