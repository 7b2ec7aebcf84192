"""From logs to checked C: the whole road, its promises, and what happens when it goes wrong."""

import json
import re
import shutil
from pathlib import Path

import numpy as np
import pytest
from tests.main_job.conftest import invoke, write_project

from zerodrift.base.config import load_config
from zerodrift.base.errors import CheckError
from zerodrift.cli.firmware import explain_worse_than_physics
from zerodrift.dataset.load import load_dataset
from zerodrift.export.compose import (
    describe_compensator,
    encode_inputs,
    measure_warm_up,
    predict_integer,
)
from zerodrift.export.integer_model import FLAG_TEMPERATURE_RANGE, FLAG_WARMING_UP
from zerodrift.export.model_files import load_model
from zerodrift.export.reference import Reference
from zerodrift.physics.catalogue import load_catalogue
from zerodrift.train.compensator import Compensator
from zerodrift.verify.errors_told import OutputError


def test_firmware_reports_equal_bits_and_errors_in_physical_units(project: Path) -> None:
    result = json.loads((project / "result.json").read_text())
    assert result["bit_exact"] is True
    assert result["vectors"] >= 100_000
    assert result["backends"][:2] == ["reference", "host"]
    assert result["backends"][-1] == "cortex-m4"
    assert 300 < result["instructions_per_step"]["cortex-m4"] < 20_000
    assert result["held_out"] is True
    for name in ("Fz", "Mx"):
        kinds = ("uncompensated", "physics", "float", "integer")
        rmse = {key: result["rmse"][key][name] for key in kinds}
        assert rmse["integer"] < rmse["physics"] < rmse["uncompensated"]
        assert result["rmse_integer_to_float"][name] < 0.002 * rmse["uncompensated"]
    assert 0 < result["ram_bytes"] < result["flash_bytes"] < 20_000
    assert 0 < result["stack_bytes"] < 2000
    for name in result["files"]:
        assert (project / name).is_file()


def test_network_that_hurts_on_held_out_runs_is_told() -> None:
    def err(name: str, physics: float | None) -> OutputError:
        return OutputError(name, "N", 100.0, 9.0, physics, 2.5, 2.5, 0.001, 0.0, 0.9)

    assert explain_worse_than_physics([err("Fx", 3.0), err("Fy", None)]) == ""
    told = explain_worse_than_physics([err("Fx", 3.0), err("Fz", 2.0)])
    assert "(Fz 2.5 against 2 N)" in told and 'kind = "none" under [network]' in told


def test_firmware_written_twice_gives_the_same_bytes(
    project: Path, logs: Path, tmp_path: Path
) -> None:
    again = write_project(tmp_path / "elsewhere" / "with spaces", logs, epochs=40)
    result = invoke("firmware", "-C", str(again))
    assert result.exit_code == 0
    assert "of it input temperature" in result.stdout
    assert "wrote firmware/: ft40.h, ft40.c," in result.stdout
    for path in sorted((project / "firmware").iterdir()):
        assert (again / "firmware" / path.name).read_bytes() == path.read_bytes(), path.name
    for name in ("model.json", "golden.npz", "network.onnx", "compensator.json"):
        assert (again / "build" / name).read_bytes() == (project / "build" / name).read_bytes()


def test_firmware_leaves_no_scratch_files(project: Path) -> None:
    left = [p.name for p in (*(project / "firmware").iterdir(), *(project / "build").iterdir())]
    assert not [name for name in left if name.startswith(".") or name.endswith(".part")]


def test_firmware_carries_hash_guard_and_no_date(project: Path) -> None:
    header = (project / "firmware" / "ft40.h").read_text()
    source = (project / "firmware" / "ft40.c").read_text()
    assert load_model(project / "build" / "model.json").hash in header
    assert "#error" in source and "ZD_RUNTIME_FORMAT" in source
    assert not re.search(r"\b20[0-9]{2}-[0-9]{2}|[0-9]{2}:[0-9]{2}:[0-9]{2}", header + source)
    assert "float" not in re.sub(r"/\*.*?\*/", "", source, flags=re.S)
    assert "malloc" not in source and "<math.h>" not in source


