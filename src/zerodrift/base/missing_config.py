"""Values of the logs that mean that there is none: `missing`, of [logs] or of a column's table."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from zerodrift.base.toml_table import TomlTable

KEY = "missing"
EXPECTED = 'a list of numbers and texts, such as [-200, "NAN"]'


@dataclass(frozen=True)
class MissingConfig:
    """What a log writes where it has no value."""

    everywhere: tuple[float | str, ...] = ()
    """`[logs] missing`: in all columns but the time."""
    columns: Mapping[str, tuple[float | str, ...]] = field(default_factory=dict)
    """Column -> further ones, from its own table."""

    def list_numbers(self, column: str) -> tuple[float, ...]:
        """Return the numbers that are no value in a column."""
        return tuple(value for value in self._list(column) if not isinstance(value, str))

    def list_texts(self, column: str) -> tuple[str, ...]:
        """Return the texts that are no value in a column."""
        return tuple(value for value in self._list(column) if isinstance(value, str))

    def _list(self, column: str) -> tuple[float | str, ...]:
        return (*self.everywhere, *self.columns.get(column, ()))


def read_missing(table: TomlTable) -> tuple[float | str, ...]:
    """Return the values of a table's key `missing`; empty where it is left out.

    Raises:
        InputError: it is no list of numbers and texts.
    """
    if KEY not in table.values:
        return ()
    found = table.values[KEY]
    if not isinstance(found, list) or not found:
        raise table.expect(KEY, EXPECTED)
    values: list[float | str] = []
    for item in found:
        if isinstance(item, str) and item.strip():
            values.append(item.strip())
            continue
        one = TomlTable(table.file, table.lines, table.key, {KEY: item})
        values.append(one.number(KEY, EXPECTED))
    return tuple(values)


def read_column_missing(table: TomlTable, key: str) -> dict[str, tuple[float | str, ...]]:
    """Return column -> values, where a key holds a column's table with `missing`.

    Raises:
        InputError: as `read_missing`.
    """
    found = table.values.get(key)
    if not isinstance(found, dict) or KEY not in found:
        return {}
    inner = table.table(key, None)
    return {inner.text("column"): read_missing(inner)}
