"""The six-axis twin in figures: drift of its specimens, noise, integration, time, calibration.

Everything is simulated. Times are CPU seconds of this process.
"""

import time

import numpy as np

from zerodrift.calibration.matrix import fit_calibration
from zerodrift_lab.twin.project import name_outputs
from zerodrift_lab.twin.sensor import FULL_SCALE, OUTPUTS, UNITS
from zerodrift_lab.twin.six_axis import draw_sensor, load_protocol, record
from zerodrift_lab.twin.six_axis.files import ADC_COLUMNS

PAPER_SPAN = (35.0, 25.0, 160.0, 1.4, 1.6, 0.8)
BENCH = ("heating", "cooling", "walking", "standing", "lamp_steps", "cold_start")


def main(quick: bool) -> None:
    """Print the tables; `quick` draws fewer specimens."""
    print_drift(12 if quick else 200)
    print_runs()
    print_gain()
    print_halving()
    print_calibration()
    print_time(2 if quick else 8)


def print_drift(count: int) -> None:
    """Print how far settled specimens drift from -20 to 60 degC, and their noise."""
    spans = np.abs([draw_sensor(seed).drift_span() for seed in range(count)])
    noise = np.array([draw_sensor(seed).noise_rms for seed in range(count)])
    low, middle, high = np.quantile(spans, (0.1, 0.5, 0.9), axis=0)
    print(f"drift from -20 to 60 degC, {count} simulated specimens, and noise RMS")
    print("  output  paper   10 %     median   90 %     noise     % of full scale")
    for k, (name, unit) in enumerate(zip(OUTPUTS, UNITS, strict=True)):
        rms = float(np.median(noise[:, k]))
        print(
            f"  {name} {unit:<3} {PAPER_SPAN[k]:6g} {low[k]:8.3g} {middle[k]:8.3g} {high[k]:8.3g}"
            f" {rms:9.2g} {100.0 * rms / FULL_SCALE[k]:9.4f}"
        )


def print_runs() -> None:
    """Print the RMS drift of Fz in the bundled protocols, and what body and board differ by."""
    print("RMS drift of Fz, noise floor of Fz, and body minus board, sensors 1 to 3")
    for name in ("chamber", "chamber_loaded", *BENCH, "dwell"):
        runs = [record(draw_sensor(seed), load_protocol(name)) for seed in (1, 2, 3)]
        drift = np.mean([np.sqrt(np.mean(run.drift[:, 2] ** 2)) for run in runs])
        floor = np.mean([run.floor[2] for run in runs])
        apart = np.concatenate([run.nodes[:, 4] - run.nodes[:, 7] for run in runs])
        print(
            f"  {name:<16}{drift:7.2f} N {floor:7.3f} N {apart.min():7.1f} to {apart.max():4.1f} K"
        )


def print_gain() -> None:
    """Print how the gain of Fz moves with temperature."""
    for seed in (1, 2, 3):
        sensor = draw_sensor(seed)
        load = np.zeros((2, 6))
        load[:, 2] = (100.0, -100.0)
        gain = []
        for air in (-20.0, 60.0):
            nodes = sensor.network.settle(10.0, air)[None].repeat(2, axis=0)
            found = sensor.to_load(sensor.sense(load, nodes))[:, 2]
            gain.append((found[0] - found[1]) / 200.0)
        print(f"gain of Fz, sensor {seed}: {gain[0]:.4f} at -20, {gain[1]:.4f} at 60 degC")


def print_halving() -> None:
    """Print what half the integration step changes."""
    worst = 0.0
    for name in ("chamber", "chamber_loaded", *BENCH):
        sensor = draw_sensor(1)
        coarse = record(sensor, load_protocol(name))
        fine = record(sensor, load_protocol(name), finer=2)
        change = np.abs(coarse.drift - fine.drift).max(axis=0) / sensor.noise_rms
        worst = max(worst, float(change.max()))
    print(f"half the step changes the drift by at most {worst:.1e} of the noise RMS")


def print_calibration() -> None:
    """Print what a least-squares calibration from a simulated log of test weights leaves."""
    for squares in (False, True):
        errors = []
        conditions = []
        for seed in range(1, 9):
            run = record(draw_sensor(seed), load_protocol("weights"))
            fitted = fit_calibration(
                [run.adc.astype(np.float64)],
                [run.reference],
                ADC_COLUMNS,
                name_outputs(),
                squares=squares,
            )
            errors.append(100.0 * fitted.rmse / fitted.span)
            conditions.append(fitted.condition)
        shown = ", ".join(f"{value:.3f}" for value in np.median(errors, axis=0))
        what = "6 x 12, with squares" if squares else "6 x 6"
        print(
            f"calibration {what}: residual RMSE {shown} % of span, condition number "
            f"{np.median(conditions):.1f} (medians of 8 sensors)"
        )


def print_time(sensors: int) -> None:
    """Print the CPU time of a campaign, and of an hour at 10 Hz."""
    begin = time.process_time()
    for seed in range(1, sensors + 1):
        sensor = draw_sensor(seed)
        for number in range(6):
            record(sensor, load_protocol("chamber"), f"chamber_{number}")
        for name in BENCH:
            for number in range(2):
                record(sensor, load_protocol(name), f"{name}_{number}")
    print(
        f"{sensors} sensors x (6 chamber cycles + 12 bench logs) at 1 Hz: "
        f"{time.process_time() - begin:.1f} s of CPU"
    )
    begin = time.process_time()
    run = record(draw_sensor(1), load_protocol("walking"), period_s=0.1)
    print(
        f"{run.seconds:.0f} s of walking at 10 Hz ({run.time_s.size} samples): "
        f"{time.process_time() - begin:.2f} s of CPU"
    )


if __name__ == "__main__":
    import sys

    main("--quick" in sys.argv)
