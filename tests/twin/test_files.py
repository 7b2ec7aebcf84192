"""What is written: logs that the reader takes, a config with its part, the truth apart."""

import ast
import json
import re
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

import zerodrift_lab.twin as twin
from zerodrift.base.config import load_config
from zerodrift.base.errors import InputError
from zerodrift.base.records import render_sealed
from zerodrift.dataset.load import load_dataset
from zerodrift_lab.commands.twin import command, split_list
from zerodrift_lab.twin import (
    EffectChoice,
    Recipe,
    parse_choice,
    simulate,
    to_config,
    to_dataset,
    write_logs,
)
from zerodrift_lab.twin.example import ensure_example_logs
from zerodrift_lab.twin.logs import render_project
from zerodrift_lab.twin.recipe import EFFECTS, check_recipe, expand_channels
from zerodrift_lab.twin.stimuli import KINDS

REPOSITORY = Path(__file__).resolve().parents[2]

RECIPE = Recipe(
    seed=4,
    train=("chamber", "chamber"),
    test=("heating",),
    duration_s=900.0,
    hidden=(EffectChoice("thermal_lag", 2.0, {"tau_s": 61.0}), EffectChoice("beat")),
)


@pytest.fixture(scope="module")
def simulation():
    return simulate(RECIPE)


def test_files_are_the_same_bytes_for_the_same_recipe(simulation):
    assert render_project(simulation) == render_project(simulate(RECIPE))


def test_written_logs_read_back_as_the_runs_in_memory(simulation, tmp_path):
    write_logs(simulation, tmp_path)
    config = load_config(tmp_path)
    read, made = load_dataset(config), to_dataset(simulation, tmp_path)
    assert read.notes == ()
    for use in ("train", "test", "dwell"):
        for a, b in zip(getattr(read, use), getattr(made, use), strict=True):
            assert (a.name, a.group, a.source) == (b.name, b.group, b.source)
            np.testing.assert_array_equal(a.time_s, b.time_s)
            np.testing.assert_array_equal(a.temperature_degC, b.temperature_degC)
            np.testing.assert_array_equal(a.measured, b.measured)
            np.testing.assert_array_equal(a.reference, b.reference)
            assert a.inputs.keys() == b.inputs.keys()
            for channel in a.inputs:
                np.testing.assert_array_equal(a.inputs[channel], b.inputs[channel])
    assert (read.outputs, read.units, read.full_scale) == (
        made.outputs,
        made.units,
        made.full_scale,
    )
    assert to_config(simulation, tmp_path) == config


def test_config_lists_told_effects_only(simulation, tmp_path):
    config = to_config(simulation, tmp_path)
    assert [effect.kind for effect in config.effects] == ["zero_tempco", "dark_current"]
    assert config.sample_period_s == 1.0


def test_truth_is_in_its_own_file_alone(simulation):
    files = render_project(simulation)
    truth = json.loads(files.pop("truth.json"))
    assert truth["effects"]["thermal_lag"] == {
        "role": "hidden",
        "in_catalogue": True,
        "parameters": {"tau_s": 61.0},
        "size": pytest.approx(2.0),
    }
    assert truth["effects"]["beat"]["in_catalogue"] is False
    assert set(truth["effects"]["zero_tempco"]["coefficients"]) == {
        "Fx", "Fy", "Fz", "Mx", "My", "Mz",
    }  # fmt: skip
    for content in files.values():
        text = content.decode()
        assert "thermal_lag" not in text
        assert "beat" not in text
    logs = [content.decode() for name, content in files.items() if name.startswith("logs/")]
    allowed = {"time_s", "temperature_degC", "supply_V", "humidity_pct", "ambient_light_lux"}
    allowed |= {"ax_mps2", "ay_mps2", "az_mps2", "clock_s"}
    outputs = {"Fx_N", "Fy_N", "Fz_N", "Mx_Nm", "My_Nm", "Mz_Nm"}
    allowed |= outputs | {f"ref_{name}" for name in outputs}
    assert all(set(text.split("\n", 1)[0].split(",")) == allowed for text in logs)


def test_everything_written_says_that_it_is_simulated(simulation):
    files = render_project(simulation)
    assert "SIMULATED" in files["zerodrift.toml"].decode()
    assert "No sensor was measured" in files["README.md"].decode()
    assert json.loads(files["truth.json"])["simulated"] is True


