"""Six families of sensors, with what data sheets say of each.

Orders of magnitude are of published data sheets and standards; a specimen's own values are drawn
about them. Nothing here was measured by this project: what comes out is simulated.
"""

from dataclasses import dataclass

THERMAL = ("thermal_lag", "thermal_gradient", "warm_up", "thermal_hysteresis")


@dataclass(frozen=True)
class Family:
    """A kind of sensor.

    Attributes:
        name: of the family.
        output: names of its outputs, as many as it can have.
        unit: of its outputs.
        full_scale: in the unit, from which one is drawn.
        zero_pct_per_k: of full scale per kelvin, about: the zero's first coefficient.
        zero_order: orders that the zero's polynomial may have.
        span_pct_per_k: of the reading per kelvin, about.
        noise_pct: RMS of noise in % of full scale, about.
        period_s: of a row, from which one is drawn.
        span_degc: lowest and highest temperature of use.
        both_signs: whether a load may be negative.
        follows_s: time constants by which heat reaches the thermometer's place from the air.
        effects: names in the catalogue of what such a sensor truly has.
        needs: inputs that are always logged, for such sensors are sold with them.
        source: where the values come from.
    """

    name: str
    output: tuple[str, ...]
    unit: str
    full_scale: tuple[float, ...]
    zero_pct_per_k: float
    zero_order: tuple[int, ...]
    span_pct_per_k: float
    noise_pct: float
    period_s: tuple[float, ...]
    span_degc: tuple[float, float]
    both_signs: bool
    follows_s: tuple[float, float]
    effects: tuple[str, ...]
    source: str


