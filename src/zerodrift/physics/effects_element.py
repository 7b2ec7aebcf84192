"""Effects on the temperature of the sensing element: clock skew, thermal lag, hysteresis.

They rewrite the temperature that every temperature-driven effect sees, in this order.
"""

from collections.abc import Sequence
from dataclasses import replace

from zerodrift.operations.backend import Operations
from zerodrift.physics.effect import Effect, Feature, Parameter, S, Signals, Values, register


def rewrite_clock_delay(ops: Operations[S], signals: Signals[S], p: Values) -> Signals[S]:
    """Shift the temperature in time: later for delay_s > 0, ahead along its slope for < 0."""
    temperature = signals.temperature_degC
    if p["delay_s"] >= 0.0:
        shifted = ops.delay(temperature, p["delay_s"])
    else:
        window_s = 5.0 * ops.sample_period_s
        # Ahead of time only the slope is known: that of the last five samples, to reduce noise.
        rise = ops.difference(temperature, ops.delay(temperature, window_s))
        shifted = ops.total(temperature, ops.affine(rise, -p["delay_s"] / window_s, 0.0))
    return replace(signals, temperature_degC=shifted)


register(
    Effect(
        kind="clock_delay",
        title="time skew between chip and ADC",
        rewrite=rewrite_clock_delay,
        parameters=(
            Parameter(
                "delay_s",
                "s",
                -10.0,
                10.0,
                (-2.0, 2.0),
                scale="linear",
                source="TMP117 data sheet: up to 64 averages, 1 s",
                meaning="how much earlier than the thermometer's sample the element was read; "
                "negative: the thermometer reports late",
            ),
        ),
        needs=("temperature",),
        physics="The thermometer chip averages for up to a second and is read over a bus, the "
        "converter samples at another moment. While the temperature moves, the two disagree by "
        "the slope times the skew, although both are right.",
        equation="T'(t) = T(t - d)",
        fingerprint="In proportion to dT/dt and to the slope of all temperature terms alike; "
        "changes sign between heating and cooling; vanishes at rest.",
        provoke="The fastest ramps that the chamber or an infrared heater gives, both ways.",
        cure="Time-stamp both samples; shorten the chip's averaging.",
        source="TMP117 data sheet (conversion cycle, averaging)",
    )
)


def rewrite_thermal_lag(ops: Operations[S], signals: Signals[S], p: Values) -> Signals[S]:
    """Let the element follow the thermometer through one or two lags, unless it acts on its own."""
    if p["own_terms"]:
        return signals
    temperature = signals.temperature_degC
    lagged = ops.lowpass(temperature, p["tau_s"])
    if p["time_constants"] == 2:
        slow = ops.lowpass(temperature, p["slow_tau_s"])
        lagged = ops.total(
            ops.affine(lagged, 1.0 - p["slow_share"], 0.0), ops.affine(slow, p["slow_share"], 0.0)
        )
    return replace(signals, temperature_degC=lagged)


def build_thermal_lag(ops: Operations[S], signals: Signals[S], p: Values) -> Sequence[Feature[S]]:
    """Return LP(T) where it has coefficients of its own."""
    if not p["own_terms"]:
        return ()
    return (Feature("slow T", ops.lowpass(signals.temperature_degC, p["tau_s"]), "K"),)


def put_slower_last(p: Values) -> Values:
    """Return the same response with the slower of two time constants as the slow one."""
    if p["time_constants"] == 1 or p["slow_tau_s"] >= p["tau_s"]:
        return p
    swapped = {"tau_s": p["slow_tau_s"], "slow_tau_s": p["tau_s"]}
    return {**p, **swapped, "slow_share": 1.0 - p["slow_share"]}


