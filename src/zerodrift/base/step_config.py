"""The keys of `[sensor]` that say when the firmware's steps come."""

from dataclasses import dataclass

from zerodrift.base.toml_table import TomlTable

STEP_KEYS = ("sample_period_s", "log_period_s")
VARIABLE = "variable"
SHORTEST_S, LONGEST_S = 1e-6, 4294.0
"""Of the rows of a variable step's logs: the firmware counts microseconds in 32 bits there."""
ANY_STEP_KINDS = ("none", "lag_bank", "mlp")
"""Networks that carry nothing from sample to sample but low-passes."""


@dataclass(frozen=True)
class StepConfig:
    """When steps come."""

    period_s: float
    """Seconds between two steps; of a variable step, between two rows of the logs."""
    is_variable: bool
    """Whether each step is given the time since the last one."""


def read_step(sensor: TomlTable) -> StepConfig:
    """Return the keys of `[sensor]` on the step.

    Raises:
        InputError: a value of the wrong type or range, or a key that belongs to another.
    """
    if not isinstance(sensor.values.get("sample_period_s"), str):
        if "log_period_s" in sensor.values:
            raise sensor.error(
                "log_period_s",
                f'log_period_s stands beside sample_period_s = "{VARIABLE}" alone; the logs are'
                " brought to sample_period_s. Take it out.",
            )
        return StepConfig(sensor.positive("sample_period_s"), False)
    if sensor.values["sample_period_s"] != VARIABLE:
        raise sensor.expect("sample_period_s", f'a number > 0, or "{VARIABLE}"')
    span = f"the seconds between two rows of the logs, {SHORTEST_S:g} to {LONGEST_S:g}"
    period_s = sensor.number("log_period_s", span)
    if not SHORTEST_S <= period_s <= LONGEST_S:
        raise sensor.expect("log_period_s", span)
    return StepConfig(period_s, True)


def refuse_equal_steps(root: TomlTable, network: str) -> None:
    """Refuse a network whose weights hold only for steps of equal length.

    Raises:
        InputError: names it, and what to use instead.
    """
    if network in ANY_STEP_KINDS:
        return
    table = root.table("network", None, optional=True)
    raise table.error(
        "kind",
        f'"{network}" carries from sample to sample what its weights know for one sample period, or'
        f' may; sample_period_s = "{VARIABLE}" has none. Use kind = "lag_bank" or "none", or state'
        " sample_period_s as a number.",
    )
