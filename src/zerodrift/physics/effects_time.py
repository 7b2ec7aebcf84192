"""Effects of time itself: warm-up and bias after power-on, ageing."""

import math
from collections.abc import Sequence

from zerodrift.dataset.times import DAY_S
from zerodrift.operations.backend import Operations
from zerodrift.physics.effect import Effect, Feature, Parameter, S, Signals, Values, register


def build_warm_up(ops: Operations[S], signals: Signals[S], p: Values) -> Sequence[Feature[S]]:
    """Return 1 - exp(-t/tau) since power-on."""
    halvings = ops.affine(signals.elapsed_s, -1.0 / (p["tau_s"] * math.log(2.0)), 0.0)
    return (Feature("warm-up", ops.affine(ops.exp2(halvings), -1.0, 1.0), "1"),)


register(
    Effect(
        kind="warm_up",
        title="start-up drift, self-heating",
        build=build_warm_up,
        parameters=(
            Parameter(
                "tau_s",
                "s",
                5.0,
                7200.0,
                (60.0, 1200.0),
                source="2 to 15 K of self-heating within 1 to 20 min",
                meaning="time constant of the self-heating",
            ),
        ),
        needs=("elapsed",),
        physics="LEDs and electronics heat the element from inside when power comes on, by some "
        "kelvin and partly unseen by the thermometer, until heat flows out as fast as it comes.",
        equation="drift = k (1 - exp(-t/tau))",
        fingerprint="The same exponential at the start of every run, whatever the temperature.",
        provoke="Cold power-on at constant temperature, several times, logging from the first "
        "second and not taring.",
        cure="Less LED current, pulsed operation, a warm-up time before taring.",
        source="load-cell and photo-coupler practice: warm-up time 1 to 20 min",
    )
)


def build_turn_on_bias(ops: Operations[S], signals: Signals[S], p: Values) -> Sequence[Feature[S]]:
    """Return the zero read at power-on, and for `decays` = 1 what has decayed of it since."""
    bias = signals.channels["turn_on"]
    if not p["decays"]:
        return (Feature("zero at power-on", bias, "1"),)
    halvings = ops.affine(signals.elapsed_s, -1.0 / (p["tau_s"] * math.log(2.0)), 0.0)
    left = ops.product(bias, ops.exp2(halvings))
    return (Feature("zero at power-on", bias, "1"), Feature("what is left of it", left, "1"))


register(
    Effect(
        kind="turn_on_bias",
        title="turn-on bias, repeatability of the zero from power-on to power-on",
        build=build_turn_on_bias,
        parameters=(
            Parameter(
                "decays",
                "1",
                0,
                1,
                (0, 1),
                scale="linear",
                default=0,
                choices=(0, 1),
                meaning="0: it stays as it is; 1: a part of it decays",
            ),
            Parameter(
                "tau_s",
                "s",
                5.0,
                7200.0,
                (60.0, 1200.0),
                source="settling of inertial sensors after power-on: 1 to 20 min",
                meaning="time constant of the decay",
                when={"decays": 1},
            ),
        ),
        needs=("elapsed", "turn_on"),
        physics="Stress, charge and the state of a feedback loop settle a little differently at "
        "every power-on, so that each one draws a zero of its own, which stays or fades. Nobody "
        "can know it beforehand; what is read at power-on, at rest and unloaded, tells it.",
        equation="drift = k z0  [+ kd z0 exp(-t/tau)], z0 the input `turn_on`: the zero read at "
        "power-on",
        fingerprint="Each run has an offset of its own, drawn anew at power-on whatever the "
        "temperature, the same from the first row to the last or fading from then on.",
        provoke="Ten times power-off and power-on at one temperature, at rest and unloaded, from "
        "the first second and not tared; log the mean of the first seconds as `turn_on`, the "
        "same number in all rows of a run.",
        cure="Tare after power-on where the load allows it; keep the power on.",
        source="IEEE Std 528-2019: turn-on to turn-on repeatability of the bias; IEEE Std 952-1997",
        variants=({"decays": 0}, {"decays": 1}),
    )
)


def build_ageing(ops: Operations[S], signals: Signals[S], p: Values) -> Sequence[Feature[S]]:
    """Return t, or t^p for `power_law` = 1, with t in days; on request also that of the span."""
    age, name, unit = ops.affine(signals.clock_s, 1.0 / DAY_S, 0.0), "age", "day"
    if p["power_law"]:
        age, name, unit = ops.power(age, p["exponent"]), "age^p", "day^p"
    if not p["of_span"]:
        return (Feature(name, age, unit),)
    return Feature(name, age, unit), *(
        Feature(f"{name} x {output}", ops.product(age, load), f"{unit} x load", output)
        for output, load in signals.load.items()
    )


register(
    Effect(
        kind="ageing",
        title="long-term drift",
        build=build_ageing,
        parameters=(
            Parameter(
                "power_law",
                "1",
                0,
                1,
                (0, 1),
                scale="linear",
                default=0,
                choices=(0, 1),
                meaning="0: a straight line; 1: a power of time",
            ),
            Parameter(
                "exponent",
                "1",
                0.1,
                1.5,
                (0.3, 0.9),
                scale="linear",
                meaning="power of time",
                when={"power_law": 1},
            ),
            Parameter(
                "of_span",
                "1",
                0,
                1,
                (0, 1),
                scale="linear",
                default=0,
                choices=(0, 1),
                meaning="1: the span ages too, by a share of the load",
            ),
        ),
        needs=("clock",),
        physics="Stress relaxes, adhesives cure, LEDs lose light: the zero wanders with age, fast "
        "at first.",
        equation="drift = k t  or  k t^p  [+ ks t load]",
        fingerprint="A slope in time that goes on from run to run, whatever the temperature; that "
        "of the span under load alone, in proportion to it.",
        provoke="The same temperature cycle and the same weight again after days, "
        "with an absolute clock in the logs.",
        cure="Burn-in before calibration; recalibration.",
        source="LED lumen maintenance; OIML R 60: zero stability",
        variants=({"power_law": 0}, {"power_law": 1}),
        upgrades=({"of_span": 1},),
    )
)
