"""The calibration matrix: recovered from codes, refused where the loads cannot tell it."""

import json
import re
import subprocess
import tomllib
from pathlib import Path

import numpy as np
import polars as pl
import pytest
from click.testing import CliRunner

from zerodrift.base.errors import InputError
from zerodrift.c_runtime.compilers import WARNINGS, find_compilers
from zerodrift.calibration.files import choose_counts, quantize_row
from zerodrift.calibration.matrix import fit_calibration
from zerodrift.cli.calibrate import command
from zerodrift.export.compose import choose_lsb_per_unit
from zerodrift_lab.twin.six_axis import draw_sensor, load_protocol, record
from zerodrift_lab.twin.six_axis.files import render_log

CHANNELS = tuple(f"adc_{k}" for k in range(1, 7))
OUTPUTS = ("Fx_N", "Fy_N", "Fz_N", "Mx_Nm", "My_Nm", "Mz_Nm")
SCALE = np.array([100.0, 100.0, 400.0, 2.0, 2.0, 3.0])


def make(rows=400, seed=0, noise=0.0, loads=None):
    """Return codes, loads and the matrix that made the codes, all known."""
    rng = np.random.default_rng(seed)
    forward = rng.normal(size=(6, 6)) * 1000.0 / SCALE + np.diag(3000.0 / SCALE)
    if loads is None:
        loads = rng.uniform(-1.0, 1.0, (rows, 6)) * SCALE
    codes = 32768.0 + loads @ forward.T + noise * rng.standard_normal((len(loads), 6))
    return codes, loads, np.linalg.inv(forward)


def write(path, codes, loads, **columns):
    values = {"time_s": np.arange(len(codes)) * 1.0, **columns}
    values |= {name: codes[:, k] for k, name in enumerate(CHANNELS)}
    values |= {f"ref_{name}": loads[:, k] for k, name in enumerate(OUTPUTS)}
    pl.DataFrame(values).write_csv(path)
    return path


def run(*arguments, directory):
    return CliRunner().invoke(
        command, ["-C", str(directory), *map(str, arguments)], catch_exceptions=False
    )


def test_exact_codes_give_back_the_exact_matrix():
    codes, loads, matrix = make()
    fitted = fit_calibration([codes], [loads], CHANNELS, OUTPUTS)
    np.testing.assert_allclose(fitted.matrix, matrix, rtol=1e-8, atol=1e-12)
    np.testing.assert_allclose(fitted.apply(codes), loads, atol=1e-8)
    np.testing.assert_allclose(fitted.unloaded_codes, 32768.0, atol=1e-6)
    assert np.all(fitted.rmse < 1e-9 * SCALE)
    assert fitted.held_out is None
    assert fitted.notes == ()


def test_residuals_and_held_out_errors_are_those_of_the_noise():
    logs = [make(rows=300, seed=seed, noise=0.0) for seed in (1, 1)]
    forward = np.linalg.inv(logs[0][2])
    rng = np.random.default_rng(5)
    codes = [log[0] + 20.0 * rng.standard_normal(log[0].shape) for log in logs]
    fitted = fit_calibration(codes, [log[1] for log in logs], CHANNELS, OUTPUTS)
    expected = 20.0 * np.sqrt(np.sum(np.linalg.inv(forward) ** 2, axis=1))
    np.testing.assert_allclose(fitted.rmse, expected, rtol=0.15)
    assert fitted.held_out is not None
    assert np.all(fitted.held_out > fitted.rmse)
    np.testing.assert_allclose(fitted.held_out, expected, rtol=0.2)
    assert np.all(fitted.largest > 2.0 * fitted.rmse)


def test_offsets_per_log_take_up_zeros_that_moved():
    codes, loads, matrix = make(rows=600)
    moved = [codes[:200], codes[200:400] + 500.0, codes[400:] - 300.0]
    parts = [loads[:200], loads[200:400], loads[400:]]
    shared = fit_calibration(moved, parts, CHANNELS, OUTPUTS)
    own = fit_calibration(moved, parts, CHANNELS, OUTPUTS, offset_per_log=True)
    np.testing.assert_allclose(own.matrix, matrix, rtol=1e-6, atol=1e-11)
    assert np.all(own.rmse < 1e-6 * SCALE)
    assert own.held_out is not None
    assert np.all(own.held_out < 1e-6 * SCALE)
    assert np.any(shared.rmse > 0.01 * SCALE)
    assert own.log_offsets is not None
    # A log's offset is the load that its own zero stands for at the common center.
    for k, zero in enumerate((32768.0, 33268.0, 32468.0)):
        expected = (own.center - zero) @ matrix.T
        np.testing.assert_allclose(own.log_offsets[k], expected, atol=1e-6)
    np.testing.assert_allclose(own.offset, own.log_offsets.mean(axis=0))


