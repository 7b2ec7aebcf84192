"""PDF and PNG through the Chromium or Chrome that is installed here."""

import os
import re
import shutil
import subprocess
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path

from zerodrift.base.errors import InputError
from zerodrift.base.journal import write_all
from zerodrift.base.lock import make_scratch
from zerodrift.report.svg import Picture, render_svg

BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome")
VARIABLE = "ZERODRIFT_BROWSER"
PATIENCE_S = 180


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


def write_pictures(
    pictures: Mapping[str, Picture], directory: Path, project: Path, kinds: Sequence[str]
) -> list[Path]:
    """Write each picture as a file of its own for each kind, all of them as one change.

    Args:
        pictures: by the name of the file.
        directory: made if missing.
        project: the folder of zerodrift.toml.
        kinds: of svg, png and pdf.

    Raises:
        InputError: as `print_page`, for PNG and PDF.
    """
    contents: dict[Path, bytes | None] = {}
    with make_scratch(project) as scratch:
        for label, picture in pictures.items():
            name = re.sub(r"[^A-Za-z0-9_.-]", "_", label)
            for kind in kinds:
                contents[directory / f"{name}.{kind}"] = _render(picture, kind, scratch)
        write_all(project, contents)
    return list(contents)


def _render(picture: Picture, kind: str, scratch: Path) -> bytes:
    """Return a picture's file; a pixel is drawn as 2 x 2."""
    text = render_svg(picture, alone=True)
    if kind == "svg":
        return text.encode()
    width, height = int(picture.width), int(picture.height)
    page, made = scratch / "page.html", scratch / f"picture.{kind}"
    paper = f"@page {{ size: {width}px {height}px; margin: 0 }}"
    paper += " body { margin: 0 } svg { display: block }"
    page.write_text(f"<!doctype html><style>{paper}</style>{text}", encoding="utf-8")
    if kind == "pdf":
        how = [f"--print-to-pdf={made}", "--no-pdf-header-footer"]
    else:
        scale = ("--force-device-scale-factor=2", "--hide-scrollbars")
        how = [f"--screenshot={made}", f"--window-size={width},{height}", *scale]
    made.unlink(missing_ok=True)
    _run([*how, page.as_uri()], made)
    return made.read_bytes()


def _run(arguments: Sequence[str], made: Path) -> None:
    """Run the browser once, in a profile of its own.

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
    if not made.exists() or not made.stat().st_size:
        lines = done.stderr.strip().splitlines()
        raise InputError(
            f"{browser}: ended with code {done.returncode} and printed nothing"
            f"{': ' + lines[-1] if lines else ''}. Print the HTML report from a browser instead."
        )
