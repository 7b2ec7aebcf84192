import textwrap
from dataclasses import replace

import numpy as np
import pytest
from tests.physics.conftest import FULL_SCALE, OUTPUTS, UNITS, linear, make_dataset

from zerodrift.base.config import EffectConfig
from zerodrift.base.errors import InputError
from zerodrift.diagnosis.candidates import propose
from zerodrift.diagnosis.case import open_case
from zerodrift.diagnosis.diagnose import diagnose
from zerodrift.operations.backend import NumpyOperations
from zerodrift.physics.catalogue import load_catalogue, register
from zerodrift.physics.effect import READING_ORDER, Effect, Feature, Parameter, Signals, registered
from zerodrift.physics.fit import fit
from zerodrift.physics.terms import build_features, start_term

LAG = "thermal_lag"
CONTRACT = [
    *("zero_tempco", "dark_current", "span_tempco", "thermal_lag", "thermal_gradient"),
    *("warm_up", "thermal_hysteresis", "creep", "load_hysteresis", "load_nonlinearity"),
    *("crosstalk", "supply_sensitivity", "humidity", "ambient_light", "inertial_load"),
    *("ageing", "clock_delay", "adc_saturation"),
    *("excitation_heating", "barometric_pressure", "turn_on_bias"),
]


def draw_signals(length=200):
    rng = np.random.default_rng(0)
    channels = ["supply", "humidity", "ambient_light", "pressure", "turn_on"]
    channels += ["acceleration_x", "acceleration_y", "acceleration_z"]
    return Signals(
        temperature_degC=25.0 + rng.normal(size=length).cumsum() * 0.2,
        elapsed_s=np.arange(length) * 1.0,
        clock_s=np.arange(length) * 1.0,
        load={name: rng.normal(size=length).cumsum() for name in OUTPUTS},
        saturated={},
        channels={name: rng.normal(size=length) for name in channels},
        outputs=OUTPUTS,
        full_scale=dict(zip(OUTPUTS, FULL_SCALE, strict=True)),
        reference_temperature_degC=25.0,
    )


def build_alone(kind, choices=None):
    catalogue = load_catalogue()
    term = start_term(catalogue, EffectConfig(kind), choices)
    signals = draw_signals()
    ops = NumpyOperations(1.0, signals.temperature_degC.shape)
    features = build_features(ops, signals, [term], list(catalogue))[1:]
    return signals, {feature.name: feature.signal for feature in features}, term


def test_catalogue_has_the_contracts_names():
    assert sorted(load_catalogue()) == sorted(CONTRACT)
    assert sorted(READING_ORDER) == sorted(CONTRACT)
    assert [effect.kind for effect in load_catalogue().listed()] == list(READING_ORDER)


@pytest.mark.parametrize("kind", CONTRACT)
def test_effect_tells_all_that_a_reader_asks(kind):
    effect = load_catalogue()[kind]
    for text in (
        *(effect.title, effect.physics, effect.equation, effect.fingerprint, effect.provoke),
        *(effect.cure, effect.source),
    ):
        assert text.strip()
    for parameter in effect.parameters:
        assert parameter.unit
        assert parameter.meaning


@pytest.mark.parametrize("kind", CONTRACT)
def test_effect_builds_in_every_variant(kind):
    for choices in load_catalogue()[kind].forms:
        _, columns, term = build_alone(kind, choices)
        assert columns or term.effect.rewrite is not None or term.effect.sets_aside
        assert all(np.isfinite(column).all() for column in columns.values())


def test_dark_current_doubles_every_doubling_temperature():
    signals, columns, term = build_alone("dark_current")
    (column,) = columns.values()
    away = signals.temperature_degC - 25.0
    assert column == pytest.approx(2.0 ** (away / term.values["doubling_K"]))


def test_warm_up_approaches_one_with_its_time_constant():
    _, columns, term = build_alone("warm_up")
    (column,) = columns.values()
    assert column[0] == pytest.approx(0.0, abs=1e-12)
    assert column[150] == pytest.approx(1.0 - np.exp(-150.0 / term.values["tau_s"]))


def test_thermal_lag_changes_what_dark_current_sees():
    catalogue, signals = load_catalogue(), draw_signals()
    lag = start_term(catalogue, EffectConfig("thermal_lag", {"tau_s": 30.0}))
    dark = start_term(catalogue, EffectConfig("dark_current", {"doubling_K": 10.0}))
    ops = NumpyOperations(1.0, signals.temperature_degC.shape)
    for terms in ([lag, dark], [dark, lag]):
        (column,) = [f.signal for f in build_features(ops, signals, terms, list(catalogue))[1:]]
        felt = ops.lowpass(signals.temperature_degC, 30.0)
        assert column == pytest.approx(2.0 ** ((felt - 25.0) / 10.0))


