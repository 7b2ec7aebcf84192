"""`diagnose` in a fleet's folder: all units speak together, and those that differ are named."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner, Result
from tests.fleet.conftest import TOLD, TOML
from tests.schemas import validate

from zerodrift.base.errors import InputError
from zerodrift.base.fleet_config import OUTLIER_Z
from zerodrift.cli.main import cli
from zerodrift.fleet.evidence import ExaminedUnit, UnitEffect, UnitLook, find_differences, pool
from zerodrift.physics.catalogue import load_catalogue
from zerodrift_lab.twin import EffectChoice, Recipe, simulate
from zerodrift_lab.twin.logs import render_logs

KINDS = tuple(f"effect_{i}" for i in range(15))


def invoke(*arguments: object) -> Result:
    return CliRunner().invoke(cli, [*map(str, arguments)])


def write_fleet(project: Path, hidden: list[str], size: float) -> Path:
    """Write short logs of a fleet without a dwell; `hidden` names each unit's effect, or none."""
    for number, name in enumerate(hidden):
        recipe = Recipe(
            seed=4100 + number,
            train=("chamber",) * 3,
            dwell=False,
            told=TOLD,
            hidden=(EffectChoice(name),) if name else (),
            size=size if name else None,
            duration_s=300.0,
        )
        folder = project / "fleet" / f"SN{number:02d}"
        folder.mkdir(parents=True)
        for file, content in render_logs(simulate(recipe)).items():
            (folder / Path(file).name).write_bytes(content)
    (project / "zerodrift.toml").write_text(TOML.replace('test = ["test_*.csv"]\n', ""))
    return project


def make_units(gains: np.ndarray, ratio: float = 0.9) -> list[ExaminedUnit]:
    """Units in which each effect [M] gains so much [M, U]."""

    def look(column: np.ndarray) -> UnitLook:
        shown = {
            kind: UnitEffect(kind, {}, (), float(g), ratio, np.full(2, ratio), 0.2, True, False)
            for kind, g in zip(KINDS, column, strict=False)
        }
        return UnitLook(shown, 1.0, 1.0, True, 3, {})

    looks = [look(column) for column in gains.T]
    return [ExaminedUnit(f"SN{i}", None, one, one) for i, one in enumerate(looks)]  # type: ignore[arg-type]


def test_signs_of_units_name_nothing_by_chance():
    """Heavy tails and all, at most 5 % of fleets without any effect reach the p-value."""
    rng = np.random.default_rng(8)
    named = sum(
        any(p.is_named for p in pool(make_units(rng.standard_t(1.5, size=(15, 20)))))
        for _ in range(200)
    )
    # 5 % of 200 are 10; 18 or more would come up in 1 % of such trials.
    assert named <= 17


def test_many_small_gains_count_and_one_large_one_does_not():
    rng = np.random.default_rng(9)
    gains = rng.normal(size=(15, 20))
    gains[3] += 1.2
    gains[7, 4] = 1e6
    (best, *others) = pool(make_units(gains))
    assert best.kind == "effect_3" and best.is_named
    assert not any(p.is_named for p in others)
    assert not pool(make_units(gains, ratio=0.995))[0].is_named  # sure, and worth nothing


def test_too_few_units_name_nothing():
    assert not any(p.is_named for p in pool(make_units(np.full((15, 4), 9.0))))
    assert any(p.is_named for p in pool(make_units(np.full((15, 5), 9.0))))


def test_a_unit_that_leaves_more_for_no_reason_with_a_name_is_told():
    rng = np.random.default_rng(10)
    units = make_units(rng.normal(size=(15, 10)))
    ratios = 1.0 + 0.01 * rng.normal(size=10)

    def find(of_fifth: float) -> list[tuple[str, str]]:
        left = np.where(np.arange(10) == 5, of_fifth, ratios).tolist()
        changed = [
            replace(unit, last=replace(unit.last, fitted_ratio=ratio))
            for unit, ratio in zip(units, left, strict=True)
        ]
        found = find_differences(changed, (), load_catalogue(), (), OUTLIER_Z)
        return [(one.sensor, one.quantity) for one in found]

    assert find(3.0) == [("SN5", "error")]
    assert find(1.0) == find(0.3) == []
    assert find(1.09) == []  # unlike the others, and of no weight


@pytest.fixture(scope="module")
def weak(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Twelve simulated units, all with a lag whose effect is 0.3 of the noise."""
    return write_fleet(tmp_path_factory.mktemp("weak") / "p", ["thermal_lag"] * 12, 0.3)


@pytest.mark.long
def test_what_a_unit_cannot_show_all_together_show(weak: Path):
    result = invoke("diagnose", "-C", weak, "--json")
    assert result.exit_code == 0, result.output
    told = json.loads(result.stdout)
    validate(told)
    assert (told["verdict"], told["effect"]) == ("missing", "thermal_lag")
    assert told["p_value"] <= 0.05 and len(told["units"]) == 12
    assert told["errors"] == {} and told["differ"] == []
    alone = invoke("diagnose", "-C", weak, "--sensor", "SN05", "--json")
    assert json.loads(alone.stdout)["effect"] is None


@pytest.mark.long
def test_the_odd_unit_is_named_and_the_fleet_is_not(tmp_path: Path):
    project = write_fleet(tmp_path / "p", ["", "", "", "creep", "", "", "", ""], 5.0)
    (project / "fleet/SN06/chamber_1.csv").write_text("not, a\nlog, 1\n")
    result = invoke("diagnose", "-C", project, "--json")
    told = json.loads(result.stdout)
    validate(told)
    assert told["effect"] is None
    assert list(told["errors"]) == ["SN06"]
    assert told["differ"] == []  # seven units cannot tell what is usual
    (project / "fleet/SN06/chamber_1.csv").write_bytes(
        (project / "fleet/SN05/chamber_1.csv").read_bytes()
    )
    result = invoke("diagnose", "-C", project)
    assert "COMPLETE" in result.stdout, result.output
    assert "SN03 lacks creep, the others do not" in result.stdout
    assert "diagnose --sensor SN03" in result.stdout


def test_auto_asks_for_a_unit(weak: Path):
    refused = invoke("diagnose", "-C", weak, "--auto").exception
    assert isinstance(refused, InputError) and "--sensor" in str(refused)
