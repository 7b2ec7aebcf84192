"""Small simulated logs, one set for each page on where logs come from, by the formats' own writers.

The pages say that they are simulated. Nothing here is used by the program.
"""

import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from datetime import datetime, timedelta
from pathlib import Path

import numpy as np
import polars as pl
from numpy.typing import NDArray
from tests.dataset.log_writers import TEMPERATURE_MESSAGE, WRENCH

Array = NDArray[np.float64]
KELVIN = 273.15


@dataclass(frozen=True)
class SimulatedRun:
    """One warm-up and cool-down of a force sensor at rest, a row every second."""

    name: str
    time_s: Array
    celsius: Array
    newton: Array
    """What it measures with nothing on it: its drift and its noise."""


def simulate(names: tuple[str, ...], seed: int, gain: float = 0.8) -> Iterator[SimulatedRun]:
    """Yield runs whose drift is a straight line over temperature; the last is the mildest."""
    rng = np.random.default_rng(seed)
    for number, name in enumerate(names):
        t = np.arange(900.0)
        turn = 0.5 - 0.5 * np.cos(2.0 * np.pi * (1.0 + 0.25 * number) * t / t.size)
        low, high = ((12.0, 40.0), (8.0, 48.0), (15.0, 42.0))[number]
        celsius = low + (high - low) * turn
        drift = gain * (celsius - 25.0)
        yield SimulatedRun(name, t, celsius, drift + rng.normal(0.0, 0.05, t.size))


def write_data_logger(folder: Path) -> None:
    """Write a logger's text: semicolons, decimal commas, its own clock, a thermistor in ohm."""
    (folder / "logs").mkdir()
    for run in simulate(("chamber_1", "chamber_2", "field"), 1):
        ohm = 1e4 * np.exp(3950.0 * (1.0 / (run.celsius + KELVIN) - 1.0 / 298.15))
        began = datetime(2024, 10, 21, 8, 0, 0)
        lines = ["# Logger 4711, firmware 2.3", "Zeit;NTC [ohm];Kraft [N]"]
        for t, r, force in zip(run.time_s, ohm, run.newton, strict=True):
            at = (began + timedelta(seconds=float(t))).strftime("%d.%m.%Y %H:%M:%S")
            values = f"{r:.1f};{force:.3f}".replace(".", ",")
            lines.append(f"{at};{values}")
        text = "\r\n".join(lines) + "\r\n"
        (folder / "logs" / f"{run.name}.csv").write_bytes(text.encode("cp1252"))

    write_couples(folder / "couples")


def write_couples(folder: Path) -> None:
    """Write a folder for each run: a meter's millivolts, and its board's temperature every 2 s.

    The polynomials are the reference function of type T from 0 to 400 degC, ITS-90.
    """
    type_t = (0.0, 38.748106364e-3, 3.329222788e-5, 2.0618243404e-7, -2.1882256846e-9)
    millivolts = np.polynomial.Polynomial((*type_t, 1.0996880928e-11, -3.0815758772e-14))
    for run in simulate(("chamber_1", "chamber_2", "field"), 6):
        (folder / run.name).mkdir(parents=True)
        board = 24.0 + 3.0 * run.time_s / run.time_s.size
        rows = zip(run.time_s, millivolts(run.celsius) - millivolts(board), run.newton, strict=True)
        lines = ["t [s];TC [mV];Kraft [N]", *(f"{t:.0f};{v:.4f};{f:.3f}" for t, v, f in rows)]
        text = "\n".join(line.replace(".", ",") for line in lines) + "\n"
        (folder / run.name / "meter.csv").write_text(text)
        slow = zip(run.time_s[::2], board[::2], strict=True)
        lines = ["t [s];Platine [degC]", *(f"{t:.0f};{c:.2f}".replace(".", ",") for t, c in slow)]
        (folder / run.name / "board.csv").write_text("\n".join(lines) + "\n")


