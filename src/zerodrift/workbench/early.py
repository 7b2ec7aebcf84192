"""The first page, at once: the page's frame and what zerodrift.toml says, while all else is loaded.

Only the standard library is needed, so that a page is there a fraction of a second after the
command. Its script asks for the first chart; the page itself then takes over its port.
"""

import base64
import glob
import hashlib
import hmac
import html
import json
import os
import secrets
import socket
import stat
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from html import escape
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from urllib.parse import parse_qs, urlsplit

from zerodrift import report
from zerodrift.base.config import FILE_NAME, Config
from zerodrift.base.errors import InputError
from zerodrift.base.records import from_json, to_dict
from zerodrift.workbench.jobs import SENSOR

# A project's address on this machine: the same port and token each time, so that a tab finds it.
#
# They lie in the user's own state directory, readable by that user alone, and never in the project,
# which may be shared. Another user's file, or one that others may read, is ignored.

FOLDER = Path("zerodrift") / "workbench"
FEWEST_LETTERS = 24
"""Of a token that is believed."""


@dataclass(frozen=True)
class PageAddress:
    """Where a project's page is."""

    port: int
    """0: any that is free."""
    token: str


def make_token() -> str:
    """Return a random token that cannot be guessed."""
    return secrets.token_urlsafe(24)


def find_address(directory: Path) -> PageAddress:
    """Return the address that the project had last, or a new one.

    Args:
        directory: of the project.
    """
    path = _name_file(directory)
    try:
        told = path.lstat()
        is_own = stat.S_ISREG(told.st_mode) and told.st_uid == _find_user(told.st_uid)
        if is_own and (os.name == "nt" or not told.st_mode & 0o077):
            kept = from_json(PageAddress, json.loads(path.read_text(encoding="utf-8")))
            if len(kept.token) >= FEWEST_LETTERS and 1024 <= kept.port < 65536:
                return kept
    except (OSError, ValueError, RecursionError):
        pass
    return PageAddress(0, make_token())


