"""Effects of the load: span, creep, hysteresis, non-linearity, cross-talk, saturation, inertia.

They are fitted on the true load, the reference; on the chip they see the compensated load.
"""

from collections.abc import Callable, Sequence

from zerodrift.operations.backend import Operations
from zerodrift.physics.effect import Effect, Feature, Parameter, S, Signals, Values, register

LOG_CREEP_PARTS = 5
"""Lowpasses that a logarithmic creep is made of: from tau to 256 tau."""

CROSS_AXES = Parameter(
    "cross_axes",
    "1",
    0,
    1,
    (0, 1),
    scale="linear",
    default=0,
    choices=(0, 1),
    meaning="0: each output sees its own load; 1: every output sees every load",
)


def of_each_load(
    signals: Signals[S], p: Values, name: str, unit: str, make: Callable[[str, S], S]
) -> tuple[Feature[S], ...]:
    """Return one feature per loaded output, seen by that output alone or by all of them.

    Args:
        signals: the signals.
        p: values; `cross_axes` decides who sees the features.
        name: the feature's name with `{}` for the load's.
        unit: the feature's unit; empty where it is the load's own.
        make: (output name, its load) -> signal.
    """
    shared = p["cross_axes"] == 1
    return tuple(
        Feature(name.format(output), make(output, load), unit, None if shared else output)
        for output, load in signals.load.items()
    )


def build_span_tempco(ops: Operations[S], signals: Signals[S], p: Values) -> Sequence[Feature[S]]:
    """Return (T - Tc) x load."""
    rise = ops.affine(signals.temperature_degC, 1.0, -p["calibrated_degC"])
    return of_each_load(
        signals, p, "(T - Tc) {}", "K x load", lambda _, load: ops.product(rise, load)
    )


register(
    Effect(
        kind="span_tempco",
        title="TKC, span shift with temperature",
        build=build_span_tempco,
        parameters=(
            CROSS_AXES,
            Parameter(
                "calibrated_degC",
                "degC",
                -100.0,
                200.0,
                (15.0, 35.0),
                scale="linear",
                meaning="temperature Tc of the span's calibration, where it is right",
            ),
        ),
        needs=("temperature", "load"),
        physics="The gain moves with temperature: an LED gives less light when hot, the body's "
        "modulus falls, a gauge factor changes. The error grows with the load.",
        equation="drift = k (T-Tc) load",
        fingerprint="Nothing without load; under load a slope against T in proportion to it.",
        provoke="The same weight at three temperatures.",
        cure="Constant-light control of the LED by a monitor diode; modulus-compensated bridge.",
        source="LED data sheets: -0.3 to -0.9 %/K; VDI/VDE/DKD 2638: TKC",
        variants=({"cross_axes": 0}, {"cross_axes": 1}),
    )
)


def build_creep(ops: Operations[S], signals: Signals[S], p: Values) -> Sequence[Feature[S]]:
    """Return the load filtered by tau, and by a second, slower one where asked.

    A logarithmic creep is the mean of lowpasses a factor of 4 apart. A rate that depends on the
    temperature is taken to first order: with a rate 1 + b (T - T0), the creep is x + b x1, and x1
    is the lowpass of (T - T0)(load - x). Where the sensor was calibrated once it had crept, the
    load itself is taken off.
    """

    def creep(name: str, tau_s: float, respond: Callable[[S, float], S]) -> list[Feature[S]]:
        def make(_: str, load: S) -> S:
            crept = respond(load, tau_s)
            return ops.difference(crept, load) if p["settled"] else crept

        return [*of_each_load(signals, p, name, "load", make)]

    if p["logarithmic"]:
        return creep(
            "log creep {}", p["tau_s"], lambda x, tau_s: _creep_logarithmically(ops, x, tau_s)
        )
    features = creep("creep {}", p["tau_s"], ops.lowpass)
    if p["of_temperature"]:
        rise = ops.affine(signals.temperature_degC, 1.0, -signals.reference_temperature_degC)

        def hasten(_: str, load: S) -> S:
            open_yet = ops.difference(load, ops.lowpass(load, p["tau_s"]))
            return ops.lowpass(ops.product(rise, open_yet), p["tau_s"])

        features += of_each_load(signals, p, "creep rate {}", "K x load", hasten)
    if p["time_constants"] == 2:
        features += creep("slow creep {}", p["slow_tau_s"], ops.lowpass)
    return features


