"""Runs the commands on a project as its user would, and holds what they say against the truth."""

import json
import shutil
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

Row = dict[str, Any]
KINDS = {
    "effect": "one effect hidden",
    "pair": "two effects hidden",
    "complete": "complete model: an effect named",
    "disturbance": "not in the catalogue: an effect named",
    "missing_channel": "channel not logged: an effect named",
}
"""What a case can be, and what the table says of it."""
PROMISED = {
    "compare": "outputs runs worst effects",
    "diagnose": "verdict effect lookalikes candidates not_testable floor_ratio_after",
    "add": "effect parameters before after noise_floor",
}
"""Keys that the contract promises in the JSON of each command."""
FORMS = {"order", "own_terms", "time_constants", "power_law", "cross_axes", "plays", "ratiometric"}
"""Parameters that say which form of an effect `diagnose` means, as `effects NAME` lists them."""


def command(row: Row, project: Path, *words: str) -> Any:
    """Run `zerodrift WORDS --json` on a project; returns its object or None.

    Seconds, exit code and what departs from the contract are noted in the row.
    """
    start = time.perf_counter()
    line = [sys.executable, "-m", "zerodrift", *words, "-C", str(project), "--json"]
    done = subprocess.run(line, capture_output=True, text=True, timeout=900, check=False)
    name, notes = words[0], row.setdefault("complaints", [])
    row[f"{name}_s"], row[f"{name}_code"] = time.perf_counter() - start, done.returncode
    row[f"{name}_stderr"] = done.stderr[-1000:]
    notes += [f"{name}: {word}" for word in ("Traceback", "Warning") if word in done.stderr]
    try:
        told = json.loads(done.stdout)
    except ValueError:
        notes.append(f"{name}: exit code {done.returncode}, no JSON object: {done.stderr[-300:]}")
        return None
    notes += [f"{name}: no '{key}'" for key in PROMISED[name].split() if key not in told]
    return told


def examine(project: Path, truth: Row) -> Row:
    """Walk the loop on one case; returns the truth with what was said of it."""
    row: Row = {**truth, "project": str(project), "lookalikes": [], "candidates": []}
    command(row, project, "compare")
    told = command(row, project, "diagnose", *["--auto"] * (truth["kind"] == "pair"))
    row.update(told or {})
    if truth["kind"] != "effect" or not told:
        return row
    name, copy = truth["hidden"][0], project.parent / "added"
    shutil.copytree(project, copy, dirs_exist_ok=True)
    forms: Row = next((c["parameters"] for c in told["candidates"] if c["effect"] == name), {})
    held = [f"--hold={key}={value:.0f}" for key, value in forms.items() if key in FORMS]
    told = command(row, copy, "add", name, *held)
    if told:
        after, floor = told["after"]["rmse_heldout"], told["noise_floor"]
        row["after_floor"] = [after[key] / floor[key] for key in floor]
        pairs = zip(floor, truth["noise_rms"], strict=True)
        row["floor_true"], row["after_true"] = zip(
            *((floor[key] / sigma, after[key] / sigma) for key, sigma in pairs), strict=True
        )
        said = [(key, told["parameters"].get(key, {})) for key in truth["truth"].get(name, {})]
        row["intervals"] = [
            [key, truth["truth"][name][key], value["value"], value["std_error"]]
            for key, value in said
            if value.get("std_error")
        ]
    return row


def first(row: Row) -> bool:
    """Whether the hidden effect is the one that is named."""
    return row.get("verdict") == "missing" and row.get("effect") == row["hidden"][0]


def grouped(row: Row) -> bool:
    """Whether the hidden effect is named or among the look-alikes of what is named."""
    group = {row.get("effect"), *row["lookalikes"]}
    return row.get("verdict") == "missing" and row["hidden"][0] in group


def both(row: Row) -> bool:
    """Whether `diagnose --auto` added all that was hidden."""
    return set(row["hidden"]) <= {step["effect"] for step in row.get("added", [])}