def test_direction_that_only_differs_between_logs_is_missing_with_offsets_per_log():
    codes, loads, _ = make(rows=400)
    loads[:200, 3], loads[200:, 3] = 1.0, -1.0
    codes, loads, _ = make(loads=loads)
    halves = ([codes[:200], codes[200:]], [loads[:200], loads[200:]])
    fit_calibration(*halves, CHANNELS, OUTPUTS)
    with pytest.raises(InputError, match="never move Mx_Nm alone: 5 of 6"):
        fit_calibration(*halves, CHANNELS, OUTPUTS, offset_per_log=True)


def test_squares_take_up_couplers_that_are_not_straight():
    codes, loads, _ = make(rows=2000)
    bent = codes + 2e-5 * (codes - 32768.0) ** 2
    plain = fit_calibration([bent], [loads], CHANNELS, OUTPUTS)
    squared = fit_calibration([bent], [loads], CHANNELS, OUTPUTS, squares=True)
    assert squared.matrix.shape == (6, 12)
    assert np.all(squared.rmse < 0.3 * plain.rmse)
    assert squared.unloaded_codes is None


def test_condition_number_is_that_of_the_scaled_matrix():
    loads = np.concatenate([np.eye(6), -np.eye(6)]) * SCALE
    codes = np.repeat(loads, 3, axis=0) * (1000.0 / SCALE)
    fitted = fit_calibration([codes], [np.repeat(loads, 3, axis=0)], CHANNELS, OUTPUTS)
    assert fitted.condition == pytest.approx(1.0)
    assert fitted.load_condition == pytest.approx(1.0)


def test_direction_that_is_never_loaded_is_named():
    _, loads, _ = make()
    loads[:, 5] = 0.0
    with pytest.raises(InputError, match=r"never move Mz_Nm, .*Add weights along Mz_Nm"):
        codes, loads, _ = make(loads=loads)
        fit_calibration([codes], [loads], CHANNELS, OUTPUTS)


def test_loads_in_a_fixed_ratio_are_named():
    _, loads, _ = make()
    loads[:, 4] = 0.05 * loads[:, 0]
    codes, loads, _ = make(loads=loads)
    with pytest.raises(InputError, match="5 of 6 directions") as caught:
        fit_calibration([codes], [loads], CHANNELS, OUTPUTS)
    text = str(caught.value)
    assert "Fx_N" in text
    assert "My_Nm" in text
    ratio = re.search(r"([\d.]+) (Fx_N|My_Nm) to 1 (Fx_N|My_Nm)", text)
    assert ratio is not None
    assert float(ratio[1]) == pytest.approx(20.0 if ratio[2] == "Fx_N" else 0.05, rel=1e-3)


@pytest.mark.parametrize("missing", range(6))
def test_noise_of_the_reference_does_not_pass_for_a_load(missing):
    """A capacitive reference shows noise along an axis that nothing loaded."""
    _, loads, _ = make(rows=3000)
    loads[:, missing] = 0.0
    codes, loads, _ = make(loads=loads, noise=3.0)
    shown = loads + 1e-3 * SCALE * np.random.default_rng(9).standard_normal(loads.shape)
    with pytest.raises(InputError, match=rf"of what {OUTPUTS[missing]} does"):
        fit_calibration([codes], [shown], CHANNELS, OUTPUTS)


def test_dead_and_doubled_channels_are_named():
    codes, loads, _ = make()
    dead = codes.copy()
    dead[:, 2] = 411.0
    with pytest.raises(InputError, match="adc_3 is 411 in every row"):
        fit_calibration([dead], [loads], CHANNELS, OUTPUTS)
    doubled = codes.copy()
    doubled[:, 4] = doubled[:, 1]
    with pytest.raises(InputError, match="codes of adc_2, adc_5 depend on each other"):
        fit_calibration([doubled], [loads], CHANNELS, OUTPUTS)
    with pytest.raises(InputError, match="7 rows for 7 unknowns"):
        fit_calibration([codes[:7]], [loads[:7]], CHANNELS, OUTPUTS)