@pytest.mark.spread(
    2,
    ("memory", "form", "weights"),
    [
        ("10", "reset_before", "int16"),
        ('"stream"', "reset_before", "int8"),
        ("4", "reset_after", "int8"),
    ],
)
def test_firmware_is_bit_exact_for_every_form(
    memory: str, form: str, weights: str, logs: Path, tmp_path: Path
) -> None:
    directory = write_project(tmp_path / "p", logs, memory, form, weights)
    result = invoke("firmware", "-C", str(directory), "--json", "--force")  # hardly trained
    assert result.exit_code == 0, result.output
    assert json.loads(result.stdout)["bit_exact"] is True
    layer = load_model(directory / "build" / "model.json").recurrent
    if layer is not None:  # training may find that the network does not carry over
        assert layer.gru.reset == form.removeprefix("reset_")
        assert layer.gru.w_h.dtype == np.dtype(weights)
        assert layer.window == (0 if memory == '"stream"' else int(memory))


def test_firmware_without_network_is_physics_alone(logs: Path, tmp_path: Path) -> None:
    directory = write_project(tmp_path / "p", logs)
    toml = directory / "zerodrift.toml"
    toml.write_text(re.sub(r"\[network\][^\[]*", "", toml.read_text()))
    result = invoke("firmware", "-C", str(directory), "--json")
    assert result.exit_code == 0, result.output
    assert load_model(directory / "build" / "model.json").recurrent is None


def test_integer_model_follows_the_float_model(project: Path) -> None:
    config = load_config(project)
    dataset = load_dataset(config)
    compensator = Compensator.load(project / "build")
    model = load_model(project / "build" / "model.json")
    run = dataset.test[0]
    difference = predict_integer(model, run) - compensator.predict(run)
    share = np.sqrt((difference**2).mean(axis=0)) / compensator.predict(run).std(axis=0)
    assert (share < 0.002).all(), share


def test_guards_flag_cold_start_and_temperatures_beyond_calibration(project: Path) -> None:
    dataset = load_dataset(load_config(project))
    model = load_model(project / "build" / "model.json")
    codes = encode_inputs(model, dataset.train[0])[None, :50]
    cold = Reference(model).run(codes, settled=False).flags[0]
    assert ((cold & FLAG_WARMING_UP) > 0).sum() == min(model.guards.warm_up_steps, 50)
    settled = Reference(model).run(codes, settled=True).flags[0]
    assert not (settled & FLAG_WARMING_UP).any()
    hot = np.full((1, 1, len(model.channels)), 32767, dtype=np.int16)
    assert Reference(model).run(hot).flags[0, 0] & FLAG_TEMPERATURE_RANGE
    assert measure_warm_up(model, dataset.train) == model.guards.warm_up_steps


def test_verify_passes_on_what_firmware_wrote(project: Path) -> None:
    result = invoke("verify", "-C", str(project), "--json")
    assert result.exit_code == 0, result.output
    assert json.loads(result.stdout)["bit_exact"] is True


def test_verify_names_step_and_values_when_the_c_was_edited(project: Path, tmp_path: Path) -> None:
    copy = tmp_path / "copy"
    shutil.copytree(project, copy)
    source = copy / "firmware" / "ft40.c"
    text = source.read_text()
    edited = re.sub(r"(INT64_C\()(-?\d+)(\) \+ \(\(int64_t\))", _add_one_unit, text, count=1)
    assert edited != text
    source.write_text(edited)
    result = invoke("verify", "-C", str(copy), "--trust")
    assert isinstance(result.exception, CheckError)
    assert result.exit_code == 1
    message = str(result.exception)
    assert "step 0" in message and "expected" in message and "actual" in message
    assert "0x" in message and " N" in message


def _add_one_unit(match: re.Match[str]) -> str:
    return f"{match[1]}{int(match[2]) + 2**40}{match[3]}"


def test_verify_before_firmware_says_what_to_run(logs: Path, tmp_path: Path) -> None:
    directory = write_project(tmp_path / "p", logs)
    result = invoke("verify", "-C", str(directory))
    assert result.exit_code == 2
    assert "zerodrift firmware" in str(result.exception)


def test_export_writes_a_proven_model(project: Path, tmp_path: Path) -> None:
    copy = tmp_path / "copy"
    shutil.copytree(project, copy)
    (copy / "build" / "model.json").unlink()
    result = invoke("export", "-C", str(copy), "--json")
    assert result.exit_code == 0, result.output
    body = json.loads(result.stdout)
    assert body["bounds_proven"] > 0
    assert load_model(copy / "build" / "model.json").hash == body["model_hash"]


def share_of_quantization(directory: Path) -> float:
    """Return the RMS of integer less float over that of the drift, on a log that was calibrated."""
    config = load_config(directory)
    compensator = Compensator.load(directory / "build", load_catalogue(config.plugin_files))
    runs = load_dataset(config).train
    run = runs[0]  # the test run is hotter, and the correction limited there
    wanted = describe_compensator(compensator, config, runs).predict_on_chip(run)
    error = predict_integer(load_model(directory / "build" / "model.json"), run) - wanted
    return float(np.sqrt((error**2).mean(axis=0) / (wanted**2).mean(axis=0)).max())


