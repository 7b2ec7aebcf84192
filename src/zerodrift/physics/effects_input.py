"""Effects of other channels: supply and its heat, humidity, ambient light, air pressure."""

from collections.abc import Sequence

from zerodrift.operations.backend import Operations
from zerodrift.physics.effect import Effect, Feature, Parameter, S, Signals, Values, register


def build_supply_sensitivity(
    ops: Operations[S], signals: Signals[S], p: Values
) -> Sequence[Feature[S]]:
    """Return V, and where asked (V - V0) x load."""
    supply = signals.channels["supply"]
    features: tuple[Feature[S], ...] = (Feature("supply", supply, "V"),)
    if p["ratiometric"]:
        excess = ops.affine(supply, 1.0, -p["nominal_V"])
        features += tuple(
            Feature(f"supply x {output}", ops.product(excess, load), "V x load", output)
            for output, load in signals.load.items()
        )
    return features


register(
    Effect(
        kind="supply_sensitivity",
        title="supply influence",
        build=build_supply_sensitivity,
        parameters=(
            Parameter(
                "ratiometric",
                "1",
                0,
                1,
                (0, 1),
                scale="linear",
                default=0,
                choices=(0, 1),
                meaning="1: the gain follows the supply too",
            ),
            Parameter(
                "nominal_V",
                "V",
                0.0,
                60.0,
                (3.0, 12.0),
                scale="linear",
                meaning="supply V0 at which the gain was calibrated",
                when={"ratiometric": 1},
            ),
        ),
        needs=("supply",),
        physics="LED current, bridge excitation and references follow the supply more or less. "
        "Zero and, where the converter does not measure ratiometrically, gain move with it.",
        equation="drift = k (V-V0)  [+ kr (V-V0) load]",
        fingerprint="Steps and ripple of the supply, at once and at every temperature.",
        provoke="Step the supply by 5 % up and down at rest, then under a static load.",
        cure="A regulator, ratiometric conversion, a constant-current LED drive.",
        source="VDI/VDE/DKD 2638: influence of the supply voltage",
        variants=({"ratiometric": 0}, {"ratiometric": 1}),
    )
)


def build_humidity(ops: Operations[S], signals: Signals[S], p: Values) -> Sequence[Feature[S]]:
    """Return the relative humidity filtered by tau, or its distance from that.

    On request with the effect of moisture on the span.
    """
    humidity = signals.channels["humidity"]
    wet = ops.lowpass(humidity, p["tau_s"])
    if p["of_rate"]:
        return (Feature("moisture gradient", ops.difference(humidity, wet), "%RH"),)
    if not p["of_span"]:
        return (Feature("moisture", wet, "%RH"),)
    return Feature("moisture", wet, "%RH"), *(
        Feature(f"moisture x {output}", ops.product(wet, load), "%RH x load", output)
        for output, load in signals.load.items()
    )


register(
    Effect(
        kind="humidity",
        title="moisture",
        build=build_humidity,
        parameters=(
            Parameter(
                "tau_s",
                "s",
                10.0,
                200000.0,
                (600.0, 20000.0),
                source="moisture uptake of adhesives and carriers: hours",
                meaning="time constant of the uptake",
            ),
            Parameter(
                "of_rate",
                "1",
                0,
                1,
                (0, 1),
                scale="linear",
                default=0,
                choices=(0, 1),
                meaning="1: only the difference between surface and inside counts, which a change "
                "of humidity makes and which passes",
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
                meaning="1: the moisture changes the span too, counted from dry",
            ),
        ),
        needs=("humidity",),
        physics="Adhesives, gauge carriers and circuit boards take up water and swell, over hours, "
        "and give it back.",
        equation="drift = k LP(RH, tau) [+ ks LP(RH, tau) load];  of_rate: k (RH - LP(RH, tau))",
        fingerprint="A slow approach after every step of humidity, at constant temperature.",
        provoke="Step the humidity at constant temperature and wait for several hours.",
        cure="Hermetic sealing, coating, metal bellows.",
        source="OIML R 60: CH and SH humidity tests; diffusion into thin layers",
        variants=({"of_rate": 0, "of_span": 0}, {"of_rate": 1}),
        upgrades=({"of_span": 1},),
    )
)


def build_ambient_light(ops: Operations[S], signals: Signals[S], p: Values) -> Sequence[Feature[S]]:
    """Return the illuminance."""
    return (Feature("stray light", signals.channels["ambient_light"], "lux"),)


register(
    Effect(
        kind="ambient_light",
        title="stray light",
        build=build_ambient_light,
        needs=("ambient_light",),
        physics="Light that leaks to the photo-transistors adds a current of its own.",
        equation="drift = k lux",
        fingerprint="Follows the lamp at once, at every temperature.",
        provoke="Switch a lamp on and off at rest; turn the sensor in sunlight.",
        cure="A shroud, a filter for the LED's wavelength, modulation.",
        source="reflective photo-coupler data sheets: ambient light",
    )
)


def build_excitation_heating(
    ops: Operations[S], signals: Signals[S], p: Values
) -> Sequence[Feature[S]]:
    """Return the power filtered by tau: that which is logged, or the square of the supply."""
    if "power" in signals.channels:
        return (Feature("heat", ops.lowpass(signals.channels["power"], p["tau_s"]), "W"),)
    squared = ops.power(signals.channels["supply"], 2)
    return (Feature("heat", ops.lowpass(squared, p["tau_s"]), "V2"),)


register(
    Effect(
        kind="excitation_heating",
        title="self-heating by the excitation",
        build=build_excitation_heating,
        parameters=(
            Parameter(
                "tau_s",
                "s",
                5.0,
                20000.0,
                (30.0, 1800.0),
                meaning="time constant with which the element warms up",
            ),
        ),
        needs=("power|supply",),
        physics="The bridge, the heater or the LED turns its supply into heat, V^2/R, and the "
        "element grows warmer than the thermometer shows, with a time constant of its own.",
        equation="drift = k LP(P, tau), P the input `power` or V^2",
        fingerprint="A slow approach after every step of the supply or of the power, where the "
        "supply's own influence is at once.",
        provoke="Step the excitation at constant temperature and wait for several time constants.",
        cure="Less excitation, pulsed excitation, a better heat path to the body.",
        source="strain-gauge practice: excitation level against self-heating of the gauge",
    )
)


def build_barometric_pressure(
    ops: Operations[S], signals: Signals[S], p: Values
) -> Sequence[Feature[S]]:
    """Return the air pressure."""
    return (Feature("air pressure", signals.channels["pressure"], "hPa"),)


register(
    Effect(
        kind="barometric_pressure",
        title="influence of the barometric pressure",
        build=build_barometric_pressure,
        needs=("pressure",),
        physics="Air presses on a sealed body, on a membrane or on bellows; gas sensors see the "
        "partial pressure, which grows with the whole.",
        equation="drift = k p",
        fingerprint="Follows the barometer over hours and at once, with the weather, doors and "
        "lifts, at every temperature.",
        provoke="Log through a change of weather, or in a pressure chamber; carry it up a house.",
        cure="A vented body, a pair of membranes back to back.",
        source="OIML R 60: effect of the barometric pressure on the minimum dead load output",
    )
)