def test_note_on_drift_within_the_calibration():
    codes, loads, _ = make()
    warm = np.linspace(20.0, 40.0, len(codes))
    fitted = fit_calibration([codes], [loads], CHANNELS, OUTPUTS, temperatures=[warm])
    assert "temperature spans 20.0 K" in fitted.notes[0]


def test_fewer_outputs_than_channels_are_fitted():
    codes, loads, matrix = make()
    fitted = fit_calibration([codes], [loads[:, :2]], CHANNELS, OUTPUTS[:2])
    np.testing.assert_allclose(fitted.matrix, matrix[:2], rtol=1e-7, atol=1e-11)


# --- the command ---------------------------------------------------------------------------------


def test_command_recovers_a_simulated_sensors_matrix_and_compensates_nothing(tmp_path):
    sensor = draw_sensor(5)
    (tmp_path / "adc").mkdir()
    for k in (1, 2):
        weights = record(sensor, load_protocol("weights"), f"weights_{k}", k)
        (tmp_path / f"adc/weights_{k}.csv").write_bytes(render_log(weights, (), codes=True))
    walk = record(sensor, load_protocol("walking"), "walking_1")
    (tmp_path / "adc/walking_1.csv").write_bytes(render_log(walk, (), codes=True))
    result = run(
        "adc/weights_*.csv", "--apply", "adc", "--out", "logs", "--write", "cal.toml", "--json",
        directory=tmp_path,
    )  # fmt: skip
    plain = json.loads(result.stdout)
    rows = np.array([plain["outputs"][name]["row"] for name in OUTPUTS])
    scaled = np.abs(rows - sensor.calibration) / np.abs(sensor.calibration).max(axis=1)[:, None]
    assert scaled.max() < 0.02
    assert 1.0 < plain["condition_number"] < 10.0
    assert plain["outputs"]["Fz_N"]["rmse_heldout"] > 0.0
    assert plain["files"][0] == "cal.toml"
    written = pl.read_csv(tmp_path / "logs/walking_1.csv")
    assert written.columns[:4] == ["time_s", "temperature_degC", "Fx_N", "Fy_N"]
    # Two calibrations of one sensor agree but for an offset and half a per cent.
    difference = written["Fz_N"].to_numpy() - walk.measured[:, 2]
    assert (difference - difference.mean()).std() < 0.02 * walk.measured[:, 2].std()
    with (tmp_path / "cal.toml").open("rb") as file:
        kept = tomllib.load(file)
    assert [kept["outputs"][name]["row"] for name in OUTPUTS] == rows.tolist()
    with pytest.raises(InputError, match="exists already"):
        run("adc/weights_1.csv", "--apply", "adc", "--out", "logs", directory=tmp_path)


def test_command_prints_tables_without_writing(tmp_path):
    codes, loads, _ = make()
    write(tmp_path / "a.csv", codes, loads)
    result = run("a.csv", directory=tmp_path)
    for text in (
        "Matrix",
        "Residuals",
        "Condition number of the matrix",
        "Fz",
        "adc_6",
        "400 rows",
    ):
        assert text in result.stdout
    assert [path.name for path in tmp_path.iterdir()] == ["a.csv"]


def saturate(codes):
    codes[100:140, 3] = 65535.0
    return np.minimum(codes, 65535.0)


def stick(codes):
    codes[:, 3] = np.minimum(codes[:, 3], np.median(codes[:, 3]))
    codes[100:160, 3] = codes[:, 3].max()
    return codes


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (saturate, r"a\.csv:102: adc_4 is saturated at 65535 \(40 of 400 rows\)"),
        (stick, r"a\.csv:\d+: adc_4 is saturated at \d+ \(\d+ of 400 rows\)"),
    ],
)
def test_saturated_codes_are_refused_with_their_line(change, message, tmp_path):
    codes, loads, _ = make()
    write(tmp_path / "a.csv", change(np.round(codes)), loads)
    with pytest.raises(InputError, match=message):
        run("a.csv", "--write", "c.toml", directory=tmp_path)
    assert not (tmp_path / "c.toml").exists()