def test_effect_of_another_thermometer_leaves_the_chips_alone():
    catalogue, signals = load_catalogue(), draw_signals()
    body = signals.temperature_degC + 5.0
    signals = Signals(**{**signals.__dict__, "channels": {"body_temperature": body}})
    ops = NumpyOperations(1.0, body.shape)
    terms = [
        start_term(catalogue, EffectConfig("zero_tempco")),
        start_term(catalogue, EffectConfig("zero_tempco", options={"signal": "body_temperature"})),
    ]
    chip, other = [f.signal for f in build_features(ops, signals, terms, list(catalogue))[1:]]
    assert other - chip == pytest.approx(5.0)


def test_unknown_effect_names_the_nearest():
    with pytest.raises(
        InputError, match=r"zerodrift.toml:7: no effect 'thermal_lags'.*thermal_lag"
    ):
        start_term(load_catalogue(), EffectConfig("thermal_lags", line=7))


def test_unknown_parameter_names_the_nearest():
    with pytest.raises(InputError, match=r"has no parameter 'tau'.*tau_s"):
        start_term(load_catalogue(), EffectConfig("thermal_lag", {"tau": 3.0}))


def test_held_value_out_of_bounds_is_refused():
    with pytest.raises(InputError, match=r"tau_s = -3 s; expected 1 \.\. 100000"):
        start_term(load_catalogue(), EffectConfig("thermal_lag", {"tau_s": -3.0}))
    with pytest.raises(InputError, match=r"order = 6; expected one of 1, 2, 3, 4, 5"):
        start_term(load_catalogue(), EffectConfig("zero_tempco", {"order": 6.0}))


def test_unknown_option_is_refused():
    with pytest.raises(InputError, match=r"has no option 'sginal'.*signal"):
        start_term(load_catalogue(), EffectConfig("zero_tempco", options={"sginal": "x"}))


# --- a user's own effects -----------------------------------------------------------------------


def write_effect(tmp_path, body, name="my_effects.py"):
    path = tmp_path / name
    path.write_text(
        "from zerodrift.physics.catalogue import register\n"
        "from zerodrift.physics.effect import Effect, Feature, Parameter\n" + textwrap.dedent(body),
        encoding="utf-8",
    )
    return path


SECOND_ORDER = """
    def build(ops, signals, p):
        fast = ops.lowpass(signals.temperature_degC, p["tau_s"])
        return [Feature("twice filtered", ops.lowpass(fast, p["tau_s"]), "K")]

    register(Effect(
        kind="twice_lagged", title="a lag of second order", build=build, needs=("temperature",),
        parameters=(Parameter("tau_s", "s", 1.0, 1000.0, (10.0, 300.0)),),
    ))
"""


def test_users_effect_is_fitted_like_a_built_in(tmp_path):
    from tests.physics.conftest import follow

    catalogue = load_catalogue([write_effect(tmp_path, SECOND_ORDER)])

    def disturb(bench):
        return follow(follow(bench.temperature, 80.0), 80.0)[:, None] * np.array([1.0, 0.02])

    dataset = make_dataset(disturb, runs=4)
    model = fit(
        [EffectConfig("twice_lagged")],
        dataset.train,
        outputs=OUTPUTS,
        units=UNITS,
        full_scale=FULL_SCALE,
        catalogue=catalogue,
    )
    assert model.terms[0].term.values["tau_s"] == pytest.approx(80.0, rel=0.03)
    assert "twice_lagged" not in load_catalogue()


def test_users_effect_that_raises_is_named_with_its_line(tmp_path):
    path = write_effect(
        tmp_path,
        """
        def build(ops, signals, p):
            return [Feature("x", ops.lowpass(signals.temprature, 3.0))]

        register(Effect(kind="broken", title="broken", build=build))
        """,
    )
    catalogue = load_catalogue([path])
    with pytest.raises(InputError, match=r"my_effects.py:5: effect 'broken': build raised Attr"):
        fit_one(catalogue, "broken")


@pytest.mark.parametrize(
    ("body", "message"),
    [
        ("ops.power(ops.constant(-1e300), 3)", r"NaN or infinite"),
        ("3.0", r"feature 'x' is a float; expected what an operation"),
    ],
)
def test_users_effect_that_gives_nonsense_is_named(tmp_path, body, message):
    path = write_effect(
        tmp_path,
        f"""
        def build(ops, signals, p):
            return [Feature("x", {body})]

        register(Effect(kind="nonsense", title="nonsense", build=build))
        """,
    )
    with pytest.raises(InputError, match=f"my_effects.py: effect 'nonsense'.*{message}"):
        fit_one(load_catalogue([path]), "nonsense")


