"""PDF, PNG and Plotly's SVG through the Chromium or Chrome that is installed here."""

import html
import os
import re
import shutil
import subprocess
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from zerodrift.base.errors import InputError
from zerodrift.base.journal import write_all
from zerodrift.base.lock import make_scratch
from zerodrift.report.page import render_template
from zerodrift.report.svg import Picture, render_svg

if TYPE_CHECKING:
    import plotly.graph_objects as go

BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome")
VARIABLE = "ZERODRIFT_BROWSER"
PATIENCE_S = 180
WIDTH = 1000
"""Pixels of a Plotly figure, of which each is drawn as 2 x 2."""


def find_browser() -> str:
    """Return the browser's path.

    Raises:
        InputError: there is none.
    """
    named = os.environ.get(VARIABLE, "")
    for name in (named,) if named else BROWSERS:
        path = shutil.which(name)
        if path is not None:
            return path
    wanted = f"{VARIABLE}={named}, which is no program" if named else ", ".join(BROWSERS)
    raise InputError(
        f"--format pdf and png need Chromium or Chrome; looked for {wanted}. Install one (Debian: "
        f"apt install chromium), name it in {VARIABLE}, or print the HTML report from any browser."
    )


def print_page(text: str, target: Path, project: Path) -> None:
    """Print a page to PDF.

    Args:
        text: the page's HTML.
        target: the PDF; replaced whole or not at all.
        project: the folder of zerodrift.toml.

    Raises:
        InputError: there is no browser, it failed, or the place cannot be written.
    """
    with make_scratch(project) as scratch:
        page, made = scratch / "page.html", scratch / "page.pdf"
        page.write_text(text, encoding="utf-8")
        _run([f"--print-to-pdf={made}", "--no-pdf-header-footer", page.as_uri()], made)
        write_all(project, {target: made.read_bytes()})


def picture_pages(figures: "Mapping[str, go.Figure]", directory: Path, project: Path) -> list[Path]:
    """Write each Plotly figure as SVG, PDF and PNG, all of them as one change.

    Args:
        figures: by the name of the file.
        directory: made if missing.
        project: the folder of zerodrift.toml.

    Raises:
        InputError: as `print_page`.
    """
    contents: dict[Path, bytes | None] = {}
    with make_scratch(project) as scratch:
        for label, figure in figures.items():
            name = re.sub(r"[^A-Za-z0-9_.-]", "_", label)
            for kind, content in _picture(figure, scratch).items():
                contents[directory / f"{name}.{kind}"] = content
        write_all(project, contents)
    return list(contents)


def _picture(figure: "go.Figure", scratch: Path) -> dict[str, bytes]:
    """Return kind -> content of a figure's file."""
    height = int(figure.layout.height or 400) + 16
    page, png, pdf = scratch / "page.html", scratch / "page.png", scratch / "page.pdf"
    for made in (png, pdf):
        made.unlink(missing_ok=True)

    def write(vector: bool) -> str:
        told = {"figure": figure, "vector": vector, "width": WIDTH}
        page.write_text(render_template("picture.html.j2", told), encoding="utf-8")
        return page.as_uri()

    size = f"--window-size={WIDTH},{height}"
    scale = ("--force-device-scale-factor=2", "--hide-scrollbars")
    _run([f"--screenshot={png}", size, *scale, write(vector=False)], png)
    shown = _run(["--dump-dom", size, write(vector=True)], None)
    found = re.search(r'<pre id="svg">(.*)</pre>', shown, re.S)
    if found is None:
        raise InputError(f"{find_browser()}: drew no SVG. Print the HTML page from it instead.")
    svg = html.unescape(found.group(1))
    paper = f"@page {{ size: {WIDTH}px {height}px; margin: 0 }} body {{ margin: 0 }}"
    page.write_text(f"<!doctype html><style>{paper}</style>{svg}", encoding="utf-8")
    _run([f"--print-to-pdf={pdf}", "--no-pdf-header-footer", page.as_uri()], pdf)
    return {"svg": svg.encode(), "pdf": pdf.read_bytes(), "png": png.read_bytes()}


def write_pictures(
    pictures: Mapping[str, Picture], directory: Path, project: Path, kind: str
) -> list[Path]:
    """Write each picture as a file of its own, all of them as one change.

    Args:
        pictures: by the name of the file.
        directory: made if missing.
        project: the folder of zerodrift.toml.
        kind: svg | png.

    Raises:
        InputError: as `print_page`, for PNG.
    """
    contents: dict[Path, bytes | None] = {}
    with make_scratch(project) as scratch:
        for number, (label, picture) in enumerate(pictures.items()):
            name = re.sub(r"[^A-Za-z0-9_.-]", "_", label)
            text = render_svg(picture, alone=True)
            if kind == "svg":
                contents[directory / f"{name}.svg"] = text.encode()
                continue
            page, made = scratch / "picture.svg", scratch / f"{number}.png"
            page.write_text(text, encoding="utf-8")
            size = f"--window-size={int(picture.width)},{int(picture.height)}"
            _run(
                [
                    f"--screenshot={made}",
                    size,
                    "--force-device-scale-factor=2",
                    "--hide-scrollbars",
                    page.as_uri(),
                ],
                made,
            )
            contents[directory / f"{name}.png"] = made.read_bytes()
        write_all(project, contents)
    return list(contents)


def _run(arguments: Sequence[str], made: Path | None) -> str:
    """Run the browser once, in a profile of its own; return what it wrote to its output.

    Raises:
        InputError: it failed, or did not make the file.
    """
    browser = find_browser()
    with tempfile.TemporaryDirectory(prefix="zerodrift-browser-") as profile:
        command = [
            browser,
            "--headless=new",
            "--disable-gpu",
            "--disable-dev-shm-usage",
            "--disable-background-networking",
            "--no-first-run",
            f"--user-data-dir={profile}",
            "--run-all-compositor-stages-before-draw",
            "--virtual-time-budget=20000",
        ]
        # A root user, as in a container, has no sandbox to go into.
        if hasattr(os, "geteuid") and os.geteuid() == 0:
            command.append("--no-sandbox")
        try:
            done = subprocess.run(
                [*command, *arguments],
                capture_output=True,
                text=True,
                timeout=PATIENCE_S,
                check=False,
            )
        except (OSError, subprocess.TimeoutExpired) as error:
            raise InputError(f"{browser}: could not print the page ({error}).") from error
    if made is not None and (not made.exists() or not made.stat().st_size):
        lines = done.stderr.strip().splitlines()
        raise InputError(
            f"{browser}: ended with code {done.returncode} and printed nothing"
            f"{': ' + lines[-1] if lines else ''}. Print the HTML report from a browser instead."
        )
    return done.stdout
