"""The page's own worker in Chromium with a model's WebAssembly, for benchmarks and tests."""

import os
import shutil
import threading
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from zerodrift.base.errors import InputError
from zerodrift.c_runtime.host import HostTrace
from zerodrift.export.integer_model import IntegerModel
from zerodrift.operations.arithmetic import CodeArray
from zerodrift.verify.host_check import choose_chunk
from zerodrift.workbench.server import POLICY, WORKER_POLICY

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

WORKER = Path(__file__).parents[2] / "src/zerodrift/workbench/assets/chip_worker.js"
MISSING = "Chromium and Playwright are not installed; `make setup-browser` does it"
RUN = """async (told) => {
  const read = async (name) => (await fetch(name)).arrayBuffer();
  const worker = new Worker("/worker.js");
  const ask = (what, options, moved) => new Promise((resolve, reject) => {
    worker.onmessage = ({ data }) => data.error ? reject(new Error(data.error)) : resolve(data);
    worker.onerror = (event) => reject(new Error(event.message || "the worker did not start"));
    worker.postMessage({ what, id: 0, ...options }, moved || []);
  });
  try {
    const opened = await ask("open", { wasm: await read("/chip.wasm"), ...told });
    const rounds = [];
    let found = null;
    for (let round = 0; round <= told.rounds; round++) {
      const codes = await read("/codes");
      await ask("start", { codes, settled: told.settled });
      found = await ask("run", { codes, chunk: round ? 0 : told.chunk }, [codes]);
      if (round === 0) {
        for (const part of ["drift", "flags"]) { await fetch("/" + part, { method: "POST", body: found[part] }); }
        await fetch("/packed", { method: "POST", body: new Blob(found.packed) });
      } else { rounds.push(found.milliseconds); }
    }
    return { ...opened, rounds };
  } finally { worker.terminate(); }
}"""  # noqa: E501 - JavaScript


@dataclass(frozen=True)
class Played:
    """What the WebAssembly gave for one sequence, handed out like a host model's answers."""

    model: IntegerModel
    trace: HostTrace
    packed: NDArray[np.int64]
    """[chunks, n] the whole state at the end of each chunk."""
    chunk: int
    fault: int
    """Of the self-test; 0 = passed."""
    seconds: tuple[float, ...]
    """Of each further round, in the C alone."""


class PlayedHost:
    """Takes the place of a host build in `check_host`."""

    def __init__(self, played: Played) -> None:
        self.model = played.model
        self.observes = False  # it is the C as it is flashed
        self._played = played

    def run_chunks(
        self, codes: CodeArray, chunk: int, width: int, *, settled: bool = True
    ) -> tuple[HostTrace, NDArray[np.int64]]:
        """Return the answers that were given in the page, and the states after each chunk."""
        del settled
        played = self._played
        if (len(codes), chunk) != (len(played.trace.flags), played.chunk):
            raise AssertionError(f"{len(codes)} steps in chunks of {chunk} were not played")
        if played.packed.shape[1] != width:
            raise AssertionError(
                f"the C packs {played.packed.shape[1]} numbers, the reference {width}"
            )
        return played.trace, played.packed


class ChipPage:
    """A page that runs WebAssembly in the workbench's worker, under the workbench's policy."""

    def __init__(self, page: "Page", port: int, files: dict[str, bytes]) -> None:
        self._page, self._files = page, files
        page.goto(f"http://127.0.0.1:{port}/")

    def play(
        self,
        model: IntegerModel,
        wasm: bytes,
        codes: CodeArray,
        *,
        settled: bool = True,
        rounds: int = 0,
    ) -> Played:
        """Run a sequence [T, C] from its start, then `rounds` more times for the clock."""
        codes = np.ascontiguousarray(codes, dtype=model.code_type)
        chunk = choose_chunk(len(codes))
        self._files.update({"/chip.wasm": wasm, "/codes": codes.tobytes()})
        told = self._page.evaluate(
            RUN,
            {
                "columns": model.columns,
                "outputs": len(model.outputs),
                "code_bytes": codes.itemsize,
                "settled": settled,
                "chunk": chunk,
                "rounds": rounds,
            },
        )
        drift = np.frombuffer(self._files["/drift"], "<i4").reshape(-1, len(model.outputs))
        flags = np.frombuffer(self._files["/flags"], "<u4")
        packed = np.frombuffer(self._files["/packed"], "<i8").reshape(-(-len(codes) // chunk), -1)
        trace = HostTrace(drift, flags, np.zeros((len(codes), 0), dtype=np.int32))
        seconds = tuple(ms / 1e3 for ms in told["rounds"])
        return Played(model, trace, packed, chunk, int(told["fault"]), seconds)


@contextmanager
def open_chip_page(chromium: "Browser | None" = None) -> Iterator[ChipPage]:
    """Open a page on a small server of this machine.

    Args:
        chromium: a browser that is open; one of its own where None.

    Raises:
        InputError: there is no Chromium or no Playwright.
    """
    files: dict[str, bytes] = {"/": b"<!doctype html>", "/worker.js": WORKER.read_bytes()}
    with ExitStack() as stack:
        own = chromium if chromium is not None else stack.enter_context(_open_chromium())
        port = stack.enter_context(_serve(files))
        page = own.new_page()
        stack.callback(page.close)
        yield ChipPage(page, port, files)


@contextmanager
def _open_chromium() -> Iterator["Browser"]:
    path = shutil.which("chromium") or shutil.which("google-chrome")
    try:
        driver = import_module("playwright.sync_api").sync_playwright()
    except ImportError:
        path = None
    if path is None:
        raise InputError(MISSING)
    options = ["--no-sandbox"] if hasattr(os, "geteuid") and os.geteuid() == 0 else []
    with driver as playwright:
        chromium = playwright.chromium.launch(executable_path=path, args=options)
        try:
            yield chromium
        finally:
            chromium.close()


@contextmanager
def _serve(files: dict[str, bytes]) -> Iterator[int]:
    """Serve what is in `files`, and keep there what is posted; yield the port."""
    server = ThreadingHTTPServer(("127.0.0.1", 0), _make_handler(files))
    thread = threading.Thread(target=server.serve_forever, args=(0.05,), daemon=True)
    thread.start()
    try:
        yield server.server_port
    finally:
        server.shutdown()
        thread.join()
        server.server_close()


def _make_handler(files: dict[str, bytes]) -> type[BaseHTTPRequestHandler]:
    types: Mapping[str, str] = {"/": "text/html", "/worker.js": "text/javascript"}

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            body = files.get(self.path)
            self.send_response(404 if body is None else 200)
            self.send_header("Content-Type", types.get(self.path, "application/octet-stream"))
            policy = WORKER_POLICY if self.path == "/worker.js" else POLICY
            self.send_header("Content-Security-Policy", policy)
            self.send_header("Content-Length", str(len(body or b"")))
            self.end_headers()
            self.wfile.write(body or b"")

        def do_POST(self) -> None:
            files[self.path] = self.rfile.read(int(self.headers["Content-Length"]))
            self.send_response(204)
            self.end_headers()

        def log_message(self, format: str, *arguments: object) -> None:  # noqa: A002
            pass

    return Handler
