"""What PX4, ArduPilot and chrony would compute from the files, by their own rules, and the loss."""

import json
import re

import numpy as np
import pytest
from click.testing import CliRunner
from tests.field.conftest import BEGIN_S, write_log

from zerodrift.base.errors import InputError
from zerodrift.cli.main import cli
from zerodrift.field.neighbours import FullAnswers, fit_polynomial, measure_lost, render

DEGREES = np.linspace(-10.0, 60.0, 701)


def make_answers(columns: int, scale: float = 1.0, bend: float = 0.0) -> FullAnswers:
    t = (DEGREES - 25.0) / 35.0
    drift = [
        scale * ((k + 1) * t + 0.3 * t**2 - 0.2 * t**3 + bend * np.sin(9 * t))
        for k in range(columns)
    ]
    return FullAnswers(DEGREES, np.stack(drift, axis=1))


def write(
    kind: str, answers: FullAnswers, units: list[str], device: int = 0, order: int = 3
) -> str:
    fitted = fit_polynomial(kind, None, answers, [1.0] * len(units), order)
    return render(kind, fitted, [f"o{k}" for k in range(len(units))], device, "head")


def read_px4(text: str) -> dict[str, float]:
    rows = [line.split("\t") for line in text.splitlines() if not line.startswith("#")]
    assert all(row[:2] == ["1", "1"] and row[4] in ("6", "9") for row in rows)
    return {row[2]: float(np.float32(row[3])) for row in rows}


@pytest.mark.parametrize(("kind", "letter"), [("px4-accel", "A"), ("px4-gyro", "G")])
def test_px4_computes_the_drift(kind: str, letter: str) -> None:
    answers = make_answers(3)
    p = read_px4(write(kind, answers, ["m/s2"] * 3))
    assert p[f"TC_{letter}_ENABLE"] == 1
    stem = f"TC_{letter}0_"
    d = np.clip(DEGREES, p[stem + "TMIN"], p[stem + "TMAX"]) - p[stem + "TREF"]
    for axis in range(3):
        offset = sum(p[f"{stem}X{order}_{axis}"] * d**order for order in range(4))
        assert offset == pytest.approx(answers.drift[:, axis], abs=1e-5)


def test_px4_takes_the_fifth_order_for_a_barometer() -> None:
    answers = make_answers(1, 50.0)
    p = read_px4(write("px4-baro", answers, ["Pa"], device=1, order=5))
    d = DEGREES - p["TC_B1_TREF"]
    offset = sum(p[f"TC_B1_X{order}"] * d**order for order in range(6))
    assert offset == pytest.approx(answers.drift[:, 0], abs=1e-3)


def test_ardupilot_computes_the_drift_up_to_its_own_constant() -> None:
    answers = make_answers(3)
    text = write("ardupilot-accel", answers, ["m/s2"] * 3, device=1)
    p = {k: float(v) for k, v in re.findall(r"^(INS_\w+),(\S+)$", text, re.MULTILINE)}
    assert p["INS_TCAL1_ENABLE"] == 1
    d = np.clip(DEGREES, p["INS_TCAL1_TMIN"], p["INS_TCAL1_TMAX"]) - 35.0
    for axis, name in enumerate("XYZ"):
        c = [p[f"INS_TCAL1_ACC{order}_{name}"] for order in (1, 2, 3)]
        taken = (c[0] + (c[1] + c[2] * d) * d) * d * 1e-6
        apart = taken - answers.drift[:, axis]
        assert np.ptp(apart) < 1e-5


def test_chrony_runs_the_clock_against_its_drift() -> None:
    t = (DEGREES - 25.0) / 35.0
    answers = FullAnswers(DEGREES, (4.0 * t + 3.0 * t**2)[:, None])
    text = write("chrony", answers, ["ppm"], order=2)
    (line,) = [row for row in text.splitlines() if row.startswith("tempcomp ")]
    _, file, interval, t0, k0, k1, k2 = line.split()
    assert file.startswith("/sys/") and float(interval) > 0
    d = 1000.0 * DEGREES - float(t0)
    comp = float(k0) + d * float(k1) + d**2 * float(k2)
    assert np.ptp(comp + answers.drift[:, 0]) < 1e-3
    assert np.abs(comp).max() <= 10.0
    points = write("chrony-points", answers, ["ppm"], order=9)
    pairs = np.array([row.split() for row in points.splitlines()[1:]], dtype=float)
    joined = np.interp(1000.0 * DEGREES, *pairs.T)
    assert np.ptp(joined + answers.drift[:, 0]) < 0.02


def test_chrony_would_ignore_a_clock_that_drifts_by_more() -> None:
    with pytest.raises(InputError, match="chrony ignores"):
        write("chrony", make_answers(1, 12.0), ["ppm"], order=2)


def test_the_loss_is_what_the_file_leaves() -> None:
    answers = make_answers(1, bend=0.1)
    fitted = fit_polynomial("px4-accel", None, answers, [9.80665], 3)
    (lost,) = measure_lost("px4-accel", fitted, ["g"], None, answers)
    p = read_px4(render("px4-accel", fitted, ["o"], 0, ""))
    d = DEGREES - p["TC_A0_TREF"]
    own = sum(p[f"TC_A0_X{order}_0"] * d**order for order in range(4)) / 9.80665
    apart = own - answers.drift[:, 0]
    assert lost.rms_range == pytest.approx(np.sqrt(np.mean(apart**2)), rel=1e-3)
    assert lost.worst_range == pytest.approx(np.abs(apart).max(), rel=1e-3)
    assert lost.rms_logs is None
    assert lost.rms_range > 0.05


def test_the_command_writes_a_table_and_tells_the_loss(unit, tmp_path) -> None:
    log = write_log(tmp_path / "a.csv", 60, 2, begin_s=BEGIN_S)
    out = tmp_path / "p.csv"
    arguments = ["neighbour", "polynomial", str(log), "-C", str(unit), "--out", str(out), "--json"]
    result = CliRunner().invoke(cli, arguments)
    assert result.exit_code == 0, result.output
    lost = json.loads(result.stdout)["lost"]["y"]
    assert lost["unit"] == "N"
    assert 0 < lost["rms_logs"] < 0.01  # the simulated drift is a line
    names, values = (row.split(",") for row in out.read_text().splitlines()[-2:])
    told = dict(zip(names[1:], map(float, values[1:]), strict=True))
    at = 30.0 - told["around_degC"]
    slope = (told["c0"] + told["c1"] * at) - told["c0"]
    assert slope == pytest.approx(0.3 * at, abs=0.02)
    out.write_text("mine\n")
    again = CliRunner().invoke(cli, arguments)
    assert "was not written by" in str(again.exception)
    assert out.read_text() == "mine\n"
    refused = CliRunner().invoke(cli, ["neighbour", "px4-accel", "-C", str(unit)])
    assert "has no use for the unit 'N'" in str(refused.exception)