def write_ros(folder: Path) -> None:
    """Write MCAP bags with a wrench and a temperature, each a topic, the latter at 2 Hz."""
    from mcap_ros2.writer import Writer

    (folder / "bags").mkdir()
    for run in simulate(("chamber_1", "chamber_2", "walk"), 2):
        with (folder / "bags" / f"{run.name}.mcap").open("wb") as file:
            writer = Writer(file)
            wrench = writer.register_msgdef("geometry_msgs/msg/WrenchStamped", WRENCH)
            heat = writer.register_msgdef("sensor_msgs/msg/Temperature", TEMPERATURE_MESSAGE)
            zero = {"x": 0.0, "y": 0.0, "z": 0.0}
            for t, celsius, newton in zip(run.time_s, run.celsius, run.newton, strict=True):
                load = {**zero, "z": float(newton)}
                for topic, schema, late_s, body in (
                    ("/ft/wrench", wrench, 0.0, {"wrench": {"force": load, "torque": zero}}),
                    ("/ft/temperature", heat, 0.1, {"temperature": float(celsius)}),
                ):
                    at_ns = int((1.7e9 + t + late_s) * 1e9)
                    stamp = {"sec": at_ns // 10**9, "nanosec": at_ns % 10**9}
                    message = {"header": {"stamp": stamp, "frame_id": "ft"}, **body}
                    writer.write_message(topic, schema, message, at_ns, at_ns)
            writer.finish()


def write_flight(folder: Path) -> None:
    """Write two ULogs of PX4 and one .bin of ArduPilot, with a load cell and its temperature."""
    (folder / "logs").mkdir()
    for run in simulate(("bench_1", "bench_2", "flight"), 3):
        data = _write_dataflash(run) if run.name == "flight" else _write_ulog(run)
        suffix = "bin" if run.name == "flight" else "ulg"
        (folder / "logs" / f"{run.name}.{suffix}").write_bytes(data)


def _write_ulog(run: SimulatedRun) -> bytes:
    def pack(kind: str, body: bytes) -> bytes:
        return struct.pack("<HB", len(body), ord(kind)) + body

    data = b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 0) + pack("B", bytes(40))
    data += pack("F", b"load_cell:uint64_t timestamp;float force_n;float temperature_degc;")
    data += pack("A", struct.pack("<BH", 0, 0) + b"load_cell")
    for t, celsius, newton in zip(run.time_s, run.celsius, run.newton, strict=True):
        data += pack("D", struct.pack("<HQff", 0, 1_000_000 + int(t * 1e6), newton, celsius))
    return data


def _write_dataflash(run: SimulatedRun) -> bytes:
    def define(kind: int, name: str, form: str, columns: str, size: int) -> bytes:
        body = struct.pack(
            "<BB4s16s64s", kind, size + 3, name.encode(), form.encode(), columns.encode()
        )
        return b"\xa3\x95\x80" + body

    data = define(128, "FMT", "BBnNZ", "Type,Length,Name,Format,Columns", 86)
    data += define(1, "LOAD", "Qff", "TimeUS,force_n,temperature_degc", 16)
    for t, celsius, newton in zip(run.time_s, run.celsius, run.newton, strict=True):
        data += b"\xa3\x95\x01" + struct.pack("<Qff", int(t * 1e6) + 500_000, newton, celsius)
    return data


def write_laboratory(folder: Path) -> None:
    """Write a folder for each run: a voltmeter's file and an oven's, each at its own rate."""
    for run in simulate(("run_1", "run_2", "run_3"), 4):
        place = folder / "runs" / run.name
        place.mkdir(parents=True)
        pl.DataFrame({"time_s": run.time_s, "bridge_mV": (run.newton * 0.01).round(5)}).write_csv(
            place / "voltmeter.csv"
        )
        pl.DataFrame({"time_s": run.time_s[::5], "oven_degC": run.celsius[::5].round(3)}).write_csv(
            place / "oven.csv"
        )


def write_rig(folder: Path) -> None:
    """Write a Parquet file for each unit of a lot, with its runs in a column."""
    (folder / "lot").mkdir()
    for number, serial in enumerate(("SN001", "SN002", "SN003")):
        frames = [
            pl.DataFrame(
                {
                    "run": [run.name] * run.time_s.size,
                    "time_s": run.time_s,
                    "temperature_degC": run.celsius.round(3),
                    "Fz_N": run.newton.round(3),
                }
            )
            for run in simulate(("ramp_1", "ramp_2", "check"), 10 + number, 0.7 + 0.1 * number)
        ]
        (folder / "lot" / serial).mkdir()
        pl.concat(frames).write_parquet(folder / "lot" / serial / "climate.parquet")


WORLDS: dict[str, Callable[[Path], None]] = {
    "data-logger": write_data_logger,
    "ros": write_ros,
    "flight": write_flight,
    "laboratory": write_laboratory,
    "rig": write_rig,
}
"""Name in a page's `<!-- logs: NAME -->` -> what writes them into a folder."""
