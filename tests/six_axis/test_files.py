"""Files of the six-axis twin: read back as the runs in memory; CAN frames decode by both DBCs."""

import dataclasses
import json
import re
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from tests.golden.vectors import load

from zerodrift.base.config import load_config
from zerodrift.base.errors import InputError
from zerodrift.codegen.application import render_dbc as generate_dbc
from zerodrift.dataset.load import load_dataset
from zerodrift.export.compose import choose_lsb_per_unit
from zerodrift.export.integer_model import OutputFormat
from zerodrift_lab.commands.twin import command
from zerodrift_lab.twin.sensor import FULL_SCALE, OUTPUTS, UNITS
from zerodrift_lab.twin.six_axis import (
    CHANNELS,
    draw_sensor,
    load_protocol,
    parse_protocol,
    record,
    to_config,
    to_dataset,
)
from zerodrift_lab.twin.six_axis.can import COUNTS_PER_UNIT, render_candump, render_dbc
from zerodrift_lab.twin.six_axis.files import Campaign, render_files

SHORT = "room 22 degC\nwait 60 s\nair 40 degC over 200 s\nload Fz 150 N\nwait 300 s\n"


def decode(run, dbc, folder):
    """Return the signals [n] of a run's frames by (message, signal), as a CAN tool reads them."""
    can, cantools = pytest.importorskip("can"), pytest.importorskip("cantools")
    (folder / "run.log").write_text(render_candump(run))
    database = cantools.database.load_string(dbc, "dbc")
    known = {message.frame_id: message.name for message in database.messages}
    with can.CanutilsLogReader(folder / "run.log") as reader:
        messages = list(reader)
    assert len(messages) == 8 * run.time_s.size
    assert np.all(np.diff([message.timestamp for message in messages]) > 0)
    decoded = {}
    for message in messages:
        if message.arbitration_id in known:
            signals = database.decode_message(message.arbitration_id, message.data)
            for name, value in signals.items():
                decoded.setdefault((known[message.arbitration_id], name), []).append(value)
    return decoded


@pytest.fixture(scope="module")
def campaign():
    sensor = draw_sensor(3)
    protocol = parse_protocol(SHORT, "short.txt", "short")
    runs = [record(sensor, protocol, f"short_{k}", 1) for k in (1, 2)]
    test = record(sensor, protocol, "test_short_1", 1)
    dwell = record(sensor, load_protocol("dwell"), "dwell", 1)
    return Campaign(sensor, tuple(runs), (test,), (dwell,))


def test_written_logs_read_back_as_the_runs_in_memory(campaign, tmp_path):
    for name, content in render_files(campaign, "force", CHANNELS).items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_bytes(content)
    config = load_config(tmp_path)
    read = load_dataset(config)
    options = {"channels": CHANNELS, "directory": tmp_path}
    made = to_dataset(campaign.train, campaign.test, campaign.dwell, **options)
    assert to_config(campaign.train, campaign.test, campaign.dwell, **options) == config
    assert read.notes == ()
    for use in ("train", "test", "dwell"):
        for a, b in zip(getattr(read, use), getattr(made, use), strict=True):
            assert (a.name, a.group, a.source) == (b.name, b.group, b.source)
            for field in ("time_s", "temperature_degC", "measured", "reference"):
                np.testing.assert_array_equal(getattr(a, field), getattr(b, field))
            assert set(a.inputs) == set(b.inputs) == set(CHANNELS)
            for channel in CHANNELS:
                np.testing.assert_array_equal(a.inputs[channel], b.inputs[channel])
    assert (read.outputs, read.units, read.full_scale) == (
        made.outputs,
        made.units,
        made.full_scale,
    )


def test_truth_is_complete_and_everything_says_simulated(campaign):
    files = render_files(campaign)
    truth = json.loads(files["truth.json"])
    assert truth["simulated"] is True
    assert np.array(truth["calibration"]).shape == (6, 6)
    assert [run["name"] for run in truth["runs"]] == [run.name for run in campaign.runs]
    assert set(truth["runs"][0]["noise_floor"]) == set(OUTPUTS)
    assert "SIMULATED" in files["zerodrift.toml"].decode()
    assert "No sensor was measured" in files["README.md"].decode()


def test_converter_level_holds_codes_and_references_and_no_forces(campaign):
    files = render_files(campaign, "adc")
    header, first = files["adc/short_1.csv"].decode().splitlines()[:2]
    names = header.split(",")
    assert [name for name in names if name.startswith("adc_")] == [f"adc_{k}" for k in range(1, 7)]
    assert "Fz_N" not in names
    assert "ref_Fz_N" in names
    codes = first.split(",")[names.index("adc_1") : names.index("adc_6") + 1]
    assert codes == [str(code) for code in campaign.train[0].adc[0]]


