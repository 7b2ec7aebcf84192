"""The first page, at once: what zerodrift.toml says, while all else is still being loaded.

Only the standard library is needed, so that a page is there a fraction of a second after the
command. It comes again each second; the page itself then takes over its port.
"""

import contextlib
import glob
import hmac
import html
import socket
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from urllib.parse import parse_qs, urlsplit

from zerodrift.base.config import FILE_NAME, Config
from zerodrift.base.errors import InputError
from zerodrift.fleet.sensors import load_unit
from zerodrift.workbench.address import PageAddress, find_address, keep_address
from zerodrift.workbench.events import SENSOR

HOST = "127.0.0.1"
SKETCH = "zerodrift.app.sketch"
"""Draws a first chart from one log, in a process of its own."""
AGAIN_S = 1
"""After which the first page asks for the page again."""
SKETCH_FILE = "first.svg"
LONGEST_WAIT_S = 3.0
"""For the first chart, with an answer that has nothing else to tell."""
PATIENCE_S = 5.0
"""For a request that has begun."""
POLICY = "default-src 'none'; style-src 'unsafe-inline'; base-uri 'none'; frame-ancestors 'none'"
STARTING = "Starting. The logs are read next; the page fills as soon as the errors are known."
PAGE = """<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta http-equiv="refresh" content="{again}">
<title>{name}: zerodrift workbench</title>
<style>
body {{ font: 1rem/1.55 system-ui, sans-serif; max-width: 46rem; margin: 0 auto;
  padding: 2rem 1.2rem; color: #1b222a; background: #fbfbf9; overflow-wrap: anywhere; }}
figure {{ margin: 1rem 0; }}
svg {{ display: block; max-width: 100%; height: auto; font: 12px system-ui, sans-serif; }}
svg text {{ fill: currentColor; }}
svg path {{ fill: none; }}
svg .grid {{ stroke: #8889; stroke-width: .5; }}
svg .s-measured {{ stroke: #77818d; }}
svg .s-driver {{ stroke: #3d8f6e; }}
@media (prefers-color-scheme: dark) {{ body {{ color: #e8eaee; background: #14171c; }} }}
</style>
</head>
<body>
<main id="early">
<h1>{name}</h1>
<p role="status">{starting}</p>
<ul>{facts}</ul>
{chart}
</main>
</body>
</html>
"""


def tell_project(directory: Path, sensor: str | None = None) -> tuple[str, ...]:
    """Return what zerodrift.toml and the names of its logs say; nothing where it is wrong."""
    if not (directory / FILE_NAME).is_file():
        return ()
    try:
        config = load_unit(directory, sensor)
    except InputError:
        return ()
    outputs = ", ".join(f"{one.name} in {one.unit}" for one in config.outputs)
    effects = ", ".join(effect.kind for effect in config.effects) or "a constant only"
    logs = [
        _tell_logs(config, use, patterns)
        for use, patterns in (("to learn from", config.train_logs), ("to test", config.test_logs))
        if patterns
    ]
    name = config.sensor_name if sensor is None else f"{config.sensor_name}, unit {sensor}"
    return (f"Sensor {name}: {outputs}", f"Effects in the model: {effects}", *logs)


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
        facts = tell_project(self._directory, self._sensor)
        told = "".join(f"<li>{html.escape(fact)}</li>" for fact in facts)

        asked = threading.Event()

        def render() -> bytes:
            drawing = self._drawing
            if asked.is_set() and drawing is not None:
                # The facts are in the window; what is asked for again is the chart.
                with contextlib.suppress(subprocess.TimeoutExpired):
                    drawing.wait(LONGEST_WAIT_S)
            asked.set()
            chart = self.read_sketch()
            return PAGE.format(
                again=AGAIN_S,
                name=html.escape(self._directory.name),
                starting=STARTING,
                facts=told,
                chart=f'<figure class="sketch">{chart}</figure>' if chart else "",
            ).encode()

        if facts:
            self._begin_sketch(options)
        handler = _make_handler(render, self.token, self.port)
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
        """Return the first chart, from one log alone; empty as long as there is none."""
        if self._scratch is None:
            return ""
        try:
            return (Path(self._scratch.name) / SKETCH_FILE).read_text(encoding="utf-8")
        except OSError:
            return ""

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
    render: Callable[[], bytes], token: str, port: int
) -> type[BaseHTTPRequestHandler]:
    hosts = {f"{HOST}:{port}", f"localhost:{port}"}

    class Handler(BaseHTTPRequestHandler):
        timeout = PATIENCE_S

        def do_GET(self) -> None:
            """Answer the owner of the token, and nobody else."""
            asked = urlsplit(self.path)
            given = parse_qs(asked.query).get("token", [""])[0]
            is_owner = hmac.compare_digest(given.encode(), token.encode())
            is_known = self.headers.get("Host") in hosts and self.headers.get("Origin") is None
            is_page = is_owner and is_known and asked.path == "/"
            content = render() if is_page else b""
            self.send_response(200 if content else 403)
            self.send_header("Content-Type", "text/html; charset=utf-8")
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
