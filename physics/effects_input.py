"""Effects of other channels: supply, humidity, ambient light."""

from collections.abc import Sequence

from zerodrift.operations.backend import Operations
from zerodrift.physics.effect import Effect, Feature, Parameter, S, Signals, Values
from zerodrift.physics.registry import register


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
    """Return the relative humidity filtered by tau."""
    wet = ops.lowpass(signals.channels["humidity"], p["tau_s"])
    return (Feature("moisture", wet, "%RH"),)


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
        ),
        needs=("humidity",),
        physics="Adhesives, gauge carriers and circuit boards take up water and swell, over hours, "
        "and give it back.",
        equation="drift = k LP(RH, tau)",
        fingerprint="A slow approach after every step of humidity, at constant temperature.",
        provoke="Step the humidity at constant temperature and wait for several hours.",
        cure="Hermetic sealing, coating, metal bellows.",
        source="OIML R 60: CH and SH humidity tests; diffusion into thin layers",
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