def check_outputs(decoded, run):
    for k, output in enumerate(OUTPUTS):
        raw = np.array(decoded[f"{output.upper()}_MEASURED", "Raw"])
        np.testing.assert_allclose(raw, run.measured[:, k], atol=0.51 / COUNTS_PER_UNIT[k])
        assert set(decoded[f"{output.upper()}_MEASURED", "Drift"]) == {0}


def test_can_frames_decode_by_the_sensors_own_dbc(campaign, tmp_path):
    run = campaign.train[0]
    decoded = decode(run, render_dbc(), tmp_path)
    check_outputs(decoded, run)
    codes = [decoded[f"CODES_{1 + (k > 4)}", f"Adc{k}"] for k in range(1, 7)]
    np.testing.assert_array_equal(np.array(codes).T, run.adc)
    shown = np.array(decoded["CODES_2", "Temperature"])
    np.testing.assert_allclose(shown, run.temperature_degC, atol=1e-4)
    assert decoded["CODES_2", "Counter"][:3] == [0, 1, 2]


def test_can_frames_decode_by_the_dbc_of_a_generated_package(campaign, tmp_path):
    """Identifiers, names, layout and scale are those that `codegen` writes for this sensor."""
    outputs = tuple(
        OutputFormat(name, unit, choose_lsb_per_unit(full_scale), full_scale)
        for name, unit, full_scale in zip(OUTPUTS, UNITS, FULL_SCALE.tolist(), strict=True)
    )
    assert [output.lsb_per_unit for output in outputs] == COUNTS_PER_UNIT.tolist()
    dbc = generate_dbc(dataclasses.replace(load("front_end").model, outputs=outputs))
    run = campaign.train[0]
    check_outputs(decode(run, dbc, tmp_path), run)


def run_command(*arguments):
    return CliRunner().invoke(command, [str(a) for a in arguments], catch_exceptions=False)


def test_command_writes_the_same_layout_and_bytes_twice(tmp_path):
    (tmp_path / "mine.txt").write_text(SHORT)
    options = ["--six-axis", "--sensor", 4, "--protocol", tmp_path / "mine.txt", "--runs", 2]
    options += ["--protocol", "heating", "--test", "cooling", "--seed", 5]
    texts = []
    for place in ("a", "b"):
        result = run_command("-C", tmp_path / place, *options)
        assert result.exit_code == 0, result.output
        names = sorted(
            p.relative_to(tmp_path / place).as_posix()
            for p in (tmp_path / place).rglob("*")
            if p.is_file()
        )
        texts.append([(name, (tmp_path / place / name).read_bytes()) for name in names])
    assert texts[0] == texts[1]
    assert [name for name, _ in texts[0]] == [
        "README.md",
        "logs/dwell.csv",
        "logs/heating_1.csv",
        "logs/mine_1.csv",
        "logs/test_cooling_1.csv",
        "truth.json",
        "zerodrift.toml",
    ]
    assert load_dataset(load_config(tmp_path / "a")).notes == ()
    with pytest.raises(InputError, match="exists already"):
        run_command("-C", tmp_path / "a", *options)


def test_command_tells_json_and_hides_hidden_effects(tmp_path):
    result = run_command(
        "-C", tmp_path, "--six-axis", "--protocol", "heating", "--test", "none",
        "--hidden", "creep=3", "--json",
    )  # fmt: skip
    told = json.loads(result.stdout)
    assert told["simulated"] is True
    assert set(told["runs"]) == {"heating_1", "dwell"}
    assert "creep" not in result.stdout
    assert "creep" in (tmp_path / "truth.json").read_text()
    for path in [tmp_path / "zerodrift.toml", tmp_path / "README.md"]:
        assert "creep" not in path.read_text()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--six-axis", "--kinds", "chamber"], "--kinds is not an option of --six-axis"),
        (["--six-axis", "--mystery", "1"], "--mystery is not an option of --six-axis"),
        (["--six-axis", "--protocol", "nowhere"], "neither a file nor a bundled protocol"),
        (["--six-axis", "--test", "chambre"], "did you mean 'chamber'"),
        (["--six-axis", "--hidden", "creap"], "did you mean 'creep'"),
        (["--six-axis", "--period", "0"], "sample period is 0"),
        (["--six-axis", "--noise", "0"], "noise factor is 0"),
        (["--protocol", "chamber"], "--protocol belongs to the six-axis twin; add --six-axis"),
        (["--level", "adc"], "--level belongs to the six-axis twin"),
        (["--sensor", "3"], "--sensor belongs to the six-axis twin"),
    ],
)
def test_command_refuses_what_does_not_fit_and_writes_nothing(arguments, message, tmp_path):
    with pytest.raises(InputError, match=re.escape(message)):
        run_command("-C", tmp_path / "p", *arguments)
    assert not (tmp_path / "p").exists()


def test_listing_names_the_protocols():
    assert "chamber_loaded" in run_command("--list").output


def test_package_data_name_the_protocols():
    text = (Path(__file__).resolve().parents[2] / "lab/pyproject.toml").read_text()
    assert '"protocols/*.txt"' in text
