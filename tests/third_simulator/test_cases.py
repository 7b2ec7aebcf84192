"""Cases of the third simulator: reproducible, of the size asked for, in the contract's form."""

import ast
import json
import sys
import tomllib
from pathlib import Path

import benchmarks.third_simulator as simulator
import numpy as np
import polars as pl
import pytest
from benchmarks.third_simulator import EFFECTS, FAMILIES, KINDS, OUTSIDE, draw_case, list_effects
from benchmarks.third_simulator.__main__ import main
from benchmarks.third_simulator.noise import Recorder

PAIRS = [(family, effect) for family in FAMILIES for effect in list_effects(family)]


def rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def fit_by_hand(case, output: int) -> tuple[float, float]:
    """Return RMS of what is left of the true drift on training runs, and of the test noise."""
    columns, drifts = [], []
    kinds = {table["kind"]: table for table in case.base}
    for log in case.logs:
        if log.use != "train":
            continue
        t = log.columns["temperature_degC"]
        powers = [t**n for n in range(int(kinds["zero_tempco"]["order"]) + 1)]
        if "span_tempco" in kinds:
            load = log.columns[f"{case.outputs[output]}_reference"]
            powers += [load, load * t]
        columns.append(np.stack(powers, axis=1))
        drifts.append(log.drift[:, output])
    x, y = np.concatenate(columns), np.concatenate(drifts)
    x = x / np.abs(x).max(axis=0)
    return rms(y - x @ np.linalg.lstsq(x, y, rcond=None)[0]), case.truth.noise_rms[output]


