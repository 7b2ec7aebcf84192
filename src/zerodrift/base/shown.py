"""How a result looks in a notebook: a table, and a figure where it has one."""

from collections.abc import Callable, Mapping
from dataclasses import fields, is_dataclass
from html import escape
from typing import TypeVar

T = TypeVar("T", bound="Shown")
MOST_ROWS = 24
"""Of a table; the rest is counted."""
LONGEST_CELL = 160
EPOCH = 1e8
"""Numbers from here on are times in seconds since 1970: written out."""


class Shown:
    """A frozen record that a notebook shows as tables."""

    def plot(self, *arguments: object, **options: object) -> object:
        """Return the result as a picture, which a notebook shows; see `zerodrift.report.svg`.

        Raises:
            TypeError: the result was read from a file, without the data to draw.

        Example:
            >>> picture = project.compare().plot("Fz")
            >>> type(picture).__name__
            'Picture'
        """
        draw = getattr(self, "_draw", None)
        if draw is None:
            raise TypeError(
                f"this {type(self).__name__} holds no data to draw; expected one that a Project "
                "returned. Call the Project's method again."
            )
        return draw(*arguments, **options)

    def _repr_html_(self) -> str:
        """Return the record as HTML tables: single values first, then one table per collection."""
        plain: list[tuple[str, object]] = []
        tables: list[str] = []
        for one in fields(self):  # type: ignore[arg-type]
            value = getattr(self, one.name)
            rows = _list_rows(value)
            if rows:
                tables.append(f"<h4>{escape(one.name)}</h4>{_render(rows)}")
            elif value not in (None, "", (), {}) and not is_dataclass(value):
                plain.append((one.name, value))
        body = "".join(
            f"<tr><th style='text-align:left'>{escape(name)}</th><td>{_write(value)}</td></tr>"
            for name, value in plain
        )
        title = escape(type(self).__name__.removesuffix("Result").removesuffix("Summary"))
        return f"<h3>{title}</h3><table>{body}</table>{''.join(tables)}"


def with_picture(result: T, draw: Callable[..., object]) -> T:
    """Return a result whose `plot` calls `draw`."""
    object.__setattr__(result, "_draw", draw)
    return result


def _list_rows(value: object) -> list[dict[str, object]]:
    """Return a mapping or a sequence of records as rows; none of anything else.

    Of a mapping of mappings of records, each row has both keys.
    """
    if isinstance(value, Mapping) and value and all(is_dataclass(v) for v in value.values()):
        return [{"": key, **_list_cells(record)} for key, record in value.items()]
    if isinstance(value, Mapping) and value and all(_is_table(v) for v in value.values()):
        return [
            {"": f"{key}, {each}", **_list_cells(record)}
            for key, records in value.items()
            for each, record in records.items()
            if is_dataclass(record)
        ]
    if isinstance(value, tuple) and value and all(is_dataclass(v) for v in value):
        return [_list_cells(record) for record in value]
    return []


def _is_table(value: object) -> bool:
    return isinstance(value, Mapping) and any(is_dataclass(record) for record in value.values())


def _list_cells(record: object) -> dict[str, object]:
    cells = {one.name: getattr(record, one.name) for one in fields(record)}  # type: ignore[arg-type]
    return {name: cell for name, cell in cells.items() if not is_dataclass(cell)}


def _render(rows: list[dict[str, object]]) -> str:
    names = [name for name in rows[0] if any(row.get(name) not in (None, "", ()) for row in rows)]
    head = "".join(f"<th>{escape(name)}</th>" for name in names)
    body = "".join(
        f"<tr>{''.join(f'<td>{_write(row.get(name))}</td>' for name in names)}</tr>"
        for row in rows[:MOST_ROWS]
    )
    more = len(rows) - MOST_ROWS
    rest = f"<tr><td colspan={len(names)}>and {more} more</td></tr>" if more > 0 else ""
    return f"<table><thead><tr>{head}</tr></thead><tbody>{body}{rest}</tbody></table>"


def _write(value: object) -> str:
    if isinstance(value, bool) or value is None:
        return {True: "yes", False: "no", None: "-"}[value]
    if isinstance(value, float):
        return f"{value:.0f}" if abs(value) >= EPOCH else f"{value:.4g}"
    if isinstance(value, Mapping):
        return ", ".join(f"{escape(str(key))} {_write(one)}" for key, one in value.items())
    if isinstance(value, (tuple, list)):
        return ", ".join(_write(one) for one in value)
    text = str(value)
    return escape(text if len(text) <= LONGEST_CELL else f"{text[: LONGEST_CELL - 1]}…")
