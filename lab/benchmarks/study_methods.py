"""Every method on the same simulated six-axis sensors: which one deserves to be the default.

    python -m benchmarks.study_methods [--sensors 1 2] [--methods lag_bank mlp_seq ...]

For each set of logs the error on held-out runs over the noise floor (RMS over axes and runs, each
axis in units of its chamber drift), with parameters, MACs per step and CPU seconds of the fit. The
evidence of `docs/explanation/lag-bank.md` and `docs/decisions/071-lag-bank-by-default.md`.
"""

import argparse
from collections.abc import Sequence

import numpy as np

from zerodrift.base.arrays import Array
from zerodrift.dataset.runs import Dataset, Run
from zerodrift_lab.methods import METHODS, Fitted, Options
from zerodrift_lab.twin.six_axis import draw_sensor, load_protocol, record, to_dataset
from zerodrift_lab.twin.six_axis.record import Recording

CHAMBER, VARIED, LOADED = 6, ("heating", "cooling", "walking", "standing", "lamp_steps"), 3
PER_KIND = 2
JUDGED = ("chamber", "heating", "cooling", "walking")
CASES = {
    "chamber logs": (False, False, False),
    "chamber and varied logs": (True, False, False),
    "the same, second thermometer": (True, False, True),
    "chamber logs with test weights": (False, True, False),
}
"""Title -> (varied logs, test weights, second thermometer)."""
DEFAULT = ("lsm_linear", "lsm_cubic", "mlp_seq", "gru_window_pytorch", "gru_stream", "lag_bank")


def make_logs(sensor_seed: int, varied: bool, loaded: bool) -> tuple[Dataset, dict[str, Array]]:
    """Return a sensor's logs, and the noise floor [K] of each test run."""
    sensor = draw_sensor(sensor_seed)

    def log(kind: str, use: str, count: int, seed: int) -> list[Recording]:
        protocol = load_protocol(kind)
        names = [f"{use}_{kind}_{i}" for i in range(1, count + 1)]
        return [record(sensor, protocol, name=n, seed=seed, period_s=1.0) for n in names]

    train = log("chamber", "train", CHAMBER, 1)
    if varied:
        train += [run for kind in VARIED for run in log(kind, "train", PER_KIND, 2)]
    if loaded:
        train += log("chamber_loaded", "train", LOADED, 1)
    kinds = (*JUDGED, *(("chamber_loaded",) if loaded else ()))
    test = [run for kind in kinds for run in log(kind, "test", 2, 3)]
    dataset = to_dataset(train, test=test, dwell=[], channels=("body_temperature",))
    return dataset, {run.name: run.floor for run in test}


def judge(fitted: Fitted, dataset: Dataset, floors: dict[str, Array]) -> dict[str, float]:
    """Return error over noise floor by kind of run."""
    chamber = [run.drift for run in dataset.train if run.name.startswith("train_chamber")]
    scale = np.concatenate(chamber).std(axis=0)
    squares: dict[str, list[tuple[float, float]]] = {}
    for run in dataset.test:
        error = np.mean(((run.drift - fitted.predict(run)) / scale) ** 2)
        floor = np.mean((floors[run.name] / scale) ** 2)
        squares.setdefault(_kind_of(run), []).append((float(error), float(floor)))
    return {
        kind: float(np.sqrt(np.sum([e for e, _ in pairs]) / np.sum([f for _, f in pairs])))
        for kind, pairs in squares.items()
    }


def _kind_of(run: Run) -> str:
    return run.name.removeprefix("test_").rpartition("_")[0]


def main(sensors: Sequence[int], methods: Sequence[str]) -> None:
    """Print the tables, medians over the sensors."""
    print(
        f"simulated six-axis sensors {list(sensors)}; error / noise floor on held-out runs, medians"
    )
    for title, (varied, loaded, second) in CASES.items():
        kinds = (*JUDGED, *(("chamber_loaded",) if loaded else ()))
        print(f"\n{title:32s}", *(f"{k[-10:]:>10s}" for k in kinds), "   par  MACs  CPU s")
        logs = [make_logs(sensor, varied, loaded) for sensor in sensors]
        for name in methods:
            rows, costs = [], []
            for dataset, floors in logs:
                options = Options(
                    outputs=dataset.outputs,
                    full_scale=dataset.full_scale,
                    thermometers=("body_temperature",) if second else (),
                )
                fitted = METHODS[name].fit(dataset.train, seed=0, options=options)
                found = judge(fitted, dataset, floors)
                rows.append([found[kind] for kind in kinds])
                costs.append((fitted.parameters, fitted.macs_per_step, fitted.fit_cpu_s))
            cells = " ".join(f"{x:10.2f}" for x in np.median(rows, axis=0))
            parameters, macs, seconds = np.median(costs, axis=0)
            print(
                f"{METHODS[name].title:32s} {cells} {parameters:6.0f} {macs:6.0f} {seconds:6.1f}",
                flush=True,
            )


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="Every method on the same simulated sensors.")
    parser.add_argument("--sensors", type=int, nargs="+", default=[1, 2, 3])
    parser.add_argument("--methods", nargs="+", default=list(DEFAULT), choices=list(METHODS))
    arguments = parser.parse_args()
    main(arguments.sensors, arguments.methods)