def test_missing_columns_damaged_rows_and_files_are_refused(tmp_path):
    codes, loads, _ = make()
    frame = pl.read_csv(write(tmp_path / "a.csv", codes, loads))
    frame.drop("adc_5").write_csv(tmp_path / "b.csv")
    with pytest.raises(InputError, match=r"b\.csv:1: there is no column 'adc_5'; did you mean"):
        run("b.csv", directory=tmp_path)
    frame.select(CHANNELS).write_csv(tmp_path / "c.csv")
    with pytest.raises(InputError, match=r"c\.csv:1: no column begins with ref_"):
        run("c.csv", directory=tmp_path)
    with pytest.raises(InputError, match=r"there is no column 'ref_Fq_N'"):
        run("a.csv", "--reference", "ref_Fq_N", directory=tmp_path)
    lines = (tmp_path / "a.csv").read_text().splitlines()
    lines[7] = lines[7].replace(lines[7].split(",")[2], "oops")
    (tmp_path / "d.csv").write_text("\n".join(lines) + "\n")
    with pytest.raises(InputError, match=r"d\.csv:8: column 'adc_2' holds 'oops'"):
        run("d.csv", directory=tmp_path)
    assert "dropped 1 row" in run("d.csv", "--skip-invalid", directory=tmp_path).output
    with pytest.raises(InputError, match="no file matches"):
        run("none_*.csv", directory=tmp_path)
    with pytest.raises(InputError, match="ends in"):
        run("a.csv", "--write", "c.txt", directory=tmp_path)
    with pytest.raises(InputError, match="belong together"):
        run("a.csv", "--apply", "a.csv", directory=tmp_path)


def test_counts_per_unit_are_the_firmwares():
    for full_scale in (0.5, 14.0, 20.0, 600.0, 1000.0, 2000.0, 5e6):
        assert choose_counts(full_scale) == choose_lsb_per_unit(full_scale)


def test_header_holds_the_full_scale_of_the_project(tmp_path):
    codes, loads, _ = make()
    write(tmp_path / "a.csv", codes, loads)
    (tmp_path / "zerodrift.toml").write_text(
        '[sensor]\nname = "ft"\ntime = "time_s"\ntemperature = "t"\nsample_period_s = 1.0\n'
        '[outputs.Fz]\nmeasured = "Fz_N"\nunit = "N"\nfull_scale = 2000\n'
        '[logs]\ntrain = ["logs/*.csv"]\n'
    )
    run("a.csv", "--write", "c.h", "--name", "FT 40", directory=tmp_path)
    text = (tmp_path / "c.h").read_text()
    assert "#define FT_40_CAL_FZ_LSB_PER_UNIT 1000 " in text
    assert "#define FT_40_CAL_FX_LSB_PER_UNIT 10000 " in text