def fit_one(catalogue, kind):
    dataset = make_dataset(linear, runs=4, length=120)
    return fit(
        [EffectConfig(kind)],
        dataset.train,
        outputs=OUTPUTS,
        units=UNITS,
        full_scale=FULL_SCALE,
        catalogue=catalogue,
    )


def test_file_of_effects_with_an_error_is_named_with_its_line(tmp_path):
    with pytest.raises(InputError, match=r"my_effects.py:3: .*ZeroDivisionError"):
        load_catalogue([write_effect(tmp_path, "x = 1 / 0")])
    with pytest.raises(InputError, match=r"my_effects.py:3: .*SyntaxError"):
        load_catalogue([write_effect(tmp_path, "def (")])


def test_file_of_effects_that_is_missing_or_empty_is_refused(tmp_path):
    with pytest.raises(InputError, match=r"nowhere.py: no such file"):
        load_catalogue([tmp_path / "nowhere.py"])
    with pytest.raises(InputError, match=r"declares no effect"):
        load_catalogue([write_effect(tmp_path, "")])


def test_declaration_without_sense_is_refused():
    upside_down = Parameter("tau_s", "s", 10.0, 1.0, (2.0, 3.0))
    with pytest.raises(InputError, match=r"expected lower <= typical <= upper"):
        register(Effect(kind="no_sense", title="", parameters=(upside_down,)))
    below_zero = Parameter("x", "1", -1.0, 1.0, (0.1, 0.2), scale="log")
    with pytest.raises(InputError, match=r"lower bound must be above 0"):
        register(Effect(kind="no_sense", title="", parameters=(below_zero,)))
    assert "no_sense" not in load_catalogue()


def test_users_effect_cannot_take_a_built_in_name(tmp_path):
    body = 'register(Effect(kind="creep", title="mine"))'
    with pytest.raises(InputError, match=r"'creep' is already declared in the built-in catalogue"):
        load_catalogue([write_effect(tmp_path, body)])


def test_effects_name_their_feature_type():
    assert Feature("x", 1.0).unit == "1"


def test_creep_that_follows_the_temperature_is_right_to_first_order():
    signals, columns, term = build_alone("creep", {"of_temperature": 1})
    tau_s, hasten = term.values["tau_s"], 1e-4
    load = signals.load["Fz"]
    rate = 1.0 + hasten * (signals.temperature_degC - signals.reference_temperature_degC)
    x = np.full(2, load[0])
    exact = [x]
    for n in range(1, load.size):
        for share in (np.arange(50) + 0.5) / 50:
            now = load[n - 1] + share * (load[n] - load[n - 1])
            speed = np.array([rate[n - 1] + share * (rate[n] - rate[n - 1]), 1.0])
            x = x + (now - x) * speed / (tau_s * 50)
        exact.append(x)
    hastened, plain = np.array(exact).T
    changed = columns["creep: creep rate Fz"]
    assert np.abs(changed).max() > 0.0
    beyond = hastened - plain
    assert beyond == pytest.approx(hasten * changed, abs=0.05 * np.abs(hasten * changed).max())


@pytest.mark.parametrize("form", [{}, {"logarithmic": 1}, {"time_constants": 2}])
def test_settled_creep_is_wrong_at_first_and_right_in_the_end(form):
    effect = load_catalogue()["creep"]
    signals = replace(draw_signals(6000), load={"Fz": np.ones(6000)}, outputs=("Fz",))
    signals.load["Fz"][0] = 0.0
    ops = NumpyOperations(1.0, (6000,))
    held = {"tau_s": 5.0, "slow_tau_s": 200.0, "settled": 1, **form}
    held = {k: v for k, v in held.items() if k != "slow_tau_s" or "time_constants" in form}
    term = start_term(load_catalogue(), EffectConfig("creep", held))
    for feature in effect.build(ops, signals, term.values):
        assert feature.signal[1] < -0.85
        assert abs(feature.signal[-1]) < 0.01


def test_logarithmic_creep_goes_on_with_the_logarithm_of_time():
    effect = load_catalogue()["creep"]
    term = start_term(load_catalogue(), EffectConfig("creep", {"tau_s": 10.0, "logarithmic": 1}))
    time_s = np.arange(2600.0)
    load = (time_s > 0.0).astype(np.float64)
    signals = replace(draw_signals(time_s.size), load={"Fz": load}, outputs=("Fz",))
    ops = NumpyOperations(1.0, time_s.shape)
    (feature,) = effect.build(ops, signals, term.values)
    # From 2 tau to half of the slowest time constant about the same in each factor of 4.
    steps = np.diff(feature.signal[[20, 80, 320, 1280]])
    assert steps == pytest.approx(np.full(3, 0.2), rel=0.15)


