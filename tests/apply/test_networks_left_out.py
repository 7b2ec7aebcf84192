"""A network's uncertainty comes from networks that were trained again without some of the runs."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner, Result
from tests.gate.sensors import TESTS, TRAIN, write_sensor

from zerodrift.base.config import NetworkConfig, load_config
from zerodrift.base.errors import InputError
from zerodrift.base.records import from_json, read_sealed
from zerodrift.cli.main import cli
from zerodrift.dataset.load import load_dataset
from zerodrift.dataset.runs import Dataset
from zerodrift.train import network_training, refits
from zerodrift.train.compensator import Compensator, TrainedAs
from zerodrift.train.prepare import Handling
from zerodrift.train.refits import MOST_PARTS, Original, find_network, split_parts
from zerodrift.train.training import train
from zerodrift.verify.left_out import LeftOut, leave_out, leave_out_together
from zerodrift.verify.uncertainty import Uncertainty

pytestmark = pytest.mark.long

SMALL = "hidden = 4\nepochs = 12\nstarts = 1\n"


def invoke(*arguments: object) -> Result:
    return CliRunner().invoke(cli, [*map(str, arguments)])


def write_network(folder: Path, kind: str = "gru") -> Path:
    project = write_sensor(folder, (*TRAIN, *TESTS), network=kind, lag_s=40.0)
    toml = project / "zerodrift.toml"
    head, tail = toml.read_text().split(f'kind = "{kind}"\n', 1)
    toml.write_text(f'{head}kind = "{kind}"\n{SMALL}{tail}')
    return project


@pytest.fixture(scope="module")
def project(tmp_path_factory: pytest.TempPathFactory) -> Path:
    project = write_network(tmp_path_factory.mktemp("network") / "p")
    result = invoke("firmware", "-C", project, "--json")
    assert result.exit_code == 0, (result.output, result.exception)
    return project


@pytest.fixture(scope="module")
def original(project: Path) -> Original:
    config = load_config(project)
    return Original(config, load_dataset(config), Compensator.load(project / "build"))


def ask(original: Original) -> LeftOut:
    (found,) = leave_out_together([original], Handling())
    assert isinstance(found, LeftOut), found
    return found


def test_an_understudy_does_not_know_the_run_that_it_judges(original: Original) -> None:
    """A left-out run may hold anything: what is said of it stays; what is said of others moves."""
    assert original.compensator.network is not None
    found = ask(original)
    first, *rest = original.dataset.train
    strange = replace(first, measured=first.measured + 5.0 * np.sin(np.arange(len(first)))[:, None])
    other = ask(replace(original, dataset=replace(original.dataset, train=(strange, *rest))))
    assert np.array_equal(found.floating[0], other.floating[0])
    for a, b in zip(found.floating[1:], other.floating[1:], strict=True):
        assert not np.array_equal(a, b)


def test_it_is_trained_as_the_whole_one_was(
    original: Original, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without the first run it is the network that `train` makes of the others' logs alone."""
    config, dataset, whole = original.config, original.dataset, original.compensator
    assert whole.trained_as == TrainedAs(start=0, epochs=12)
    monkeypatch.setattr(network_training, "WORTH_ITS_FLASH", 10.0)
    others = Dataset(dataset.train[1:], dataset.test, (), *names_of(dataset))
    alone = train(config, others).compensator
    assert alone.trained_as == whole.trained_as
    (said,) = alone.predict_all(dataset.train[:1])
    assert np.allclose(ask(original).floating[0], said, rtol=0.0, atol=1e-4 * np.ptp(said))


def names_of(dataset: Dataset) -> tuple[tuple[str, ...], tuple[str, ...], tuple[float, ...]]:
    return dataset.outputs, dataset.units, dataset.full_scale


def test_apply_and_compare_state_it(project: Path, tmp_path: Path) -> None:
    kept = from_json(Uncertainty, read_sealed((project / "build/uncertainty.json").read_bytes()))
    assert kept.method == "leave one run out"
    one = kept.outputs["p"]
    assert one.noise > 0.0 and one.parameters > 0.0 and one.rounding > 0.0
    assert one.covered is not None and one.covered_readings > 100
    log = project / f"{TESTS[0].name}.csv"
    told = invoke("apply", log, "-C", project, "--out", tmp_path / "o.csv", "--json")
    stated = json.loads(told.stdout)["uncertainty"]["p"]
    assert (
        stated == json.loads(invoke("compare", "-C", project, "--json").stdout)["uncertainty"]["p"]
    )


def test_a_second_firmware_trains_nothing_again(
    project: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    own = Path(shutil.copytree(project, tmp_path / "p"))
    before = (own / "build/uncertainty.json").read_bytes()
    from zerodrift.train import engine

    def refuse(*_: object) -> None:
        raise AssertionError("trained again")

    monkeypatch.setattr(engine, "Training", refuse)
    result = invoke("firmware", "-C", own)
    assert result.exit_code == 0, (result.output, result.exception)
    assert (own / "build/uncertainty.json").read_bytes() == before


def test_none_is_stated_where_none_is_wanted(project: Path, tmp_path: Path) -> None:
    own = Path(shutil.copytree(project, tmp_path / "p"))
    result = invoke("firmware", "-C", own, "--no-uncertainty")
    assert result.exit_code == 0 and "as --no-uncertainty asks" in result.stderr
    assert not (own / "build/uncertainty.json").exists()
    assert invoke("verify", "-C", own).exit_code == 0
    log = own / f"{TESTS[0].name}.csv"
    applied = invoke("apply", log, "-C", own, "--out", tmp_path / "o.csv")
    assert applied.exit_code == 0 and "no uncertainty is stated" in applied.stderr


def test_an_lstm_has_one_too(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(network_training, "WORTH_ITS_FLASH", 10.0)
    config = load_config(write_network(tmp_path / "p", "lstm"))
    dataset = load_dataset(config)
    config.build_directory.mkdir()
    whole = train(config, dataset).compensator
    assert whole.network is not None, whole.notes
    found = ask(Original(config, dataset, whole))
    assert found.by_epochs and len(found.floating) == len(dataset.train)
    assert leave_out(config, replace(dataset, test=()), whole) is None, "not for the gate"


def test_one_run_alone_says_why(original: Original) -> None:
    single = replace(original.dataset, train=original.dataset.train[:1])
    (found,) = leave_out_together([replace(original, dataset=single)], Handling())
    assert isinstance(found, InputError) and "two runs or more" in str(found)


def test_what_diverges_is_told_and_spoils_no_other(
    original: Original, monkeypatch: pytest.MonkeyPatch
) -> None:
    real = refits._prepare

    def fail(number: int, *rest: object) -> object:
        if number == 0:
            raise FloatingPointError("too large")
        return real(number, *rest)  # type: ignore[arg-type]

    monkeypatch.setattr(refits, "_prepare", fail)
    first, second = leave_out_together([original, original], Handling())
    assert isinstance(first, InputError) and "too large" in str(first)
    assert isinstance(second, LeftOut)


def test_parts_hold_every_run_once(original: Original) -> None:
    runs = [replace(original.dataset.train[0], name=f"r{i}", group=f"r{i}") for i in range(19)]
    parts = split_parts(runs)
    assert len(parts) == MOST_PARTS
    assert sorted(group for part in parts for group in part) == sorted(run.name for run in runs)
    assert max(map(len, parts)) - min(map(len, parts)) <= 1


def test_what_auto_took_is_trained_again(original: Original) -> None:
    found = find_network(NetworkConfig(kind="auto"), original.compensator)
    assert (found.kind, found.hidden, found.memory) == ("gru", 4, "stream")