register(
    Effect(
        kind="thermal_lag",
        title="thermal lag of the element behind the chip",
        rewrite=rewrite_thermal_lag,
        build=build_thermal_lag,
        tidy=put_slower_last,
        parameters=(
            Parameter(
                "time_constants",
                "1",
                1,
                2,
                (1, 2),
                scale="linear",
                default=1,
                choices=(1, 2),
                meaning="one lag, or a fast and a slow one side by side",
            ),
            Parameter(
                "tau_s",
                "s",
                1.0,
                100000.0,
                (5.0, 600.0),
                source="body of 45 g against a chip of milligrams; oven logs of resistors 200 s",
                meaning="time constant of the element",
            ),
            Parameter(
                "slow_tau_s",
                "s",
                10.0,
                100000.0,
                (60.0, 5000.0),
                meaning="second, slower time constant",
                when={"time_constants": 2},
            ),
            Parameter(
                "slow_share",
                "1",
                -0.5,
                1.0,
                (0.1, 0.6),
                scale="linear",
                meaning="share of the response that takes the slow way",
                when={"time_constants": 2},
            ),
            Parameter(
                "own_terms",
                "1",
                0,
                1,
                (0, 1),
                scale="linear",
                default=0,
                choices=(0, 1),
                meaning="0: all temperature terms see the lag; 1: a slow zero shift beside them, "
                "with coefficients of its own (a part that lags, or the gradient of a body: the "
                "thermometer's temperature less the lagged one)",
            ),
        ),
        needs=("temperature",),
        physics="The thermometer sits on the board, the element on the body. Heat reaches the "
        "element later, through a thermal resistance into a heat capacity, so the element's "
        "temperature is the chip's, low-passed. Heat that comes by two ways gives two time "
        "constants.",
        equation="tau dTe/dt + Te = T;  two: Te = (1-w) LP(T, tau) + w LP(T, slow_tau);  "
        "own: drift = k LP(T, tau)",
        fingerprint="Loops of drift against T, wider the faster the ramp; decays "
        "exponentially after a ramp ends; every temperature term is delayed alike.",
        provoke="Ramps at two clearly different rates with dwells of several tau between them.",
        cure="Move the thermometer onto the element's body; couple both with a thermal pad.",
        source="lumped heat capacity; Incropera, Fundamentals of Heat and Mass Transfer, ch. 5",
        variants=({"time_constants": 1}, {"time_constants": 2}),
        run_variants=({"own_terms": 1},),
    )
)


def _play(ops: Operations[S], signals: Signals[S], half_width_K: float) -> S:
    """Return the play of the temperature, from the side that each run came from."""
    if signals.arrival_K is None:
        return ops.play(signals.temperature_degC, half_width_K)
    arriving = ops.total(signals.temperature_degC, signals.arrival_K)
    return ops.difference(ops.play(arriving, half_width_K), signals.arrival_K)


def rewrite_thermal_hysteresis(ops: Operations[S], signals: Signals[S], p: Values) -> Signals[S]:
    """Let every temperature term see the temperature through a play, unless it acts on its own."""
    if p["own_terms"]:
        return signals
    return replace(signals, temperature_degC=_play(ops, signals, p["half_width_K"]))


def build_thermal_hysteresis(
    ops: Operations[S], signals: Signals[S], p: Values
) -> Sequence[Feature[S]]:
    """Return the slack of one play, or of three of different width, for `own_terms` outputs."""
    temperature = signals.temperature_degC
    widths = {0.0: (), 1.0: (1.0,), 3.0: (1.0 / 3.0, 1.0, 3.0)}[float(p["own_terms"])]
    return tuple(
        Feature(
            f"slack {share:.3g} r",
            ops.difference(_play(ops, signals, share * p["half_width_K"]), temperature),
            "K",
        )
        for share in widths
    )


register(
    Effect(
        kind="thermal_hysteresis",
        title="temperature hysteresis",
        rewrite=rewrite_thermal_hysteresis,
        build=build_thermal_hysteresis,
        parameters=(
            Parameter(
                "own_terms",
                "1",
                0,
                3,
                (0, 3),
                scale="linear",
                default=0,
                choices=(0, 1, 3),
                meaning="0: all temperature terms see the play; 1 or 3: that many plays with "
                "coefficients of their own",
            ),
            Parameter(
                "half_width_K",
                "K",
                0.02,
                40.0,
                (0.2, 10.0),
                meaning="half-width of the play",
                slack_in="temperature",
            ),
        ),
        needs=("temperature",),
        physics="Adhesives, solder and the body's own crystal structure keep part of the last "
        "thermal strain: coming from the cold the zero is another than coming from the heat, "
        "however long one waits.",
        equation="Tp[n] = min(max(Tp[n-1], T - r), T + r)",
        fingerprint="Up and down branches of drift against T differ by the same amount at every "
        "ramp rate, also after a dwell; a jump at each turning point that fills over 2 r.",
        provoke="A full loop hot-cold-hot, then the same loop at a third of the rate, and a small "
        "inner loop.",
        cure="Anneal or cycle before calibration; softer adhesive, thinner solder.",
        source="Brokate and Sprekels, Hysteresis and Phase Transitions (play operator)",
        variants=({"own_terms": 0}, {"own_terms": 1}, {"own_terms": 3}),
    )
)