FAMILIES = {
    family.name: family
    for family in (
        Family(
            name="gyro",
            output=("wx", "wy"),
            unit="deg/s",
            full_scale=(250.0, 500.0, 2000.0),
            zero_pct_per_k=0.006,
            zero_order=(1, 2, 3),
            span_pct_per_k=0.02,
            noise_pct=0.012,
            period_s=(1.0,),
            span_degc=(-20.0, 70.0),
            both_signs=True,
            follows_s=(20.0, 90.0),
            effects=(
                *THERMAL,
                *("span_tempco", "crosstalk", "supply_sensitivity", "inertial_load"),
                *("humidity", "ageing"),
            ),
            source="consumer and industrial MEMS gyros: 0.005 to 0.05 deg/s/K, 0.03 %/K, 0.1 "
            "deg/s/g, hysteresis of 0.1 deg/s; IEEE Std 1431",
        ),
        Family(
            name="pressure",
            output=("p",),
            unit="kPa",
            full_scale=(100.0, 250.0, 1000.0),
            zero_pct_per_k=0.03,
            zero_order=(1, 2),
            span_pct_per_k=0.08,
            noise_pct=0.006,
            period_s=(1.0, 2.0),
            span_degc=(-20.0, 85.0),
            both_signs=False,
            follows_s=(60.0, 200.0),
            effects=(
                *THERMAL,
                *("span_tempco", "creep", "load_hysteresis", "load_nonlinearity"),
                *("supply_sensitivity", "excitation_heating", "inertial_load", "dark_current"),
                *("barometric_pressure", "ambient_light", "ageing"),
            ),
            source="piezoresistive silicon: zero 0.01 to 0.1 %FS/K, span -0.2 %/K before its "
            "resistor; Kim, Wise, IEEE Trans. Electron Devices 30 (1983) 802",
        ),
        Family(
            name="load_cell",
            output=("m",),
            unit="kg",
            full_scale=(5.0, 50.0, 200.0),
            zero_pct_per_k=0.006,
            zero_order=(1, 2),
            span_pct_per_k=0.004,
            noise_pct=0.002,
            period_s=(1.0, 2.0),
            span_degc=(-10.0, 50.0),
            both_signs=False,
            follows_s=(150.0, 500.0),
            effects=(
                *THERMAL,
                *("span_tempco", "creep", "load_hysteresis", "load_nonlinearity"),
                *("supply_sensitivity", "excitation_heating", "humidity", "inertial_load"),
                *("barometric_pressure", "ageing"),
            ),
            source="OIML R 60 classes C1 to C3: temperature, creep at 30 min, humidity, "
            "barometric pressure; Bartel, Yaniv, J. Res. NIST 102 (1997) 349 (creep)",
        ),
        Family(
            name="gas",
            output=("c",),
            unit="ppm",
            full_scale=(500.0, 2000.0, 5000.0),
            zero_pct_per_k=0.03,
            zero_order=(1, 2),
            span_pct_per_k=0.2,
            noise_pct=0.05,
            period_s=(2.0, 5.0),
            span_degc=(-5.0, 50.0),
            both_signs=False,
            follows_s=(100.0, 300.0),
            effects=(
                *("thermal_lag", "warm_up", "span_tempco", "load_nonlinearity", "humidity"),
                *("barometric_pressure", "ambient_light", "dark_current"),
                *("supply_sensitivity", "ageing"),
            ),
            source="NDIR: Beer and Lambert's law, ideal gas law, lamp's warm-up; electrochemical "
            "cells: zero current that doubles every 10 K, transients of humidity",
        ),
        Family(
            name="hall",
            output=("b",),
            unit="mT",
            full_scale=(50.0, 100.0, 200.0),
            zero_pct_per_k=0.01,
            zero_order=(1, 2),
            span_pct_per_k=0.05,
            noise_pct=0.01,
            period_s=(1.0,),
            span_degc=(-30.0, 100.0),
            both_signs=True,
            follows_s=(30.0, 120.0),
            effects=(
                *THERMAL,
                *("span_tempco", "load_nonlinearity", "supply_sensitivity"),
                *("excitation_heating", "humidity", "ageing"),
            ),
            source="silicon Hall plates: Popovic, Hall Effect Devices, ch. 4 and 5 (offset, "
            "piezo-Hall effect of the package, moisture in it, span at constant current)",
        ),
        Family(
            name="strain",
            output=("e",),
            unit="um/m",
            full_scale=(1000.0, 2000.0, 3000.0),
            zero_pct_per_k=0.04,
            zero_order=(2, 3),
            span_pct_per_k=0.01,
            noise_pct=0.02,
            period_s=(1.0, 2.0),
            span_degc=(-20.0, 80.0),
            both_signs=True,
            follows_s=(60.0, 250.0),
            effects=(
                *THERMAL,
                *("span_tempco", "creep", "load_hysteresis", "supply_sensitivity"),
                *("excitation_heating", "humidity", "ageing"),
            ),
            source="bonded foil gauges: thermal output as a polynomial, gauge factor +0.01 %/K; "
            "Window, Strain Gauge Technology, ch. 3 and 4; VDI/VDE 2635",
        ),
    )
}
INPUTS = {
    "supply": "supply_V",
    "humidity": "humidity_pct",
    "pressure": "baro_hPa",
    "ambient_light": "light_lux",
    "acceleration_x": "ax_mps2",
    "acceleration_y": "ay_mps2",
    "acceleration_z": "az_mps2",
    "body_temperature": "t_body_degC",
    "clock": "clock_s",
}
"""Name in [inputs] -> column."""
NEEDED = {
    "supply_sensitivity": ("supply",),
    "excitation_heating": ("supply",),
    "humidity": ("humidity",),
    "barometric_pressure": ("pressure",),
    "ambient_light": ("ambient_light",),
    "inertial_load": ("acceleration_x", "acceleration_y", "acceleration_z"),
    "ageing": ("clock",),
    "interaction": ("humidity",),
    "dew": ("humidity",),
}
"""Hidden effect -> the inputs that its programme moves and logs."""
OF_LOAD = ("span_tempco", "creep", "load_hysteresis", "load_nonlinearity", "crosstalk")