def test_it_imports_nothing_of_what_it_judges() -> None:
    allowed = {"numpy", "polars", *sys.stdlib_module_names}
    for path in Path(simulator.__file__).parent.glob("*.py"):
        for node in ast.walk(ast.parse(path.read_text("utf-8"))):
            names = [a.name for a in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            for name in names:
                own = name.startswith("benchmarks.third_simulator")
                assert own or name.split(".")[0] in allowed, f"{path.name} imports {name}"


def test_a_seed_decides_everything() -> None:
    first, again, other = draw_case(5), draw_case(5), draw_case(6)
    for a, b in zip(first.logs, again.logs, strict=True):
        assert all(np.array_equal(a.columns[name], b.columns[name]) for name in a.columns)
    assert first.truth == again.truth
    assert first.truth.noise_rms != other.truth.noise_rms


def test_hiding_an_effect_draws_no_other_noise() -> None:
    plain = draw_case(7, family="hall")
    hidden = draw_case(7, family="hall", effect="warm_up")
    for a, b in zip(plain.logs, hidden.logs, strict=True):
        assert np.array_equal(a.columns["temperature_degC"], b.columns["temperature_degC"])
        added = b.columns["b_measured"] - a.columns["b_measured"] - (b.drift - a.drift)[:, 0]
        assert np.abs(added).max() < 3 * max(plain.truth.noise_rms)


@pytest.mark.spread(8, ("family", "effect"), PAIRS)
def test_every_effect_of_a_family_has_the_size_asked_for(family, effect) -> None:
    case = draw_case(21, family=family, effect=effect, size=3.0)
    assert case.truth.sizes[effect].train == pytest.approx(3.0)
    if len(case.base) == 1 or case.base[-1]["kind"] == "span_tempco":
        left, noise = max(fit_by_hand(case, n) for n in range(len(case.outputs)))
        assert left / noise == pytest.approx(3.0, rel=0.1)


@pytest.mark.parametrize("name", list(OUTSIDE))
@pytest.mark.spread(5, "seed", [31, 1034, 1068])
def test_what_stands_in_no_catalogue_is_hidden_at_its_size(name, seed) -> None:
    truth = draw_case(seed, effect=name, size=2.0).truth
    assert truth.name == "outside"
    assert truth.sizes[name].train == pytest.approx(2.0)


@pytest.mark.spread(4, "seed", range(40, 64))
def test_a_complete_model_lacks_nothing(seed) -> None:
    case = draw_case(seed, runs=2 + seed % 6)
    assert case.truth.name is None
    assert max(case.truth.base_left) < 0.1


def test_a_polynomial_that_takes_an_effect_up_is_told() -> None:
    ageing = draw_case(3, effect="ageing").truth.sizes["ageing"]
    assert ageing.per_run < 0.5 < ageing.train
    leak = draw_case(3, family="gas", effect="dark_current").truth.sizes["dark_current"]
    assert leak.taken_up > 0.2


def test_two_effects_have_a_size_each() -> None:
    truth = draw_case(8, family="load_cell", effect=("creep", "thermal_lag"), size=4.0).truth
    assert [truth.sizes[name].train for name in truth.effects] == pytest.approx([4.0, 4.0])


@pytest.mark.parametrize("kind", KINDS)
def test_noise_on_test_runs_is_what_the_recorder_says(kind) -> None:
    case = draw_case(9, family="strain", noise=kind)
    within = {"walk": 0.4, "mixed": 0.4, "flicker": 0.3}.get(kind, 0.05)
    assert case.truth.noise_rms[0] == pytest.approx(case.truth.noise_expected, rel=within)


def test_the_converter_has_a_step() -> None:
    case = draw_case(10, family="gyro", noise="coarse")
    values = np.concatenate([log.columns["wx_measured"] for log in case.logs])
    steps = np.diff(np.unique(np.round(values, 9)))
    smallest = steps.min()
    assert np.allclose(steps / smallest, np.round(steps / smallest), atol=1e-3)
    assert smallest > 2.0 * case.truth.noise_rms[0]


def test_rows_jitter_and_get_lost() -> None:
    recorder = Recorder("white", 1.0, 0.1, 0.0, jitter=0.1, lost=0.01, gaps=2, outliers=0.0)
    time, keep = recorder.take_rows(np.random.default_rng(1), 20_000.0, 1.0)
    assert 0.03 < np.std(np.diff(time)) < 0.12
    assert 0.005 < 1.0 - keep.mean() < 0.02
    assert np.all(np.diff(time) > 0)


@pytest.mark.parametrize("share", [0.002, 0.02])
def test_wild_rows_are_as_many_and_as_wild_as_asked(share) -> None:
    case = draw_case(12, family="pressure", outliers=share)
    found = np.mean(np.concatenate([log.wild[:, 0] for log in case.logs]))
    assert found == pytest.approx(share, rel=0.35)
    for log in case.logs:
        load = log.columns.get("p_reference", 0.0)
        left = log.columns["p_measured"] - load - log.drift[:, 0]
        assert np.abs(left[log.wild[:, 0]]).min() > 9 * case.truth.noise_rms[0]
        assert np.abs(left[~log.wild[:, 0]]).max() < 7 * case.truth.noise_rms[0]


def test_the_thermometer_may_be_read_seldom() -> None:
    case = draw_case(13, temperature_rows=10)
    t = case.logs[0].columns["temperature_degC"]
    assert np.mean(np.diff(t) == 0.0) > 0.85


def test_runs_are_as_many_as_asked_and_unlike_in_length() -> None:
    case = draw_case(14, runs=9, dwell=False)
    lengths = [len(log.drift) for log in case.logs if log.use == "train"]
    assert len(lengths) == 9
    assert len(set(lengths)) > 5
    assert not [log for log in case.logs if log.use == "dwell"]


def test_a_perfect_prediction_has_no_error() -> None:
    case = draw_case(15)
    assert case.measure_error(case.test_drift) == (0.0,) * len(case.outputs)
    flat = {name: np.zeros_like(drift) for name, drift in case.test_drift.items()}
    assert max(case.measure_error(flat)) > 3.0


def test_the_folder_is_a_project_with_its_truth_beside(tmp_path, capsys, monkeypatch) -> None:
    line = ["--seed", "2", "--effect", "thermal_lag", "--runs", "3", "--out", str(tmp_path)]
    monkeypatch.setattr(sys, "argv", ["third_simulator", *line])
    assert main() == 0
    assert "hidden thermal_lag: 3.00 x noise" in capsys.readouterr().out
    written = tomllib.loads((tmp_path / "zerodrift.toml").read_text())
    assert written["effect"][0]["kind"] == "zero_tempco"
    log = pl.read_csv(tmp_path / "logs/train_1.csv")
    drift = pl.read_csv(tmp_path / "truth/train_1.csv")
    assert log["time_s"].to_list() == drift["time_s"].to_list()
    truth = json.loads((tmp_path / "truth/truth.json").read_text())
    assert truth["name"] == "thermal_lag"


def test_zerodrift_reads_the_folder(tmp_path) -> None:
    from zerodrift import Project

    draw_case(2, runs=3, effect="warm_up", family="hall").write(tmp_path)
    found = Project(tmp_path).compare()
    assert set(found.outputs) == {"b"}


@pytest.mark.parametrize(
    ("wanted", "told"),
    [
        ({"effect": "magic"}, "no effect 'magic'"),
        ({"effect": "creep", "family": "gas"}, "load_cell"),
        ({"runs": 1}, "expected 2 to 12"),
        ({"noise": "pink"}, "no noise 'pink'"),
        ({"sise": 2.0}, "sise"),
    ],
)
def test_what_cannot_be_drawn_is_said(wanted, told) -> None:
    with pytest.raises(ValueError, match=told):
        draw_case(1, **wanted)


def test_every_effect_belongs_to_a_family() -> None:
    assert {effect for _, effect in PAIRS} == set(EFFECTS)
