"""Tables and text as terminal, report and page show them, read back."""

import base64
import csv
import html
import io
import json
import re
from collections.abc import Sequence
from dataclasses import dataclass


@dataclass(frozen=True)
class ShownTable:
    """A table as it is shown."""

    title: str
    headings: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]

    def find_row(self, name: str) -> tuple[str, ...]:
        """Return the row of a name, which is its first cell; empty where there is none."""
        return next((row for row in self.rows if row and row[0] == name), ())

    def find(self, name: str, heading: str) -> str:
        """Return the cell of a name under a heading; empty where there is none."""
        row = self.find_row(name)
        if heading not in self.headings or len(row) != len(self.headings):
            return ""
        return row[self.headings.index(heading)]


def list_terminal(text: str) -> list[ShownTable]:
    """Return the tables that a command prints; an empty heading is taken for the kind of a run."""
    lines = text.splitlines()
    tables = []
    for place, line in enumerate(lines):
        if set(line.strip()) != {"─"} or place < 3:
            continue
        headings = re.split(r"\s{2,}", lines[place - 1].strip())
        rows = []
        for below in lines[place + 1 :]:
            if not below.strip():
                break
            rows.append(tuple(re.split(r"\s{2,}", below.strip())))
        if rows and len(rows[0]) == len(headings) + 1:
            headings.insert(1, "")
        tables.append(ShownTable(lines[place - 3].strip(), tuple(headings), tuple(rows)))
    return tables


def list_report(text: str) -> list[ShownTable]:
    """Return the tables of a report."""
    tables = []
    for table in re.finditer(r"<table.*?</table>", text, re.DOTALL):
        caption = re.findall(
            r"<(?:h[1-4]|caption|summary)[^>]*>(.*?)</", text[: table.end()], re.DOTALL
        )
        rows = [
            tuple(_strip(cell) for cell in re.findall(r"<t[hd][^>]*>(.*?)</t[hd]>", row, re.DOTALL))
            for row in re.findall(r"<tr.*?</tr>", table.group(0), re.DOTALL)
        ]
        title = _strip(caption[-1]) if caption else ""
        tables.append(ShownTable(title, rows[0], tuple(rows[1:])))
    return tables


def list_annex(text: str) -> list[ShownTable]:
    """Return the tables that a report holds as CSV, each with its file's name as title."""
    tables = []
    for told, name in re.findall(r'href="data:[^,]*,([^"]*)" download="([^"]*)"', text):
        rows = [tuple(row) for row in csv.reader(io.StringIO(base64.b64decode(told).decode()))]
        tables.append(ShownTable(name, rows[0], tuple(rows[1:])))
    return tables


def list_page(parts: Sequence[object]) -> list[ShownTable]:
    """Return the tables of the page's parts, each with the title above it."""
    tables: list[ShownTable] = []
    title = ""

    def walk(part: object) -> None:
        nonlocal title
        if isinstance(part, list | tuple):
            for one in part:
                walk(one)
        elif isinstance(part, dict):
            kind, about = part.get("type"), part.get("props", {})
            if kind in ("H2", "H3", "Summary"):
                title = read_text([part]).strip()
            told = about.get("data-table")
            if told is not None:
                cells = json.loads(told)
                rows = tuple(tuple(row) for row in cells["rows"])
                tables.append(ShownTable(title, tuple(cells["head"]), rows))
            walk(about.get("children"))

    walk(_unfold(parts))
    return tables


def _unfold(part: object) -> object:
    """Return components as plain values, as the page is sent them."""
    told = json.dumps(part, default=lambda one: one.to_plotly_json(), ensure_ascii=False)
    return json.loads(told)


def read_text(shown: object) -> str:
    """Return what is written in a report's HTML, or in parts of the page, without its tables."""
    if isinstance(shown, str):
        bare = re.sub(r"<(style|svg|script).*?</\1>", " ", shown, flags=re.DOTALL)
        return _strip(bare)
    words: list[str] = []

    def walk(part: object) -> None:
        if isinstance(part, str | int | float):
            words.append(str(part))
        elif isinstance(part, list):
            for one in part:
                walk(one)
        elif isinstance(part, dict):
            walk(part.get("props", {}).get("children"))

    walk(_unfold(shown))
    return " ".join(" ".join(words).split())


def _strip(text: str) -> str:
    return " ".join(html.unescape(re.sub(r"<[^>]+>", " ", text)).split())