def test_missing_channel_is_in_no_log_and_not_in_the_config():
    recipe = Recipe(
        train=("chamber",),
        dwell=False,
        duration_s=600.0,
        hidden=(EffectChoice("humidity"),),
        channels=("supply", "body_temperature"),
    )
    made = simulate(recipe)
    assert set(to_config(made).inputs) == {"supply", "body_temperature"}
    header = render_project(made)["logs/chamber_1.csv"].decode().split("\n", 1)[0]
    assert header.endswith("supply_V,t_body_degC")


def test_writing_never_overwrites_unasked(simulation, tmp_path):
    (tmp_path / "zerodrift.toml").write_text("mine")
    with pytest.raises(InputError, match="exists already"):
        write_logs(simulation, tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["zerodrift.toml"]
    with pytest.raises(InputError, match=r"zerodrift\.toml: was not written by"):
        write_logs(simulation, tmp_path, overwrite=True)
    assert (tmp_path / "zerodrift.toml").read_text() == "mine"


@pytest.mark.parametrize("name", ["logs/chamber_1.csv", "README.md", "truth.json"])
def test_force_replaces_a_simulation_and_no_file_of_the_users(simulation, tmp_path, name):
    (tmp_path / name).parent.mkdir(exist_ok=True)
    (tmp_path / name).write_text("{}")
    assert name in render_project(simulation)
    with pytest.raises(InputError, match="was not written by"):
        write_logs(simulation, tmp_path, overwrite=True)
    assert (tmp_path / name).read_text() == "{}"
    (tmp_path / name).unlink()
    written = write_logs(simulation, tmp_path)
    assert write_logs(simulation, tmp_path, overwrite=True) == written


def test_force_after_a_kill_takes_the_remainder_for_no_log(simulation, tmp_path):
    write_logs(simulation, tmp_path)
    (tmp_path / "logs" / ".0123456789ab.0.zd-new").write_text("")
    state = tmp_path / "build" / ".zerodrift"
    state.mkdir(parents=True)
    step = {"path": "logs/a.csv", "new": "logs/.0123456789ab.0.zd-new", "old": ""}
    step |= {"new_sha256": "0", "old_sha256": ""}
    record = {"format": 1, "steps": [step], "made": [], "durable": True}
    (state / "0123456789ab.begin").write_bytes(render_sealed(record))
    write_logs(simulation, tmp_path, overwrite=True)
    assert not list(tmp_path.rglob("*.zd-new")) and not state.exists()


def test_writing_refuses_logs_that_the_globs_would_mix_in(simulation, tmp_path):
    (tmp_path / "logs").mkdir()
    (tmp_path / "logs" / "chamber_9.csv").write_text("time_s\n")
    with pytest.raises(InputError, match=r"chamber_9\.csv: is not of this simulation"):
        write_logs(simulation, tmp_path, overwrite=True)
    assert not (tmp_path / "zerodrift.toml").exists()


def test_writing_below_a_file_is_refused_without_a_trace(simulation, tmp_path):
    (tmp_path / "taken").write_text("x")
    with pytest.raises(InputError, match="cannot be written"):
        write_logs(simulation, tmp_path / "taken" / "project")
    assert [path.name for path in tmp_path.iterdir()] == ["taken"]


def test_command_tells_nothing_of_what_is_hidden(tmp_path):
    arguments = ["-C", str(tmp_path / "p"), "--runs", "1", "--duration", "600", "--test", "none"]
    arguments += ["--hidden", "ageing=1.5", "--missing", "acceleration", "--seed", "9", "--json"]
    result = CliRunner().invoke(command, arguments, catch_exceptions=False)
    assert result.exit_code == 0
    summary = json.loads(result.output)
    assert summary["simulated"] is True
    assert summary["runs"] == {"chamber_1": "train", "dwell": "dwell"}
    assert "ageing" not in result.output
    assert sorted(summary["files"]) == sorted(
        ["logs/chamber_1.csv", "logs/dwell.csv", "README.md", "truth.json", "zerodrift.toml"]
    )
    assert "acceleration_x" not in load_config(tmp_path / "p").inputs
    assert json.loads((tmp_path / "p" / "truth.json").read_text())["recipe"]["seed"] == 9


def test_command_mystery_hides_something_unnamed(tmp_path):
    arguments = ["-C", str(tmp_path), "--runs", "1", "--duration", "600", "--test", "none"]
    result = CliRunner().invoke(command, [*arguments, "--mystery", "1"], catch_exceptions=False)
    assert result.exit_code == 0
    truth = json.loads((tmp_path / "truth.json").read_text())
    hidden = [name for name, told in truth["effects"].items() if told["role"] == "hidden"]
    assert len(hidden) == 1
    assert hidden[0] not in result.output


def test_command_lists_every_effect():
    result = CliRunner().invoke(command, ["--list"], catch_exceptions=False)
    assert all(name in result.output for name in EFFECTS)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--hidden", "creap"], "did you mean 'creep'"),
        (["--still", "weather"], "known are load"),
        (["--missing", "windspeed"], "no channel 'windspeed'"),
        (["--kinds", ""], "names no kind of run"),
    ],
)
def test_command_refuses_what_it_does_not_know_and_writes_nothing(arguments, message, tmp_path):
    with pytest.raises(InputError) as caught:
        CliRunner().invoke(command, ["-C", str(tmp_path / "p"), *arguments], catch_exceptions=False)
    assert message in str(caught.value)
    assert not (tmp_path / "p").exists()