def _creep_logarithmically(ops: Operations[S], load: S, tau_s: float) -> S:
    """Return the mean of lowpasses whose time constants lie a factor of 4 apart."""
    total = ops.lowpass(load, tau_s)
    for n in range(1, LOG_CREEP_PARTS):
        total = ops.total(total, ops.lowpass(load, 4.0**n * tau_s))
    return ops.affine(total, 1.0 / LOG_CREEP_PARTS, 0.0)


def put_slower_last(p: Values) -> Values:
    """Return the values with the slower of two retardation times last."""
    if p["time_constants"] == 1 or p["slow_tau_s"] >= p["tau_s"]:
        return p
    return {**p, "tau_s": p["slow_tau_s"], "slow_tau_s": p["tau_s"]}


register(
    Effect(
        kind="creep",
        title="creep and creep recovery",
        build=build_creep,
        tidy=put_slower_last,
        parameters=(
            CROSS_AXES,
            Parameter(
                "time_constants",
                "1",
                1,
                2,
                (1, 2),
                scale="linear",
                default=1,
                choices=(1, 2),
                meaning="one retardation time, or two",
            ),
            Parameter(
                "tau_s",
                "s",
                5.0,
                20000.0,
                (60.0, 1800.0),
                source="creep is specified at 30 min",
                meaning="retardation time",
            ),
            Parameter(
                "slow_tau_s",
                "s",
                30.0,
                50000.0,
                (600.0, 5000.0),
                meaning="second retardation time",
                when={"time_constants": 2},
            ),
            Parameter(
                "logarithmic",
                "1",
                0,
                1,
                (0, 1),
                scale="linear",
                default=0,
                choices=(0, 1),
                meaning="1: the creep goes on with the logarithm of time, from tau_s to 256 tau_s",
            ),
            Parameter(
                "of_temperature",
                "1",
                0,
                1,
                (0, 1),
                scale="linear",
                default=0,
                choices=(0, 1),
                meaning="1: warm, the load creeps faster; to first order in T - T0",
            ),
            Parameter(
                "settled",
                "1",
                0,
                1,
                (0, 1),
                scale="linear",
                default=0,
                choices=(0, 1),
                meaning="1: calibrated once the load had crept, so that its first moments are off",
            ),
        ),
        needs=("load",),
        physics="Adhesive, gauge carrier and polymer bodies yield slowly under load and recover "
        "slowly when it is gone, as springs and dampers side by side (Kelvin-Voigt).",
        equation="drift = k LP(load, tau)  [+ k2 LP(load, slow_tau)]  "
        "[+ kT LP((T-T0)(load - LP(load, tau)), tau)]; "
        "logarithmic: mean of LP(load, 4^n tau), n = 0..4;  settled: LP(load, tau) - load",
        fingerprint="After a step of load an exponential approach over minutes, away from the true "
        "value or, calibrated when settled, towards it; after its removal the mirror image; "
        "independent of temperature's course.",
        provoke="Step the load on, hold it for half an hour, take it off, wait as long.",
        cure="Creep-matched gauges (end-loop length), metal instead of polymer.",
        source="OIML R 60: creep at 30 min in % of the applied load; Kelvin-Voigt model",
        variants=(
            {"time_constants": 1, "cross_axes": 0},
            {"time_constants": 1, "cross_axes": 0, "settled": 1},
            {"time_constants": 2, "cross_axes": 0},
            {"time_constants": 1, "cross_axes": 1},
            {"logarithmic": 1},
        ),
        upgrades=({"of_temperature": 1},),
    )
)


def build_load_hysteresis(
    ops: Operations[S], signals: Signals[S], p: Values
) -> Sequence[Feature[S]]:
    """Return the slack of one play of the load per output, or of three of different widths."""
    features: tuple[Feature[S], ...] = ()
    for share in (1.0,) if p["plays"] == 1 else (1.0 / 3.0, 1.0, 3.0):
        width = share * p["half_width_pct"] / 100.0

        def slack(output: str, load: S, width: float = width) -> S:
            return ops.difference(ops.play(load, width * signals.full_scale[output]), load)

        features += of_each_load(signals, p, f"slack {share:.3g} r of {{}}", "load", slack)
    return features


