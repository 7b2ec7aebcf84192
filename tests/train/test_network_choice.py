"""`[network] kind = "auto"`: the rule, the table, and an ordinary compensator."""

import importlib.util
import json
from pathlib import Path

import pytest
from click.testing import CliRunner
from tests.gate.sensors import TESTS, TRAIN, write_sensor

from zerodrift.base.config import load_config
from zerodrift.base.errors import InputError
from zerodrift.cli.console import tabulate
from zerodrift.cli.main import cli
from zerodrift.dataset.load import load_dataset
from zerodrift.physics.catalogue import load_catalogue
from zerodrift.train.compensator import Compensator
from zerodrift.train.summary import NetworkChoice, TriedNetwork
from zerodrift.train.training import train, train_together
from zerodrift.verify import network_choice
from zerodrift.verify.network_choice import LEFT_OUT, choose, train_or_choose

FEW = (("none", 16), ("lag_bank", 16), ("gru", 4))


def test_the_cheapest_within_five_percent_is_taken() -> None:
    ratios = {"none": 1.0, "bank": 0.209, "small": 0.208, "large": 0.2}
    costs = {"none": (10, 5), "bank": (90, 9), "small": (90, 8), "large": (900, 1)}
    assert choose(ratios, costs) == "small", "of two with equal instructions the smaller one"
    assert choose(ratios | {"none": 0.21}, costs) == "none"
    assert choose(ratios | {"none": 0.2101}, costs) == "small"
    assert choose(ratios | {"large": 0.19}, costs) == "large"


@pytest.mark.skipif(importlib.util.find_spec("torch") is None, reason="networks need PyTorch")
@pytest.mark.spread(0, "tested", [False, True])
def test_auto_takes_what_remembers_where_the_sensor_lags(
    tested: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(network_choice, "CANDIDATES", FEW)
    runs = (*TRAIN, *TESTS) if tested else TRAIN
    config = load_config(write_sensor(tmp_path / "p", runs, network="auto", lag_s=60.0))
    dataset = load_dataset(config)
    config.build_directory.mkdir(parents=True)
    chosen = train_or_choose(config, dataset, epochs=2, starts=1)
    assert chosen.choice is not None
    table = {one.name: one for one in chosen.choice.tried}
    assert list(table) == ["none", "lag_bank", "gru 4"]
    none, bank = table["none"], table["lag_bank"]
    assert none.rmse_left_out is not None and bank.rmse_left_out is not None
    assert bank.rmse_left_out["p"] < 0.3 * none.rmse_left_out["p"]
    assert chosen.choice.taken == "lag_bank"
    assert bank.as_good and bank.times_best == 1.0 and not none.as_good
    assert none.instructions and bank.instructions and none.instructions < bank.instructions
    assert chosen.trained.compensator.bank is not None
    assert chosen.trained.scores.on_test_logs is tested, "test logs are told and decide nothing"
    assert none.why == bank.why == ""
    heads, rows = tabulate(chosen.choice)
    assert len(rows) == 3 and all(len(row) == 1 + len(heads) for row in rows)


def test_a_network_that_found_nothing_is_marked() -> None:
    none = TriedNetwork("none", {"p": 1.0}, 2.0, 10, 20, 3, as_good=False, why="")
    gru = TriedNetwork("gru 4", {"p": 0.5}, 1.0, 30, 40, 9, as_good=True, why=LEFT_OUT)
    choice = NetworkChoice("gru 4", (none, gru), {"p": "N"}, "cortex-m4", "")
    _, rows = tabulate(choice)
    assert [row[-1] for row in rows] == ["", "taken, left out"]


@pytest.mark.long
def test_commands_show_the_table_once_and_keep_the_result(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(network_choice, "CANDIDATES", FEW[:2])
    folder = write_sensor(tmp_path / "p", TRAIN, network="auto", lag_s=60.0)
    told = CliRunner().invoke(cli, ["train", "-C", str(folder), "--json"])
    assert told.exit_code == 0, told.output
    choice = json.loads(told.stdout)["choice"]
    assert choice["taken"] == "lag_bank"
    assert [one["name"] for one in choice["tried"]] == ["none", "lag_bank"]
    kept = Compensator.load(folder / "build")
    assert any("lag_bank taken" in note for note in kept.notes)
    again = CliRunner().invoke(cli, ["firmware", "-C", str(folder)])
    assert again.exit_code == 0, again.output
    assert "not repeated" in again.output
    shown = CliRunner().invoke(cli, ["train", "-C", str(folder)])
    assert "times the best" in shown.output and "taken" in shown.output


def test_a_candidate_that_cannot_be_trained_is_told_and_passed_over(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(network_choice, "CANDIDATES", (("none", 16), ("gru", 4)))

    def refuse(extra: str, what: str) -> None:
        raise InputError(f"{what} needs PyTorch")

    monkeypatch.setattr("zerodrift.train.prepare.require", refuse)
    config = load_config(write_sensor(tmp_path / "p", TRAIN, network="auto"))
    chosen = train_or_choose(config, load_dataset(config))
    assert chosen.choice is not None and chosen.choice.taken == "none"
    assert "needs PyTorch" in chosen.choice.tried[1].why


@pytest.mark.parametrize("key", ["hidden = 8", "memory = 10", "lags_s = [30.0]"])
def test_keys_that_auto_chooses_are_refused(key: str, tmp_path: Path) -> None:
    folder = write_sensor(tmp_path / "p", TRAIN, network="auto")
    toml = folder / "zerodrift.toml"
    toml.write_text(toml.read_text() + key + "\n")
    with pytest.raises(InputError, match="leave `" + key.split(maxsplit=1)[0]):
        load_config(folder)


def test_many_sensors_need_a_kind_by_name(tmp_path: Path) -> None:
    config = load_config(write_sensor(tmp_path / "p", TRAIN, network="auto"))
    dataset = load_dataset(config)
    (answer,) = train_together([(config, dataset)], load_catalogue(()))
    assert isinstance(answer, InputError) and "chooses for one sensor" in str(answer)
    with pytest.raises(InputError, match="chooses for one sensor"):
        train(config, dataset)
