"""Effects of the element's temperature on the zero: tempco, dark current, gradient."""

from collections.abc import Sequence

from zerodrift.operations.backend import Operations
from zerodrift.physics.effect import Effect, Feature, Parameter, S, Signals, Values, register


def build_zero_tempco(ops: Operations[S], signals: Signals[S], p: Values) -> Sequence[Feature[S]]:
    """Return (T - T0), (T - T0)^2, ... up to the order."""
    rise = ops.affine(signals.temperature_degC, 1.0, -signals.reference_temperature_degC)
    first = Feature("T - T0", rise, "K")
    return first, *(
        Feature(f"(T - T0)^{n}", ops.power(rise, n), f"K{n}")
        for n in range(2, round(p["order"]) + 1)
    )


register(
    Effect(
        kind="zero_tempco",
        title="TK0, zero shift with temperature",
        build=build_zero_tempco,
        parameters=(
            Parameter(
                "order",
                "1",
                1,
                5,
                (1, 3),
                scale="linear",
                default=1,
                choices=(1, 2, 3, 4, 5),
                meaning="degree of the polynomial",
            ),
        ),
        needs=("temperature",),
        physics="Thermal expansion of body, adhesive and gauge, and the tempco of resistors and "
        "offset voltages, move the unloaded reading with temperature, at once and reversibly.",
        equation="drift = k1 (T-T0) [+ k2 (T-T0)^2 + ... up to (T-T0)^5]",
        fingerprint="A straight line, or with higher order a smooth curve, against T; the same on "
        "the way up and down and at every ramp rate.",
        provoke="Slow ramps over the whole temperature range, unloaded.",
        cure="Matched gauges, a full bridge, a compensating resistor.",
        source="VDI/VDE/DKD 2638: TK0; strain gauges about 0.05 % of full scale per 10 K; "
        "quartz crystals: frequency against temperature to third and, at the ends, fifth order",
        variants=({"order": 1}, {"order": 2}, {"order": 3}),
        upgrades=({"order": 4}, {"order": 5}),
    )
)


def build_dark_current(ops: Operations[S], signals: Signals[S], p: Values) -> Sequence[Feature[S]]:
    """Return 2^((T - T0)/Td)."""
    doublings = ops.affine(
        signals.temperature_degC,
        1.0 / p["doubling_K"],
        -signals.reference_temperature_degC / p["doubling_K"],
    )
    return (Feature("dark current", ops.exp2(doublings), "I(T0)"),)


register(
    Effect(
        kind="dark_current",
        title="photo-transistor dark current",
        build=build_dark_current,
        parameters=(
            Parameter(
                "doubling_K",
                "K",
                5.0,
                25.0,
                (8.0, 12.0),
                source="silicon photo-transistors: a factor of 10 per 25 to 35 K",
                meaning="temperature rise that doubles the dark current",
            ),
        ),
        needs=("temperature",),
        physics="A photo-transistor passes a current in the dark: carriers freed by heat. Their "
        "number grows exponentially, doubling every 8 to 12 K, and is added to the light's.",
        equation="drift = I0 2^((T-T0)/Td)",
        fingerprint="Flat in the cold and steeper and steeper in the heat; a straight line in "
        "log(drift); largest on the axes whose couplers see least light.",
        provoke="A slow ramp to the hottest allowed temperature, unloaded.",
        cure="Modulate the LED and subtract the dark reading; brighter LED, nearer reflector.",
        source="reflective photo-coupler data sheets: dark current against ambient temperature",
    )
)


def build_thermal_gradient(
    ops: Operations[S], signals: Signals[S], p: Values
) -> Sequence[Feature[S]]:
    """Return dT/dt in K/s, smoothed over `smoothing_s` without delay to first order: 2 s - LP(s).

    s = (T - LP(T)) / smoothing_s is the slope with a lag of `smoothing_s`; adding s - LP(s)
    corrects that lag to first order.
    """
    temperature = signals.temperature_degC
    smooth_s = max(p["smoothing_s"], ops.sample_period_s)
    behind = ops.difference(temperature, ops.lowpass(temperature, smooth_s))
    late = ops.affine(behind, 1.0 / smooth_s, 0.0)
    slope = ops.total(late, ops.difference(late, ops.lowpass(late, smooth_s)))
    return (Feature("dT/dt", slope, "K/s"),)


register(
    Effect(
        kind="thermal_gradient",
        title="gradient error",
        build=build_thermal_gradient,
        parameters=(
            Parameter(
                "smoothing_s",
                "s",
                0.5,
                30.0,
                (1.0, 10.0),
                is_setting=True,
                meaning="the slope is taken over this time, at least one sample: short where the "
                "temperature bends fast, long where the chip's quantization shows",
            ),
        ),
        needs=("temperature",),
        physics="While heat flows, one side of the body is warmer than the other and the body "
        "bends. The difference is in proportion to the heat flow, hence to the rate of change.",
        equation="drift = k dT/dt",
        fingerprint="In proportion to the ramp rate with opposite signs up and down, at once and "
        "without memory; vanishes as soon as the ramp ends.",
        provoke="Ramps at two rates with sharp ends; heating from one side.",
        cure="Symmetric mounting, a heat spreader, insulation of the one-sided heat path.",
        source="load-cell practice: OIML R 60, humidity and temperature gradient effects",
    )
)