def test_heat_comes_from_the_power_where_it_is_logged_and_from_the_supply_otherwise():
    effect = load_catalogue()["excitation_heating"]
    signals = draw_signals()
    ops = NumpyOperations(1.0, signals.temperature_degC.shape)
    values = {"tau_s": 30.0}
    (squared,) = effect.build(ops, signals, values)
    assert squared.signal == pytest.approx(ops.lowpass(signals.channels["supply"] ** 2, 30.0))
    power = np.abs(signals.temperature_degC)
    logged = replace(signals, channels={**signals.channels, "power": power})
    (heat,) = effect.build(ops, logged, values)
    assert heat.signal == pytest.approx(ops.lowpass(power, 30.0))


@pytest.mark.parametrize(
    ("kind", "choices", "names"),
    [
        ("thermal_lag", {"own_terms": 1}, ["slow T"]),
        ("ageing", {"of_span": 1}, ["age", "age x Fz", "age x Mx"]),
        ("humidity", {"of_rate": 1}, ["moisture gradient"]),
        ("humidity", {"of_span": 1}, ["moisture", "moisture x Fz", "moisture x Mx"]),
        ("zero_tempco", {"order": 5}, ["T - T0", *(f"(T - T0)^{n}" for n in (2, 3, 4, 5))]),
        ("barometric_pressure", {}, ["air pressure"]),
        ("turn_on_bias", {"decays": 1}, ["zero at power-on", "what is left of it"]),
    ],
)
def test_options_have_the_columns_that_their_equations_say(kind, choices, names):
    assert list(build_alone(kind, choices)[1]) == [f"{kind}: {name}" for name in names]


@pytest.mark.parametrize(
    ("runs", "at_once"), [(3, []), (4, [{"own_terms": 1}])], ids=["pieces", "runs"]
)
def test_a_lag_with_coefficients_of_its_own_is_tried_at_once_where_runs_are_the_evidence(
    runs, at_once
):
    catalogue = load_catalogue()
    campaign = open_case(
        make_dataset(linear, runs=runs, length=200), catalogue, [EffectConfig("zero_tempco")]
    ).campaign

    def list_lags(*kinds):
        terms = [start_term(catalogue, EffectConfig(kind)) for kind in kinds]
        return [dict(p.choices) for p in propose(catalogue, terms, campaign)[0] if p.kind == LAG]

    plain = [{"time_constants": 1}, {"time_constants": 2}]
    assert list_lags("zero_tempco") == [*plain, *at_once]
    assert list_lags("zero_tempco", LAG) == [{"time_constants": 2}, {"own_terms": 1}]


def make_turned_on(decays):
    """Untared logs, each from a power-on that drew a zero of its own."""
    rng = np.random.default_rng(31)
    dataset = make_dataset(linear, runs=8, length=400, tared=False)
    train = []
    for run in dataset.train:
        drawn = rng.normal()
        elapsed = run.time_s - run.time_s[0]
        share = 0.3 + 0.7 * np.exp(-elapsed / 200.0) if decays else np.ones_like(elapsed)
        bias = drawn * share[:, None] * np.array([9.0, 0.07])
        read = drawn * 9.0 + 0.1 * rng.normal()
        inputs = {**run.inputs, "turn_on": np.full(len(run), read)}
        train.append(replace(run, measured=run.measured + bias, inputs=inputs))
    still = tuple(
        replace(run, inputs={**run.inputs, "turn_on": np.zeros(len(run))}) for run in dataset.dwell
    )
    return replace(dataset, train=tuple(train), dwell=still)


@pytest.mark.spread(0, "decays", [False, True])
def test_a_zero_drawn_at_power_on_is_named_where_it_was_logged(decays):
    dataset = make_turned_on(decays)
    found = diagnose([EffectConfig("zero_tempco")], dataset)
    assert (found.verdict, found.effect) == ("missing", "turn_on_bias")
    assert found.parameters.get("decays", 0) == decays
    if decays:
        assert found.parameters["tau_s"] == pytest.approx(200.0, rel=0.1)
    unlogged = replace(
        dataset,
        train=tuple(
            replace(run, inputs={n: x for n, x in run.inputs.items() if n != "turn_on"})
            for run in dataset.train
        ),
    )
    blind = diagnose([EffectConfig("zero_tempco")], unlogged)
    assert blind.effect is None
    assert "turn_on_bias" in {one.effect for one in blind.not_testable}


def test_a_session_replaces_no_built_in_and_may_declare_its_own_again():
    """As in a notebook, whose cells are run again."""

    def build(ops, signals, p):
        return ()

    with pytest.raises(InputError, match=r"'creep' is already declared in the built-in catalogue"):
        register(Effect(kind="creep", title="mine", build=build))
    assert load_catalogue()["creep"].title != "mine"
    try:
        for title in ("first", "second"):
            register(Effect(kind="of_this_session", title=title, build=build))
            assert load_catalogue()["of_this_session"].title == title
    finally:
        registered.pop("of_this_session", None)