@pytest.mark.spread(1, "compiler", find_compilers(), ids=lambda compiler: compiler.name)
def test_header_computes_bit_for_bit_what_its_integers_say(compiler, tmp_path):
    """Compiled on the host, over codes of the whole range, against whole numbers in Python."""
    codes, loads, _ = make(noise=2.0)
    write(tmp_path / "a.csv", codes, loads)
    run("a.csv", "--write", "c.h", directory=tmp_path)
    rng = np.random.default_rng(3)
    points = np.concatenate([
        rng.integers(0, 65536, (2000, 6)),
        rng.integers(0, 2**24, (500, 6)),
        [[0] * 6, [65535] * 6, [2**24 - 1] * 6],
    ])  # fmt: skip
    (tmp_path / "main.c").write_text(
        '#include <stdio.h>\n#include "c.h"\nint main(void) {\n'
        "    long in[6];\n    int32_t codes[6], loads[6];\n"
        '    while (scanf("%ld %ld %ld %ld %ld %ld", in, in+1, in+2, in+3, in+4, in+5) == 6) {\n'
        "        for (int k = 0; k < 6; k++) codes[k] = (int32_t)in[k];\n"
        "        sensor_calibrate(codes, loads);\n"
        '        for (int k = 0; k < 6; k++) printf("%ld ", (long)loads[k]);\n'
        '        printf("\\n");\n    }\n    return 0;\n}\n'
    )
    # zig stops at undefined behaviour by itself.
    compiler.run([*WARNINGS, "-O2", str(tmp_path / "main.c"), "-o", str(tmp_path / "main")])
    text = "\n".join(" ".join(map(str, row)) for row in points.tolist())
    output = subprocess.run(
        [tmp_path / "main"], input=text, capture_output=True, text=True, check=True
    ).stdout
    computed = np.array([[int(v) for v in line.split()] for line in output.splitlines()])

    fitted = fit_calibration([codes], [loads], CHANNELS, OUTPUTS)
    limit = 2**31 - 1
    for k in range(6):
        counts = choose_counts(float(fitted.span[k]))
        entries, offset, shift = quantize_row(
            fitted.matrix[k], float(fitted.offset[k]), fitted.center, counts
        )
        for row, found in zip(points.tolist(), computed[:, k].tolist(), strict=True):
            total = offset + sum(e * c for e, c in zip(entries, row, strict=True))
            assert -(2**63) <= total < 2**63
            size = (abs(total) + (1 << shift >> 1)) >> shift
            assert found == (-1 if total < 0 else 1) * min(size, limit)
    # Against the floating matrix: within one count over the range that was calibrated.
    exact = fitted.apply(np.round(codes))
    counts = np.array([choose_counts(float(span)) for span in fitted.span])
    text = "\n".join(" ".join(str(int(v)) for v in row) for row in np.round(codes).tolist())
    output = subprocess.run(
        [tmp_path / "main"], input=text, capture_output=True, text=True, check=True
    ).stdout
    computed = np.array([[int(v) for v in line.split()] for line in output.splitlines()])
    assert np.abs(computed - exact * counts).max() < 1.0


def test_names_of_any_kind_make_a_header_that_compiles(tmp_path):
    codes, loads, _ = make()
    odd = {"ref_Fz (N)*/": 2, "ref_Fz [N]": 0, "ref_3rd_\u00b5m": 1}
    columns = {name: codes[:, k] for k, name in enumerate(CHANNELS)}
    columns |= {name: loads[:, k] for name, k in odd.items()}
    pl.DataFrame(columns).write_csv(tmp_path / "a.csv")
    options = ["--write", "c.h", "--write", "c.toml", "--name", "4\u00fc */ kg"]
    run("a.csv", *options, directory=tmp_path)
    (tmp_path / "main.c").write_text(
        '#include "c.h"\nint main(void) {\n    int32_t codes[6] = {0}, loads[3];\n'
        "    s_4_kg_calibrate(codes, loads);\n    return loads[0] == 1;\n}\n"
    )
    find_compilers()[0].run([*WARNINGS, str(tmp_path / "main.c"), "-o", str(tmp_path / "main")])
    with (tmp_path / "c.toml").open("rb") as file:
        assert set(tomllib.load(file)["outputs"]) == {name.removeprefix("ref_") for name in odd}


def test_damaged_codes_are_not_applied(tmp_path):
    codes, loads, _ = make()
    write(tmp_path / "a.csv", codes, loads)
    lines = (tmp_path / "a.csv").read_text().splitlines()
    lines[9] = lines[9].replace(lines[9].split(",")[3], "")
    (tmp_path / "b.csv").write_text("\n".join(lines) + "\n")
    with pytest.raises(InputError, match=r"b\.csv:10: column 'adc_3' is empty"):
        run("a.csv", "--apply", "b.csv", "--out", "logs", directory=tmp_path)
    assert not (tmp_path / "logs").exists()


def test_squares_are_not_written_to_a_header(tmp_path):
    codes, loads, _ = make()
    write(tmp_path / "a.csv", codes, loads)
    with pytest.raises(InputError, match="holds the plain matrix only"):
        run("a.csv", "--squares", "--write", "c.h", directory=tmp_path)


def test_page_names_every_option_and_refusal():
    page = (Path(__file__).resolve().parents[2] / "docs/how-to/calibrate.md").read_text("utf-8")
    options = [name for option in command.params for name in option.opts if name.startswith("--")]
    assert len(options) > 8
    assert [name for name in options if f"`{name}" not in page] == []
