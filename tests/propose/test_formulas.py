"""Forms: as the formula says, as the effect computes, and as the written file's code computes."""

import numpy as np
import pytest

from zerodrift.diagnosis.formula.expression import OWN_LOAD, Driver
from zerodrift.diagnosis.formula.grammar import Spans, centre, list_forms
from zerodrift.diagnosis.formula.screen import draw_signs, judge
from zerodrift.operations.backend import GraphOperations, NumpyOperations
from zerodrift.physics.effect import Signals

ROWS = 60
SOURCES = [
    Driver("temperature", "T", "degC", 10.0, 25.0, 40.0),
    Driver("load", OWN_LOAD, "load", -5.0, 0.0, 5.0),
    Driver("load", "Fz", "load", -5.0, 0.0, 5.0),
    Driver("input", "humidity", "%RH", 20.0, 50.0, 80.0),
    Driver("input", "body_temperature", "degC", 10.0, 25.0, 40.0),
    Driver("time", "elapsed", "s", 0.0, 30.0, 60.0),
]
FORMS = list_forms(SOURCES, Spans(1.0, 2.0, 600.0))


def draw_signals():
    rng = np.random.default_rng(4)

    def draw(source):
        return source.low + source.span * rng.random(ROWS)

    return Signals(
        temperature_degC=draw(SOURCES[0]),
        elapsed_s=np.arange(float(ROWS)),
        clock_s=np.arange(float(ROWS)),
        load={"Fz": draw(SOURCES[1]), "Mx": draw(SOURCES[1])},
        saturated={},
        channels={"humidity": draw(SOURCES[3]), "body_temperature": draw(SOURCES[4])},
        outputs=("Fz", "Mx"),
        full_scale={"Fz": 1.0, "Mx": 1.0},
        reference_temperature_degC=25.0,
    )


def test_every_form_is_written_as_it_is_computed():
    signals = draw_signals()
    ops = NumpyOperations(1.0, (ROWS,))
    for form in FORMS:
        expression = form.expression
        names = [p.name for p in expression.parameters]
        assert len(set(names)) == len(names)
        p = dict(zip(names, form.starts[0], strict=True))
        expected = expression.build(ops, signals, p, "Mx")
        scope = {"ops": ops, "signals": signals, "p": p, "load": signals.load["Mx"]}
        exec("\n".join(expression.list_code()), scope)
        assert np.array_equal(scope["x"], expected), expression.write()
        assert np.isfinite(expected).all(), expression.write()


def test_every_start_lies_within_its_parameters_bounds():
    for form in FORMS:
        for values in form.starts:
            for parameter, value in zip(form.expression.parameters, values, strict=True):
                assert parameter.lower <= value <= parameter.upper, form.expression.write()
        for parameter in centre(form, form.starts[-1]).parameters:
            low, high = parameter.typical
            assert parameter.lower <= low <= high <= parameter.upper


def test_every_form_is_made_of_the_chips_operations():
    ops = GraphOperations(1.0)
    signals = Signals(
        temperature_degC=ops.input("temperature_degC"),
        elapsed_s=ops.input("elapsed_s"),
        clock_s=ops.input("clock_s"),
        load={name: ops.input(f"load:{name}") for name in ("Fz", "Mx")},
        saturated={},
        channels={name: ops.input(name) for name in ("humidity", "body_temperature")},
        outputs=("Fz", "Mx"),
        full_scale={"Fz": 1.0, "Mx": 1.0},
        reference_temperature_degC=25.0,
    )
    for form in FORMS:
        names = [p.name for p in form.expression.parameters]
        form.expression.build(ops, signals, dict(zip(names, form.starts[0], strict=True)), "Fz")


def test_forms_are_told_once_and_simple_ones_first():
    written = [form.expression.write() for form in FORMS]
    assert len(set(written)) == len(written)
    assert [f.expression.complexity for f in FORMS] == sorted(
        f.expression.complexity for f in FORMS
    )
    assert {"(humidity - LP(humidity, tau_s))", "max(T, body_temperature)"} <= set(written)


def test_the_gain_in_runs_left_out_is_that_of_a_fit_to_the_others():
    rng = np.random.default_rng(1)
    x, rest = rng.standard_normal((2, 5, 40))
    rest = rest + 0.7 * x
    gains, chance = judge(
        (x * rest).sum(axis=1)[None, :, None], (x * x).sum(axis=1)[None, :, None], draw_signs(5)
    )
    expected = 0.0
    for run in range(5):
        others = [i for i in range(5) if i != run]
        k = (x[others] * rest[others]).sum() / (x[others] ** 2).sum()
        expected += (rest[run] ** 2).sum() - ((rest[run] - k * x[run]) ** 2).sum()
    assert gains[0] == pytest.approx(expected)
    assert chance[0] == pytest.approx(expected)
    assert chance.max() == chance[0]


def test_signs_are_those_of_whole_runs_and_opposites_are_one():
    assert draw_signs(4).shape == (8, 4)
    assert (draw_signs(4)[:, 0] == 1.0).all() and (draw_signs(20)[0] == 1.0).all()


def test_chance_counts_everything_that_was_tried():
    rng = np.random.default_rng(2)
    values = []
    for _ in range(40):
        x, rest = rng.standard_normal((300, 7, 30)), rng.standard_normal((7, 30))
        products, squares = (x * rest).sum(axis=2), (x * x).sum(axis=2)
        _, chance = judge(products[..., None], squares[..., None], draw_signs(7))
        values.append(np.mean(chance >= chance[0]))
    assert np.mean(np.array(values) <= 0.1) <= 0.3
    assert 0.3 <= np.mean(values) <= 0.7
