"""A case as its user would hold it: zerodrift.toml and CSV logs; the truth lies beside it."""

import json
from pathlib import Path

import numpy as np

from benchmarks.foreign import effects as fx
from benchmarks.foreign.case import LSB_DEGC, Case
from benchmarks.foreign.world import Array, Run

COLUMNS = {
    "supply": "U_batt [V]",
    "humidity": "rF_pct",
    "ambient_light": "E_v",
    "acceleration_x": "a.x",
    "acceleration_y": "a.y",
    "acceleration_z": "a.z",
    "clock": "uptime",
}


def write(case: Case, home: Path) -> Path:
    """Write the project below `home`, and `truth.json` into `home`; returns the project."""
    rng = np.random.default_rng([case.recipe.seed, 77])
    project = home / "project"
    (project / "rec").mkdir(parents=True, exist_ok=True)
    needed = {fx.CHANNEL_OF[name] for name in case.truth if name in fx.CHANNEL_OF}
    missing = needed if case.recipe.kind == "missing_channel" else set()
    logged = [n for n in COLUMNS if n not in missing and (n in needed or rng.uniform() < 0.3)]
    logged = [n for n in logged if n[:-1] != "acceleration_" or "acceleration_x" in needed]
    if "acceleration_x" in logged:
        logged = list(dict.fromkeys([*logged, "acceleration_y", "acceleration_z"]))
    separator = str(rng.choice([",", ";", "\t"]))
    together, dwell_logged = rng.uniform() < 0.3, bool(rng.uniform() < 0.7)
    start_s = float(rng.choice([0, 0, 17.3, 4096]))
    tables = {
        run.name: _table(run, values, case, logged, start_s)
        for run, values in zip(case.runs, case.measured, strict=True)
    }
    rest = tables.pop("rest")
    if dwell_logged:
        _csv(project / "rest.csv", {"rest": rest}, separator)
    if together:
        _csv(project / "rec" / "all.csv", tables, separator)
    else:
        for name, table in tables.items():
            _csv(project / "rec" / f"{name}.log.csv", {name: table}, separator)
    files = [f"rec/all.csv#{name}" if together else f"rec/{name}.log.csv" for name in tables]
    split = 2 * (len(files) >= 10 and rng.uniform() < 0.4 and "adc_saturation" not in case.truth)
    train, test = files[: len(files) - split], files[len(files) - split :]
    lines = [
        "[sensor]", 'name = "Prüfling 7"', 'time = "zeit"', 'temperature = "T_pcb"',
        f"sample_period_s = {case.period_s}", "",
    ]  # fmt: skip
    for k, unit in enumerate(case.units):
        lines += [f"[outputs.q{k}]", f'measured = "roh{k}"', f'unit = "{unit}"']
        lines += [f'reference = "soll{k}"'] if f"soll{k}" in rest else []
        lines += [f"full_scale = {case.full_scale[k]:.6g}", ""]
    lines += ["[inputs]"] + [f'{name} = "{COLUMNS[name]}"' for name in logged]
    lines += ["", "[logs]", f"train = {json.dumps(train)}"]
    lines += [f"test = {json.dumps(test)}"] if test else []
    lines += ['dwell = ["rest.csv"]'] if dwell_logged else []
    for name, values in case.told.items():
        lines += ["", "[[effect]]", f'kind = "{name}"']
        lines += [f"order = {values['order']:.0f}"] if values.get("order", 1) > 1 else []
    (project / "zerodrift.toml").write_text("\n".join(lines) + "\n", encoding="utf-8")
    truth = {
        **vars(case.recipe), "told": case.told, "truth": case.truth, "sizes": case.sizes,
        "noise_rms": list(case.noise_rms), "tared": case.tared, "period_s": case.period_s,
        "dwell": dwell_logged, "output_count": len(case.units), "start_s": start_s,
        "length_s": float(np.mean([run.time_s[-1] for run in case.runs[:-1]])),
    }  # fmt: skip
    (home / "truth.json").write_text(json.dumps(truth, indent=1), encoding="utf-8")
    return project


def _table(
    run: Run, values: Array, case: Case, logged: list[str], start_s: float
) -> dict[str, Array]:
    """Columns of one run's log; a load that never moves has no reference."""
    seen = run.as_logged(LSB_DEGC)
    table = {"zeit": np.round(seen.time_s + start_s, 3), "T_pcb": seen.temperature_degC}
    for k in range(len(case.units)):
        table[f"roh{k}"] = values[:, k]
        if any(np.any(other.loads[:, k]) for other in case.runs):
            table[f"soll{k}"] = seen.loads[:, k]
    courses = {**seen.channels, "clock": run.start_s + seen.time_s}
    return table | {COLUMNS[name]: courses[name] for name in logged}


def _csv(path: Path, tables: dict[str, dict[str, Array]], separator: str) -> None:
    """Write the runs' tables, with a column `run` if there are several."""
    rows = [[*["run"] * (len(tables) > 1), *next(iter(tables.values()))]]
    for name, table in tables.items():
        for row in zip(*(column.tolist() for column in table.values()), strict=True):
            rows += [[*[name] * (len(tables) > 1), *(f"{value:.10g}" for value in row)]]
    path.write_text("\n".join(map(separator.join, rows)) + "\n", encoding="utf-8")