register(
    Effect(
        kind="load_hysteresis",
        title="hysteresis",
        build=build_load_hysteresis,
        parameters=(
            CROSS_AXES,
            Parameter(
                "plays",
                "1",
                1,
                3,
                (1, 3),
                scale="linear",
                default=1,
                choices=(1, 3),
                meaning="plays per output",
            ),
            Parameter(
                "half_width_pct",
                "% of full scale",
                0.05,
                50.0,
                (0.3, 15.0),
                meaning="half-width of the play",
                slack_in="load",
            ),
        ),
        needs=("load",),
        physics="Friction in joints and internal friction of the material keep part of the "
        "strain: the reading depends on whether the load is rising or falling.",
        equation="drift = k (play(load, r) - load)",
        fingerprint="Rising and falling branches against load differ, at any speed and at any "
        "temperature.",
        provoke="Load up in steps and down by the same steps; then a small inner loop.",
        cure="Fewer joints, higher preload, heat treatment of the body.",
        source="OIML R 60: hysteresis error; Prandtl-Ishlinskii model",
        variants=(
            {"plays": 1, "cross_axes": 0},
            {"plays": 3, "cross_axes": 0},
            {"plays": 1, "cross_axes": 1},
        ),
    )
)


def build_load_nonlinearity(
    ops: Operations[S], signals: Signals[S], p: Values
) -> Sequence[Feature[S]]:
    """Return load^2 and load^3."""
    squares = of_each_load(signals, p, "{}^2", "load2", lambda _, load: ops.power(load, 2))
    cubes = of_each_load(signals, p, "{}^3", "load3", lambda _, load: ops.power(load, 3))
    return squares + cubes


register(
    Effect(
        kind="load_nonlinearity",
        title="non-linearity",
        build=build_load_nonlinearity,
        parameters=(CROSS_AXES,),
        needs=("load",),
        physics="The body stiffens, the coupler's distance law bends, the bridge is unbalanced: "
        "the calibration's straight line is only a chord.",
        equation="drift = k2 load^2 + k3 load^3",
        fingerprint="A smooth curve against load, the same on the way up and down and at every "
        "temperature.",
        provoke="At least five loads over the whole range at one temperature.",
        cure="Symmetric body, a distance at which the coupler is most linear.",
        source="VDI/VDE/DKD 2638: linearity deviation",
        variants=({"cross_axes": 0}, {"cross_axes": 1}),
    )
)


def build_crosstalk(ops: Operations[S], signals: Signals[S], p: Values) -> Sequence[Feature[S]]:
    """Return all loads, seen by all outputs."""
    return tuple(Feature(output, load, "load") for output, load in signals.load.items())


register(
    Effect(
        kind="crosstalk",
        title="cross-talk, error of the calibration matrix",
        build=build_crosstalk,
        needs=("load",),
        physics="The calibration matrix that turns raw counts to forces is not quite right: "
        "a load on one axis shows on the others, and each axis's gain is a little off.",
        equation="drift = (C - I) load",
        fingerprint="In proportion to the loads, at once, at every temperature.",
        provoke="Load one axis at a time, at one temperature.",
        cure="Recalibrate with pure loads on each axis.",
        source="multi-axis calibration practice: 1 to 5 % of full scale without a full matrix",
    )
)


register(
    Effect(
        kind="adc_saturation",
        title="clipping at the converter's rails",
        sets_aside=True,
        needs=("saturated",),
        physics="Beyond the converter's input range the code stays at its first or last value, "
        "whatever load and temperature do. What was cut off cannot be computed back: samples at a "
        "rail are set aside from fit and error, and the chip flags them.",
        equation="measured = clip(load + drift, low, high)",
        fingerprint="Nothing up to a certain load, from there on the drift is minus what is above "
        "it; the measured value repeats its extreme exactly, without noise.",
        provoke="Load each axis to its full scale, both signs, hot and cold.",
        cure="Less gain, more range; firmware that flags codes at the rail.",
        source="converter data sheets: full-scale input range",
    )
)


def build_inertial_load(ops: Operations[S], signals: Signals[S], p: Values) -> Sequence[Feature[S]]:
    """Return the accelerations that are measured."""
    names = [name for name in ACCELERATIONS if name in signals.channels]
    return tuple(Feature(name, signals.channels[name], "m/s2") for name in names)


ACCELERATIONS = ("acceleration_x", "acceleration_y", "acceleration_z")

register(
    Effect(
        kind="inertial_load",
        title="inertial load of the upper plate",
        build=build_inertial_load,
        needs=("|".join(ACCELERATIONS),),
        physics="The plate above the sensing structure has a mass; when the sensor is shaken or "
        "turned, its weight and inertia load the structure though nothing touches it.",
        equation="drift = m a (and m a x lever arm for moments)",
        fingerprint="Follows the accelerometer at once; turns with the sensor's attitude.",
        provoke="Turn the unloaded sensor through six attitudes; shake it.",
        cure="A lighter plate; subtract mass times acceleration.",
        source="multi-axis force sensing on robots: tool and plate inertia compensation",
    )
)