def test_example_logs_are_written_once_and_are_small(tmp_path):
    bundled = REPOSITORY / "examples" / "ft40"
    for name in ("zerodrift.toml", "twin.json"):
        (tmp_path / name).write_bytes((bundled / name).read_bytes())
    assert ensure_example_logs(tmp_path) is True
    assert ensure_example_logs(tmp_path) is False
    logs = sorted((tmp_path / "logs").iterdir())
    assert sum(path.stat().st_size for path in logs) < 6_000_000
    dataset = load_dataset(load_config(tmp_path))
    assert (len(dataset.train), len(dataset.test), len(dataset.dwell)) == (6, 4, 1)
    first_log = tmp_path / "logs" / "chamber_1.csv"
    before = first_log.read_bytes()
    first_log.unlink()
    assert ensure_example_logs(tmp_path) is True
    assert first_log.read_bytes() == before


def test_example_logs_follow_their_recipe(tmp_path):
    recipe = {"seed": 1, "train": ["heating"], "dwell": False}
    (tmp_path / "twin.json").write_text(json.dumps(recipe))
    assert ensure_example_logs(tmp_path) is True
    before = (tmp_path / "logs" / "heating_1.csv").read_bytes()
    (tmp_path / "twin.json").write_text(json.dumps({**recipe, "seed": 2}))
    assert ensure_example_logs(tmp_path) is True
    assert (tmp_path / "logs" / "heating_1.csv").read_bytes() != before
    assert ensure_example_logs(tmp_path) is False


def test_example_logs_are_left_to_users_who_have_no_recipe(tmp_path):
    assert ensure_example_logs(tmp_path) is False
    assert list(tmp_path.iterdir()) == []


def test_broken_example_recipe_is_refused_with_its_line(tmp_path):
    (tmp_path / "twin.json").write_text('{\n "seed": ,\n}')
    with pytest.raises(InputError, match=r"twin\.json:2: not JSON"):
        ensure_example_logs(tmp_path)


def test_generator_shares_no_code_with_what_fits_models():
    allowed = {
        "zerodrift.base.errors",
        "zerodrift.base.config",
        "zerodrift.dataset.runs",
        "zerodrift.base.journal",
    }
    folder = Path(twin.__file__).parent
    modules = sorted(folder.rglob("*.py"))
    assert len(modules) > 10
    for module in modules:
        for node in ast.walk(ast.parse(module.read_text())):
            names = []
            if isinstance(node, ast.ImportFrom):
                names = [node.module or ""]
            elif isinstance(node, ast.Import):
                names = [alias.name for alias in node.names]
            for name in names:
                if name.split(".")[0] == "zerodrift":
                    own = name.startswith("zerodrift_lab.twin.")
                    assert own or name in allowed, f"{module.name} imports {name}"


def test_reference_page_names_every_option_effect_and_kind():
    page = (REPOSITORY / "docs" / "reference" / "twin.md").read_text(encoding="utf-8")
    options = [name for option in command.params for name in option.opts if name.startswith("--")]
    assert len(options) > 15
    missing = [name for name in (*options, *EFFECTS, *KINDS) if f"`{name}" not in page]
    assert [name for name in missing if name not in ("--out", "--json", "--force")] == []


def test_practice_page_uses_options_and_effects_that_exist():
    page = (REPOSITORY / "docs" / "how-to" / "practise-on-the-twin.md").read_text(encoding="utf-8")
    lines = re.findall(r"zerodrift twin ([^`\n]+)", page)
    assert len(lines) > 6
    for line in lines:
        values = command.make_context("twin", line.split()).params
        hidden = tuple(parse_choice(text) for text in values["hidden"])
        check_recipe(Recipe(hidden=hidden))
        expand_channels(split_list(values["missing"]))