def keep_address(directory: Path, address: PageAddress) -> None:
    """Keep an address for the next time; where that cannot be, the next one is another."""
    path = _name_file(directory)
    part = path.with_suffix(f".{os.getpid()}.part")
    try:
        path.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
        part.unlink(missing_ok=True)
        handle = os.open(part, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
        with os.fdopen(handle, "w", encoding="utf-8") as file:
            json.dump(to_dict(address), file)
        part.replace(path)
    except OSError:
        part.unlink(missing_ok=True)


def _find_user(fallback: int) -> int:
    return os.getuid() if hasattr(os, "getuid") else fallback


def _name_file(directory: Path) -> Path:
    """Return the file of a project's address: named by a hash of where the project lies."""
    if os.name == "nt":
        state = Path(os.environ.get("LOCALAPPDATA") or Path.home() / "AppData" / "Local")
    else:
        state = Path(os.environ.get("XDG_STATE_HOME") or Path.home() / ".local" / "state")
    name = hashlib.sha256(os.fsencode(directory.resolve())).hexdigest()[:32]
    return state / FOLDER / f"{name}.json"


# The page before anything is found, as plain HTML with the page's own classes and sizes.
#
# It stands where the page will stand: while the page's libraries are being loaded, and while its
# scripts are. What comes later takes its places, so nothing moves. Only the standard library is
# used.

CONTENTS = (
    ("top", "Verdict"),
    ("measured", "Measured and model"),
    ("candidates-section", "What is missing"),
    ("staircase-section", "Staircase"),
    ("errors-section", "Errors"),
    ("model-section", "Effects"),
    ("firmware-section", "Firmware"),
    ("chip-section", "The chip's own C"),
    ("units-section", "Units in use"),
)
CHOICES = (
    ("output", "Output"),
    ("run", "Run"),
    ("ghost", "Drawn over what is left"),
    ("against", "What is left, against"),
)
CAUSE = "The cause: measured, model, what is left, and what it follows"
OTHER_STEPS = "Other steps: another effect, undo, redo, look again"
READING = "Reading the logs and fitting the model."
STEPS = ("Compare", "Diagnose", "Add what is missing", "Firmware", "Verify", "Apply", "Report")
TILES = 4
WAITING = "waiting"
"""In place of `1` for what is out of date: nothing can be pressed yet."""


def write_skeleton(name: str, subtitle: str, facts: Sequence[str]) -> str:
    """Return the page's frame.

    Args:
        name: of the sensor.
        subtitle: what its model holds.
        facts: what is known of the logs.
    """
    links = "".join(f'<li><a href="#{where}">{escape(words)}</a></li>' for where, words in CONTENTS)
    told = "".join(f'<p class="note">{escape(fact)}</p>' for fact in facts)
    steps = "".join(
        f'<li class="{"later" if number else "busy"}"><span class="sign" aria-hidden="true">'
        f'{"○" if number else "…"}</span><b>{step}</b><span class="found"></span></li>'
        for number, step in enumerate(STEPS)
    )
    lists = "".join(
        f'<label class="wide">{escape(words)}<select id="{place}" disabled></select></label>'
        for place, words in CHOICES
    )
    tiles = '<div class="tile"><b>…</b><span></span></div>' * TILES
    return (
        f'<div id="bench" class="layout" data-stale="{WAITING}">'
        f'<nav class="contents" aria-label="Contents"><ol>{links}</ol>'
        '<button class="theme" disabled>Dark page</button></nav>'
        f'<main id="top"><p id="kicker" class="kicker">Workbench</p>'
        f'<h1 id="sensor">{escape(name)}</h1><p class="subtitle">{escape(subtitle)}</p>'
        '<section id="verdict" class="verdict none">'
        f'<p class="sentence" role="status">{READING}</p>{told}</section>'
        '<p id="guess-told" class="note"></p>'
        f'<section id="way"><ol class="way">{steps}</ol>'
        '<div class="now"><p class="reason">The logs are being read.</p>'
        '<div class="adds"></div></div></section>'
        f'<details id="actions"><summary>{OTHER_STEPS}</summary></details>'
        f'<div id="tiles" class="tiles">{tiles}</div>'
        f'<section id="measured"><h2>{CAUSE}</h2><div class="choices">{lists}</div>'
        '<figure><div id="main"></div></figure></section></main></div>'
    )


# The first page, at once: the page's frame and what zerodrift.toml says, while all else is loaded.

HOST = "127.0.0.1"
STYLES = (
    Path(report.__file__).parent / "templates" / "page.css",
    Path(__file__).parent / "assets" / "workbench.css",
)
WIDTH = 1000.0
"""Pixels of a picture where none are told, ..."""
LARGEST = 1e5
"""... or more than any window has."""
SKETCH = "zerodrift.workbench.sketch"
"""Reads what a first chart shows from one log, in a process of its own."""
SKETCH_FILE = "first.json"
AGAIN_S = 1
"""After which a browser without scripts asks for the page again."""
PATIENCE_S = 5.0
"""For a request that has begun."""
STARTING = "Starting. The logs are read next; the page fills as soon as the errors are known."
SCRIPT = """
(function () {
  const dark = window.matchMedia("(prefers-color-scheme: dark)").matches;
  document.documentElement.dataset.theme = dark ? "dark" : "light";
  const token = encodeURIComponent(new URLSearchParams(location.search).get("token"));
  let shown = "";
  async function look() {
    const main = document.getElementById("main");
    try {
      const wish = encodeURIComponent(JSON.stringify({ width: main ? main.clientWidth : 1000 }));
      const answer = await fetch("/picture?token=" + token + "&wish=" + wish);
      const told = answer.ok ? await answer.json() : null;
      if (!told || !told.early) { location.reload(); return; }
      if (main && told.svg !== shown) {
        shown = told.svg;
        document.getElementById("inks").textContent = told.style;
        main.innerHTML = '<div class="sketch">' + told.svg + "</div>";
        main.style.minHeight = told.height + "px";
      }
    } catch (error) { /* the page is taking over, or has ended: asked again */ }
    setTimeout(look, 250);
  }
  document.addEventListener("DOMContentLoaded", look);
})();
"""
"""Puts the first chart in its place, and asks for the page as soon as that answers."""
_HASH = base64.b64encode(hashlib.sha256(SCRIPT.encode()).digest()).decode()
POLICY = (
    f"default-src 'none'; style-src 'unsafe-inline'; script-src 'sha256-{_HASH}'; "
    "connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
PAGE = """<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<noscript><meta http-equiv="refresh" content="{again}"></noscript>
<title>{title}: zerodrift workbench</title>
<script>{script}</script>
<style>{style}</style>
<style id="inks"></style>
</head>
<body>
<div id="early">{frame}</div>
</body>
</html>
"""
START = (
    '<div class="layout single"><main><h2 class="first">{name}</h2><p>{starting}</p></main></div>'
)
"""Where there is no project yet."""


@dataclass(frozen=True)
class ProjectHead:
    """What zerodrift.toml says of a project, for the head of the page."""

    name: str
    """Of the sensor."""
    outputs: str
    """Each with its unit."""
    effects: str
    """Their names."""
    logs: tuple[str, ...]
    """How many, how large; a line for each use."""

    @property
    def subtitle(self) -> str:
        """What the model holds, and what is drawn of it."""
        return f"Effects in the model: {self.effects}. What is left is being computed."


def read_head(directory: Path, sensor: str | None = None) -> ProjectHead | None:
    """Return what zerodrift.toml and the names of its logs say; None where it is wrong."""
    if not (directory / FILE_NAME).is_file():
        return None
    try:
        from zerodrift.fleet.sensors import load_unit  # the first page needs no NumPy

        config = load_unit(directory, sensor)
    except InputError:
        return None
    effects = ", ".join(effect.kind for effect in config.effects) or "a constant only"
    logs = tuple(
        _tell_logs(config, use, patterns)
        for use, patterns in (("to learn from", config.train_logs), ("to test", config.test_logs))
        if patterns
    )
    outputs = ", ".join(f"{one.name} in {one.unit}" for one in config.outputs)
    return ProjectHead(config.sensor_name, outputs, effects, logs)


def write_frame(directory: Path, sensor: str | None = None) -> str:
    """Return the page's frame while nothing is found, as HTML; empty without a project."""
    head = read_head(directory, sensor)
    return "" if head is None else write_skeleton(head.name, head.subtitle, head.logs)


def read_style() -> str:
    """Return the style of the page, but for its pictures' colours."""
    return "".join(path.read_text(encoding="utf-8") for path in STYLES)


def tell_project(directory: Path, sensor: str | None = None) -> tuple[str, ...]:
    """Return what zerodrift.toml and the names of its logs say; nothing where it is wrong."""
    head = read_head(directory, sensor)
    if head is None:
        return ()
    name = head.name if sensor is None else f"{head.name}, unit {sensor}"
    return (f"Sensor {name}: {head.outputs}", f"Effects in the model: {head.effects}", *head.logs)


def _tell_logs(config: Config, use: str, patterns: tuple[str, ...]) -> str:
    sizes = {}
    for pattern in patterns:
        for name in glob.glob(pattern, root_dir=config.directory, recursive=True):  # noqa: PTH207
            path = config.directory / name
            if path.is_file():
                sizes[path] = path.stat().st_size
    told = f"Logs {use}: {', '.join(patterns)}"
    if not sizes:
        return told
    files = "1 file" if len(sizes) == 1 else f"{len(sizes)} files"
    return f"{told} ({files}, {sum(sizes.values()) / 1e6:.1f} MB)"


class EarlyPage:
    """A port, and who answers on it until the page does."""

    def __init__(self, directory: Path, port: int = 0, sensor: str | None = None) -> None:
        """Open a port; nobody answers yet.

        Args:
            directory: of the project.
            port: to listen on; 0 for the one that the project had last, or any that is free.
            sensor: a unit of a fleet.

        Raises:
            InputError: the port is taken.
        """
        self._directory, self._sensor = directory.resolve(), sensor
        self._scratch: tempfile.TemporaryDirectory[str] | None = None
        self._drawing: subprocess.Popen[bytes] | None = None
        known = find_address(self._directory)
        try:
            self.listener = _listen(port or known.port, is_wish=not port)
        except OSError as error:
            raise InputError(
                f"port {port} of {HOST} cannot be had ({error.strerror}); expected a free one. "
                "Name another by --port, or leave it out."
            ) from error
        self.port = int(self.listener.getsockname()[1])
        self.token = known.token
        keep_address(self._directory, PageAddress(self.port, self.token))
        self._server: ThreadingHTTPServer | None = None
        self._thread: threading.Thread | None = None

    @property
    def url(self) -> str:
        """Where the page is, with its token."""
        return f"http://{HOST}:{self.port}/?token={self.token}"

    def begin(self, *options: str) -> None:
        """Answer with the first page from now on, in a thread; draw a first chart meanwhile.

        Args:
            options: of the command that reads the log for it.
        """
        frame, name = write_frame(self._directory, self._sensor), self._directory.name
        page = PAGE.format(
            again=AGAIN_S,
            title=html.escape(name),
            script=SCRIPT,
            style=read_style(),
            frame=frame or START.format(name=html.escape(name), starting=STARTING),
        ).encode()
        if frame:
            self._begin_sketch(options)
        handler = _make_handler(page, self._draw, self.token, self.port)
        server = ThreadingHTTPServer((HOST, self.port), handler, bind_and_activate=False)
        server.socket.close()
        server.socket = self.listener
        server.daemon_threads, server.block_on_close = True, False
        self._server = server
        self._thread = threading.Thread(target=server.serve_forever, args=(0.02,), daemon=True)
        self._thread.start()

    def _begin_sketch(self, options: tuple[str, ...]) -> None:
        self._scratch = tempfile.TemporaryDirectory(prefix="zerodrift-sketch-")
        unit = () if self._sensor is None else (SENSOR, self._sensor)
        target = str(Path(self._scratch.name) / SKETCH_FILE)
        self._drawing = subprocess.Popen(
            [sys.executable, "-P", "-m", SKETCH, str(self._directory), target, *options, *unit],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )

    def read_sketch(self) -> str:
        """Return what is to be seen of one log alone; empty as long as there is nothing."""
        if self._scratch is None:
            return ""
        try:
            return (Path(self._scratch.name) / SKETCH_FILE).read_text(encoding="utf-8")
        except OSError:
            return ""

    def _draw(self, wish: str) -> bytes:
        """Return the chart's place as it is now, for a window of the wished width."""
        # Loaded with the first request, beside what the page itself needs of the same.
        from zerodrift.base.records import to_json

        width = WIDTH
        try:
            match json.loads(wish):
                case {"width": int() | float() as wished} if 0.0 < wished < LARGEST:
                    width = float(wished)
        except (ValueError, RecursionError):
            pass  # no wish that can be read
        from zerodrift.workbench.first_look import draw_waiting, read_look

        drawn = draw_waiting(read_look(self.read_sketch()), width, is_early=True)
        return json.dumps(to_json(drawn)).encode()

    def end(self) -> None:
        """Answer no longer; who asks meanwhile waits for the page."""
        if self._server is not None and self._thread is not None:
            self._server.shutdown()
            self._thread.join()
            self._server = self._thread = None

    def close(self) -> None:
        """Release the port."""
        self.end()
        self.listener.close()
        if self._drawing is not None:
            self._drawing.kill()
            self._drawing.wait()
        if self._scratch is not None:
            self._scratch.cleanup()
            self._scratch = None


def _make_handler(
    page: bytes, draw: Callable[[str], bytes], token: str, port: int
) -> type[BaseHTTPRequestHandler]:
    hosts = {f"{HOST}:{port}", f"localhost:{port}"}

    class Handler(BaseHTTPRequestHandler):
        timeout = PATIENCE_S

        def do_GET(self) -> None:
            """Answer the owner of the token, and nobody else."""
            asked = urlsplit(self.path)
            told = parse_qs(asked.query)
            given = told.get("token", [""])[0]
            is_owner = hmac.compare_digest(given.encode(), token.encode())
            is_known = self.headers.get("Host") in hosts and self.headers.get("Origin") is None
            content, kind = b"", "text/html; charset=utf-8"
            if is_owner and is_known and asked.path == "/":
                content = page
            elif is_owner and is_known and asked.path == "/picture":
                content, kind = draw(told.get("wish", [""])[0]), "application/json"
            self.send_response(200 if content else 403)
            self.send_header("Content-Type", kind)
            self.send_header("Content-Length", str(len(content)))
            self.send_header("Content-Security-Policy", POLICY)
            self.send_header("Cache-Control", "no-store")
            self.send_header("Referrer-Policy", "no-referrer")
            self.send_header("X-Content-Type-Options", "nosniff")
            self.end_headers()
            self.wfile.write(content)

        def log_message(self, format: str, *args: object) -> None:  # noqa: A002 - the base's name
            """Say nothing."""

    return Handler


def _listen(port: int, *, is_wish: bool) -> socket.socket:
    """Return a listening socket.

    Args:
        port: to listen on; 0 for any that is free.
        is_wish: whether another port will do where this one is taken.

    Raises:
        OSError: the port is taken.
    """
    listener = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listener.bind((HOST, port))
    except OSError:
        if not is_wish or port == 0:
            listener.close()
            raise
        listener.bind((HOST, 0))
    listener.listen(64)
    return listener
