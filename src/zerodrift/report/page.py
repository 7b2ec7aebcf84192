"""Pages that stand on their own: styles, pictures and data inside, nothing fetched."""

import html
from collections.abc import Mapping, Sequence
from functools import cache
from importlib.resources import files

from jinja2 import Environment, StrictUndefined
from markupsafe import Markup

from zerodrift.report.svg import Picture, render_svg, write_colours, write_dark_colours
from zerodrift.report.tables import Table

TEMPLATES = files("zerodrift.report") / "templates"


@cache
def _environment() -> Environment:
    environment = Environment(
        autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    environment.filters["table"] = render_table
    environment.filters["picture"] = embed_picture
    return environment


def read_asset(name: str) -> str:
    """Return the text of a style sheet, a script or a template."""
    return (TEMPLATES / name).read_text(encoding="utf-8")


def embed_picture(picture: Picture) -> Markup:
    """Return a picture as the page holds it."""
    return Markup(f'<figure class="picture">{render_svg(picture)}</figure>')


def render_table(table: Table, *, folded: bool = False) -> Markup:
    """Return a table as HTML; `folded` behind its title."""

    def cell(tag: str, text: str, number: int) -> str:
        kind = "" if number < table.texts else ' class="number"'
        return f"<{tag}{kind}>{html.escape(text)}</{tag}>"

    head = "".join(cell("th", text, i) for i, text in enumerate(table.headings))
    body = "".join(
        f"<tr>{''.join(cell('td', text, i) for i, text in enumerate(row))}</tr>"
        for row in table.rows
    )
    note = f'<p class="note">{html.escape(table.note)}</p>' if table.note else ""
    inner = (
        f'<div class="scroll" tabindex="0"><table><thead><tr>{head}</tr></thead>'
        f"<tbody>{body}</tbody></table></div>{note}"
    )
    title = html.escape(table.title)
    if folded:
        return Markup(f"<details><summary>{title}</summary>{inner}</details>")
    return Markup(f'<div class="table"><h3>{title}</h3>{inner}</div>')


def render_template(name: str, values: Mapping[str, object]) -> str:
    """Return a page from one of the templates, with style and scripts inside it."""
    template = read_asset(name)
    dark = f"@media screen and (prefers-color-scheme: dark) {{{write_dark_colours('')}}}"
    assets = {
        "style": Markup(read_asset("page.css")),
        "report_style": Markup(read_asset("report.css")),
        "pictures": Markup(write_colours() + dark),
        "script": Markup(read_asset("page.js")),
    }
    return _environment().from_string(template).render(**assets, **values) + "\n"


def render_page(title: str, drawn: Sequence[Picture], notes: Sequence[str] = ()) -> str:
    """Return one HTML page with notes and pictures."""
    return render_template("figures.html.j2", {"title": title, "drawn": drawn, "notes": notes})
