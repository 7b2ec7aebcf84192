"""The small zerodrift.toml that tests of many folders write."""

SENSOR = """\
[sensor]
name = "{name}"
time = "time_s"
temperature = "temperature_degC"
sample_period_s = {period_s}
"""
FORCE = """
[outputs.Fz]
measured = "Fz_N"
reference = "ref_Fz_N"
unit = "N"
full_scale = 2000
"""
MOMENT = """
[outputs.Mx]
measured = "Mx_Nm"
reference = "ref_Mx_Nm"
unit = "Nm"
full_scale = 14
"""


def render_toml(
    rest: str, name: str = "ft40", period_s: float = 1.0, outputs: tuple[str, ...] = (FORCE, MOMENT)
) -> str:
    """Return `[sensor]`, the outputs' tables, and the rest, which begins with `[logs]`, say."""
    return SENSOR.format(name=name, period_s=period_s) + "".join(outputs) + "\n" + rest
