"""Units that a log itself states, by a row of units or its format, against zerodrift.toml's."""

from zerodrift.base.clock_config import TIME_UNITS
from zerodrift.base.config import Config, locate_key
from zerodrift.base.conversion_config import FACTORS
from zerodrift.base.errors import InputError
from zerodrift.dataset.tables import Source
from zerodrift.dataset.time_units import read_time_unit
from zerodrift.dataset.units import normalise_unit


def refuse_contradictions(config: Config, source: Source) -> None:
    """Refuse columns that are taken in one unit where the log states another of the same quantity.

    Columns with a conversion table in zerodrift.toml are not checked: the table decides.

    Raises:
        InputError: names the log, both units, and the table to write.
    """
    stated = {name: unit for name, unit in source.units.items() if unit}
    if not stated:
        return
    wanted: list[tuple[str, str, str, tuple[str, ...]]] = [
        ("[sensor] temperature", config.temperature_column, "degC", ("sensor", "temperature"))
    ]
    for output in config.outputs:
        for key, column in (("measured", output.measured), ("reference", output.reference)):
            if isinstance(column, str):
                own = ("outputs", output.name, key)
                wanted.append((f"[outputs.{output.name}] {key}", column, output.unit, own))
    time = config.clocks.time(source.path, config.time)
    if len(time.columns) == 1 and not time.unit and not time.format:
        unit = read_time_unit(time.columns[0]) or "s"
        wanted.append(("[sensor] time", time.columns[0], unit, ("sensor", "time")))
    for role, column, taken, place in wanted:
        name = column if column in stated else column.rpartition(":")[2]
        if name not in stated or column in config.conversions:
            continue
        found = normalise_unit(stated[name], name)
        if not _contradict(found, taken):
            continue
        key = role.rpartition(" ")[2]
        row = source.text.header_line + 1 if source.text is not None else 0
        raise InputError(
            f"{source.label}{f':{row}' if row else ''}: column '{name}' is in {found}, as the log "
            f"states, and {locate_key(config.path, *place)} takes it as {taken}; expected one unit."
            f' Write {key} = {{ column = "{column}", unit = "{found}" }} in '
            f"{role.rpartition(' ')[0]}, which converts it."
        )


def _contradict(found: str, unit: str) -> bool:
    """Tell whether two units are of one quantity and differ."""
    if unit == "degC":
        return found in ("K", "degF")
    if unit in TIME_UNITS and found in TIME_UNITS:
        return found != unit
    one, other = FACTORS.get(found), FACTORS.get(unit)
    return one is not None and other is not None and one[0] == other[0] and one[1] != other[1]
