"""The oracle's generator: effects as the catalogue has them, of the size asked for."""

import ast
import sys
from pathlib import Path

import numpy as np
import pytest

import zerodrift_lab.oracle as oracle
from zerodrift.base.config import load_config
from zerodrift.dataset.load import load_dataset
from zerodrift.physics.catalogue import load_catalogue
from zerodrift.physics.effect import Signals as ProductSignals
from zerodrift.physics.terms import Term, build_columns
from zerodrift_lab.oracle.forms import CHIP, FORMS, Form, Signals, leave_polynomial, play, rms
from zerodrift_lab.oracle.generator import draw_case

STEP_S = 0.25
CATALOGUE = load_catalogue()
NOT_REWRITTEN = (0, 4, 5, 6, 7)
"""Seeds of one effect that is a column of its own; of one that rewrites, only what it does to the
polynomial's first order has the size asked for."""
DEMANDING = pytest.mark.parametrize("share", [0.05, 0.5, 0.95])


@pytest.fixture(scope="module")
def fine() -> Signals:
    """Half an hour at fine steps, all inputs moving."""
    time = np.arange(7200) * STEP_S
    bends = [0.0, 300.0, 700.0, 1000.0, 1400.0, 1800.0]
    series = {
        CHIP: np.interp(time, bends, [20.0, 45.0, 45.0, 5.0, 30.0, 28.0]),
        "load": np.interp(time, bends, [0.0, 80.0, -60.0, -60.0, 40.0, 90.0]),
        "supply": 5.0 + 0.5 * np.sin(time / 90.0),
        "humidity": 50.0 + 30.0 * np.sin(time / 200.0),
        "ambient_light": 300.0 + 200.0 * np.sin(time / 70.0),
        "pressure": 1000.0 + 5.0 * np.sin(time / 300.0),
        "acceleration_z": 9.81 * np.cos(time / 50.0),
        "turn_on": np.full(time.shape, 0.7),
        "elapsed": time,
        "clock": 3600.0 + time,
    }
    # A chamber's corners are round: what is exact for straight lines alone is not asked for.
    series[CHIP] = np.convolve(np.pad(series[CHIP], 80, "edge"), np.ones(161) / 161.0, "valid")
    return Signals({name: x[None] for name, x in series.items()}, STEP_S, 100.0)


def build_by_product(fine: Signals, form: Form, value: float) -> list[np.ndarray]:
    """Return the product's columns for a form; a rewriting one's is the temperature it leaves."""
    effect = CATALOGUE[form.kind]
    chosen = dict(form.options) | ({form.value: value} if form.value else {})
    if form.kind == "thermal_gradient":
        chosen["smoothing_s"] = 0.5
    values = {p.name: p.typical[0] if p.default is None else p.default for p in effect.parameters}
    terms = [Term(effect, values | chosen)]
    if form.rewrites:
        terms.append(Term(CATALOGUE["zero_tempco"], {"order": 1}))
    series = {name: x[0] for name, x in fine.series.items()}
    signals = ProductSignals(
        temperature_degC=series[CHIP],
        elapsed_s=series["elapsed"],
        clock_s=series["clock"],
        load={"y": series["load"]},
        saturated={},
        channels=series,
        outputs=("y",),
        full_scale={"y": fine.full_scale},
        reference_temperature_degC=25.0,
    )
    return [column.signal for column in build_columns(signals, terms, list(CATALOGUE), STEP_S)]


@DEMANDING
@pytest.mark.parametrize("form", FORMS, ids=[form.name for form in FORMS])
def test_each_form_is_the_catalogues(fine: Signals, form: Form, share: float) -> None:
    """Coefficients are free, so the columns are compared as what they span beside a constant."""
    value = form.low * (form.high / form.low) ** share if form.log and form.value else 0.0
    if form.value and not form.log:
        value = form.low + share * (form.high - form.low)
    own = [column[0, 0] for column in form.build(fine, CHIP, np.array([value]))]
    theirs = np.stack(build_by_product(fine, form, value), axis=1)
    assert theirs.shape[1] - 1 == len(own)
    # Of what rewrites the temperature, what counts is by how much it moves it.
    taken_off = fine.series[CHIP][0] if form.rewrites else 0.0
    for column in own:
        fitted = theirs @ np.linalg.lstsq(theirs, column, rcond=None)[0]
        whole = column - taken_off
        assert rms(column - fitted) <= 0.01 * max(rms(whole - whole.mean()), 1e-3 * rms(whole))


def test_every_effect_of_the_catalogue_has_a_form_but_that_which_sets_rows_aside() -> None:
    assert {form.kind for form in FORMS} == set(CATALOGUE) - {"adc_saturation"}


def test_values_lie_within_the_catalogues_bounds() -> None:
    for form in FORMS:
        if form.value:
            parameter = CATALOGUE[form.kind].parameter(form.value)
            assert parameter.lower <= form.low < form.high <= parameter.upper, form.name


def test_play_by_hand() -> None:
    found = play(np.array([[0.0, 1.0, 3.0, 2.5, 0.0]]), np.array([1.0]))
    assert found[0, 0].tolist() == [0.0, 0.0, 2.0, 2.0, 1.0]


def test_generator_and_oracle_import_nothing_of_what_they_judge() -> None:
    allowed = {"numpy", "zerodrift_lab", *sys.stdlib_module_names}
    for path in Path(oracle.__file__).parent.glob("*.py"):
        for node in ast.walk(ast.parse(path.read_text("utf-8"))):
            names = [a.name for a in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            for name in names:
                assert name.split(".")[0] in allowed, f"{path.name} imports {name}"
                assert not name.startswith("zerodrift_lab") or name.startswith(oracle.__name__)


def test_a_seed_decides_everything() -> None:
    first, again, other = (draw_case(seed, runs=2, rows=(200, 300)) for seed in (5, 5, 6))
    assert np.array_equal(first.measured, again.measured)
    assert first.truth == again.truth
    assert first.truth.noise_level != other.truth.noise_level


@pytest.mark.parametrize("seed", NOT_REWRITTEN)
def test_an_effect_is_as_large_as_asked_for(seed: int) -> None:
    """Beyond a polynomial of second order in the logged temperature, in noise levels."""
    case = draw_case(seed, count=1, sizes=(5.0, 5.0), thermometer_error_K=0.0, rows=(300, 900))
    assert case.truth.effects[0].form not in {form.name for form in FORMS if form.rewrites}
    rows = [(run, slice(length)) for run, length in enumerate(case.lengths)]
    drift = np.concatenate([case.drift[place] for place in rows])
    logged = np.concatenate([case.signals.series[CHIP][place] for place in rows])
    left = rms(leave_polynomial(drift, logged))
    assert left == pytest.approx(5.0 * case.truth.noise_level, rel=0.02)


def test_a_written_case_is_a_project(tmp_path: Path) -> None:
    case = draw_case(11, runs=3, rows=(200, 300), thermometers=2)
    case.write(tmp_path)
    dataset = load_dataset(load_config(tmp_path))
    assert [len(run) for run in dataset.train] == list(case.lengths)
    for run, found in enumerate(dataset.train):
        length = case.lengths[run]
        assert np.allclose(found.measured[:, 0], case.measured[run, :length], rtol=1e-8)
        assert np.allclose(found.inputs["body_1"], case.signals.series["body_1"][run, :length])


def test_what_is_out_of_range_is_refused() -> None:
    with pytest.raises(ValueError, match="count = 4"):
        draw_case(1, count=4)
    with pytest.raises(ValueError, match="9 runs"):
        draw_case(1, runs=9)
