"""Hooks of MkDocs: the contents from the folders, and pictures where pages ask for them.

A page asks by a comment, `<!-- picture: NAME -->`, which other readers of Markdown leave out.
"""

import html
import posixpath
import re
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from manual.pictures import draw_picture
from zerodrift.report.page import embed_picture
from zerodrift.report.svg import write_colours, write_dark_colours

SECTIONS = (
    ("Tutorial", "tutorial"),
    ("How-to", "how-to"),
    ("Reference", "reference"),
    ("Explanation", "explanation"),
    ("Decisions", "decisions"),
)
FIRST = (
    "tutorial/simulated-sensor.md",
    "tutorial/notebook-raw-log.md",
    "how-to/logs.md",
    "how-to/close-the-loop.md",
    "how-to/workbench.md",
    "how-to/report.md",
    "reference/commands.md",
    "reference/zerodrift-toml.md",
    "reference/effects.md",
    "explanation/diagnosis.md",
    "explanation/runs-are-evidence.md",
    "explanation/sixteen-bit-state.md",
    "decisions/README.md",
)
"""Pages that stand first in their sections; all others follow by name."""
HOME = "index.md"
ROOT = Path(__file__).parents[2]
PYTHON = "reference/python/"
DARK = write_dark_colours('[data-md-color-scheme="slate"] ')
STYLE = f"<style>{write_colours()}{DARK}</style>"
"""Of the pictures of a page."""
ASKED = re.compile(r"<!-- picture: ([\w -]+?) -->")
CODE = re.compile(r"`([^`]+)`")
SHOWN_EFFECT = re.compile(r"(?m)^## (\w+)$")
UPWARDS = re.compile(r"\[([^\]]+)\]\(((?:\.\./)+[^)\s]+)\)")


def list_contents(paths: Iterable[str]) -> list[Any]:
    """Return the contents as MkDocs takes them: every page, in the section of its folder.

    Args:
        paths: of all pages, relative to docs/.

    Raises:
        ValueError: a page lies in no section.
    """
    left = sorted(set(paths), key=_place)
    contents: list[Any] = [{"Home": HOME}] if HOME in left else []
    left = [path for path in left if path != HOME]
    for title, folder in SECTIONS:
        mine: list[Any] = [path for path in left if path.startswith(f"{folder}/")]
        python = [path for path in mine if path.startswith(PYTHON)]
        section = [path for path in mine if path not in python]
        contents.append({title: [*section, *([{"Python": python}] if python else [])]})
        left = [path for path in left if path not in mine]
    if left:
        folders = ", ".join(folder for _, folder in SECTIONS)
        raise ValueError(f"docs/{left[0]}: is in no section; expected one of {folders}")
    return contents


def _place(path: str) -> tuple[int, str]:
    return (FIRST.index(path) if path in FIRST else len(FIRST), path)


def ask_for_effects(text: str, pictured: Sequence[str]) -> str:
    """Return the catalogue's page with a picture asked for under each effect's heading."""

    def ask(match: re.Match[str]) -> str:
        kind = match.group(1)
        asked = f"\n\n<!-- picture: effect {kind} -->" if kind in pictured else ""
        return match.group(0) + asked

    return SHOWN_EFFECT.sub(ask, text)


def name_outsiders(text: str, page: str) -> str:
    """Return a page with the names of files of the repository, where it links to them.

    Args:
        text: of the page, as Markdown.
        page: where it lies, relative to docs/.

    Raises:
        ValueError: a file does not exist.
    """
    here = posixpath.join("docs", posixpath.dirname(page))

    def name(match: re.Match[str]) -> str:
        target = posixpath.normpath(posixpath.join(here, match.group(2).partition("#")[0]))
        if target.startswith("docs/"):
            return match.group(0)
        if not (ROOT / target).exists():
            raise ValueError(f"docs/{page}: {target} does not exist")
        return f"{match.group(1)} (`{target}`)"

    return UPWARDS.sub(name, text)


def put_pictures(content: str, page: str) -> str:
    """Return a page with the pictures that it asks for, drawn now.

    Args:
        content: of the page, as HTML.
        page: where it lies, for messages.

    Raises:
        ValueError: it asks for a picture that there is not.
    """

    def put(match: re.Match[str]) -> str:
        try:
            picture = draw_picture(match.group(1))
        except KeyError as error:
            raise ValueError(
                f"docs/{page}: asks for the picture {error}, which is unknown"
            ) from None
        figure = embed_picture(picture.drawn)
        caption = CODE.sub(r"<code>\1</code>", html.escape(picture.caption))
        return f'{figure}<p class="caption">{caption}</p>'

    found = ASKED.sub(put, content)
    return found if found == content else f"{STYLE}{found}"


# --- what MkDocs calls --------------------------------------------------------------------------


def on_files(files: Any, config: Any, **_: Any) -> Any:
    """Set the contents, once all pages are known, those made at build time included."""
    config["nav"] = list_contents(file.src_uri for file in files.documentation_pages())
    return files


on_files.mkdocs_priority = -100  # type: ignore[attr-defined]


def on_page_markdown(text: str, page: Any, **_: Any) -> str:
    """Ask for the effects' pictures; name files of the repository that are no pages."""
    if page.file.src_uri == "reference/effects.md":
        from zerodrift.diagnosis.fingerprint import draw_fingerprint
        from zerodrift.physics.catalogue import load_catalogue

        catalogue = load_catalogue()
        text = ask_for_effects(
            text, [e.kind for e in catalogue.listed() if draw_fingerprint(e, catalogue) is not None]
        )
    return name_outsiders(text, page.file.src_uri)


def on_page_content(content: str, page: Any, **_: Any) -> str:
    """Put the pictures where they are asked for."""
    return put_pictures(content, page.file.src_uri)