@pytest.mark.long
def test_firmware_with_five_effects_and_a_network(logs: Path, tmp_path: Path) -> None:
    directory = write_project(tmp_path / "p", logs)
    toml = directory / "zerodrift.toml"
    kinds = ("dark_current", "thermal_lag", "span_tempco", "warm_up")
    tables = "".join(f'[[effect]]\nkind = "{kind}"\n\n' for kind in kinds)
    toml.write_text(toml.read_text().replace("[network]", f"{tables}[network]"))
    result = invoke("firmware", "-C", str(directory), "--json")
    assert result.exit_code == 0, result.output
    assert json.loads(result.stdout)["bit_exact"] is True
    model = load_model(directory / "build" / "model.json")
    assert {"exp2", "lowpass", "load", "counter"} <= {node.kind for node in model.nodes}
    header = (directory / "firmware" / "ft40.h").read_text()
    assert "int32_t measured_fz; /* measured_Fz: " in header
    assert share_of_quantization(directory) < 1e-3


USER_EFFECT = """
from zerodrift.physics.catalogue import register
from zerodrift.physics.effect import Effect, Feature


def build(ops, signals, p):
    rise = ops.affine(signals.temperature_degC, 0.1, -2.5)
    slack = ops.difference(ops.play(rise, 0.4), ops.delay(rise, {delay_s}))
    glow = ops.exp2(ops.clip(ops.lowpass(rise, 30.0), -2.0, 2.0))
    age = ops.power(ops.affine(signals.elapsed_s, 0.001, 0.0), 0.37)
    mixed = ops.total(ops.product(glow, age), ops.affine(ops.power(rise, 3), 0.01, 0.0))
    return [Feature("slack", slack), Feature("mixed", mixed)]


register(Effect(kind="own", title="an effect of everything there is", build=build))
"""


def write_user_effect(directory: Path, delay_s: float) -> None:
    """Add an effect from a file to a project, beside dark current, and take its network away."""
    toml = directory / "zerodrift.toml"
    text = re.sub(r"\[network\][^\[]*", "", toml.read_text())
    effects = '\n[[effect]]\nkind = "dark_current"\n\n[[effect]]\nkind = "own"\n'
    toml.write_text(text + effects + '\n[plugins]\nfiles = ["own.py"]\n')
    (directory / "own.py").write_text(USER_EFFECT.replace("{delay_s}", str(delay_s)))


@pytest.mark.long
def test_effect_of_a_user_goes_to_c(logs: Path, tmp_path: Path) -> None:
    directory = write_project(tmp_path / "p", logs)
    write_user_effect(directory, 2.3)
    result = invoke("firmware", "-C", str(directory), "--json")
    assert result.exit_code == 0, result.output
    assert json.loads(result.stdout)["bit_exact"] is True
    model = load_model(directory / "build" / "model.json")
    kinds = {node.kind for node in model.nodes}
    assert {"play", "delay", "exp2", "clip", "power", "counter", "product"} <= kinds
    assert share_of_quantization(directory) < 1e-4
    assert invoke("verify", "-C", str(directory)).exit_code == 0


def test_effect_that_cannot_go_to_c_is_refused(logs: Path, tmp_path: Path) -> None:
    directory = write_project(tmp_path / "p", logs)
    write_user_effect(directory, 40_000.0)
    result = invoke("firmware", "-C", str(directory))
    assert result.exit_code == 1
    message = str(result.exception)
    assert "feature 'own: slack'" in message
    assert "a delay of 40000 s is 40000 steps" in message and "shorter delay" in message
    assert not (directory / "firmware").exists()


def test_firmware_on_a_bad_log_writes_nothing(logs: Path, tmp_path: Path) -> None:
    directory = write_project(tmp_path / "p", logs)
    log = directory / "logs" / "train_2.csv"
    lines = log.read_text().splitlines(keepends=True)
    cells = lines[100].split(",")
    column = lines[0].strip().split(",").index("temperature_degC")
    cells[column] = "-256"
    lines[100] = ",".join(cells)
    log.write_text("".join(lines))
    before = sorted(path.name for path in directory.rglob("*"))
    result = invoke("firmware", "-C", str(directory))
    assert result.exit_code == 2
    assert "train_2.csv:101" in str(result.exception)
    assert "-256" in str(result.exception)
    assert sorted(path.name for path in directory.rglob("*")) == before
