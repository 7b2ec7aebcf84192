"""Serves the page to this machine alone."""

import hmac
import io
import json
import threading
import zipfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from flask import Flask, Response, jsonify, request, send_file
from werkzeug.serving import WSGIRequestHandler, make_server

from zerodrift.base.errors import InputError
from zerodrift.base.records import from_json, to_dict, to_json
from zerodrift.workbench.app import make_app
from zerodrift.workbench.chart import draw_wish
from zerodrift.workbench.chip import LONGEST_TEXT, WASM, name_answers
from zerodrift.workbench.early import HOST, EarlyPage
from zerodrift.workbench.first_look import draw_waiting
from zerodrift.workbench.recordings import COMPARE, DISMISS, RECOVER, USE
from zerodrift.workbench.state import PictureWish
from zerodrift.workbench.uploads import list_logs, place_upload, receive
from zerodrift.workbench.views import hides
from zerodrift.workbench.workplace import Workplace

# Who may ask: the owner of the token, from this machine, for nothing but the page.

POLICY = (
    "default-src 'none'; script-src 'self' 'unsafe-inline' 'unsafe-eval'; "
    "style-src 'self' 'unsafe-inline'; img-src 'self' data: blob:; font-src 'self' data:; "
    "connect-src 'self'; worker-src 'self'; base-uri 'none'; form-action 'none'; "
    "frame-ancestors 'none'"
)
WORKER = "/assets/chip_worker.js"
"""Runs the firmware's C. It compiles what the page hands it, and can reach nothing at all."""
WORKER_POLICY = "default-src 'none'; script-src 'wasm-unsafe-eval'"
REFUSED = (
    "<!doctype html><html lang='en'><meta charset='utf-8'><title>zerodrift workbench</title>"
    "<p>This page needs the token that <code>zerodrift workbench</code> printed. Open the address "
    "that stands in the terminal, with everything after the question mark."
)


def guard(server: Flask, token: str, port: int) -> None:
    """Refuse every request without the token, under another host's name, or from another page.

    Args:
        server: the application.
        token: what the address carries at first, and a cookie from then on.
        port: where the server listens. Requests under any host name but this machine's are refused,
            against DNS rebinding.
    """
    hosts = {f"127.0.0.1:{port}", f"localhost:{port}"}
    cookie = f"zerodrift_token_{port}"

    def check() -> Response | None:
        if request.host not in hosts:
            return Response("unknown host", 400, mimetype="text/plain")
        origin = request.headers.get("Origin")
        if origin is not None and origin.removeprefix("http://") not in hosts:
            return Response("request from another page", 403, mimetype="text/plain")
        given = request.args.get("token") or request.cookies.get(cookie) or ""
        if not hmac.compare_digest(given.encode(), token.encode()):
            return Response(REFUSED, 403, mimetype="text/html")
        return None

    def mark(response: Response) -> Response:
        given = request.args.get("token")
        if given and hmac.compare_digest(given.encode(), token.encode()):
            response.set_cookie(cookie, token, httponly=True, samesite="Strict")
        policy = WORKER_POLICY if request.path == WORKER else POLICY
        response.headers["Content-Security-Policy"] = policy
        response.headers["X-Content-Type-Options"] = "nosniff"
        response.headers["Referrer-Policy"] = "no-referrer"
        return response

    server.before_request(check)
    server.after_request(mark)


# The firmware as one file to download.

EPOCH = (1980, 1, 1, 0, 0, 0)
"""The date of every member, so that the same firmware is the same bytes."""


def pack_files(directory: Path, files: Sequence[str]) -> bytes:
    """Return files of a project as a zip, those that are there and lie inside of it.

    Args:
        directory: of the project.
        files: relative to it, as `firmware` tells them.
    """
    packed = io.BytesIO()
    root = directory.resolve()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
        for name in sorted(files):
            path = (root / name).resolve()
            if path.is_file() and path.is_relative_to(root):
                info = zipfile.ZipInfo(path.relative_to(root).as_posix(), EPOCH)
                info.compress_type = zipfile.ZIP_DEFLATED
                archive.writestr(info, path.read_bytes())
    return packed.getvalue()


# What the page's buttons do: each runs a command, as a user would type it.

PRACTICE_EFFECT = "zero_tempco"
MOST_DIGITS = 9
APPLIED = "applied"
"""Folder for what `apply` writes from the page."""
PLANNED = "plan.csv"
"""In build/: the programme, its protocols beside it."""
PLAN_BUDGET_S = 30
TITLES = {
    "propose": "Looking for a formula",
    "plan": "Planning the next experiment",
    "train": "Training",
    "firmware": "Building firmware",
    "verify": "Verifying",
    "report": "Writing the report",
}

RECORDED = {
    COMPARE: ("", ""),
    DISMISS: ("", ""),
    USE: ("--use", "Adding the recorded log"),
    RECOVER: ("--recover", "Finishing the recorded log"),
}
"""Button of a recording -> option of `record`, and what is then being done."""


def find_form(place: Workplace, kind: str) -> list[str]:
    """Return the options with which the diagnosis proposed an effect; none for another one."""
    explained = place.findings.diagnosed if place.findings else None
    if explained is None:
        return []
    commands = (explained.command, *(other.command for other in explained.thermometers))
    return next((list(c.options) for c in commands if c is not None and c.kind == kind), [])


def add(place: Workplace, kind: str, *, force: bool) -> None:
    """Add an effect, in the form in which the diagnosis found it."""
    options = [*find_form(place, kind), *(["--force"] if force else [])]
    place.run("add", f"Adding {kind}", ["add", kind, "--json", *options])


def press(place: Workplace, button: str, chosen: Mapping[str, object]) -> None:
    """Do what a button says.

    Args:
        place: the project.
        button: which one.
        chosen: of the page at that moment: `effect` on the button or in the list of those that can
            be added (on a recording's button its log), `present` in the list of those in the model,
            and `force` where an effect is to be kept whether it helps or not.

    Raises:
        InputError: there is no such button.
    """
    effect, present = chosen.get("effect"), chosen.get("present")
    force = bool(chosen.get("force"))
    simple: dict[str, Callable[[], object]] = {
        "undo": place.undo,
        "redo": place.redo,
        "look": place.look,
        "chip": place.load_chip,
        "cancel": place.cancel,
        "dismiss": place.dismiss,
        "begin": lambda: begin(place),
        "practise": lambda: practise(place),
    }
    if button in ("add", "add-chosen"):
        if not effect:
            place.tell("Choose an effect to add.", is_error=False)
        else:
            add(place, str(effect), force=force)
    elif button == "remove":
        if not present:
            place.tell("Choose the effect to remove.", is_error=False)
        else:
            kind, _, signal = str(present).partition("[")
            options = ["--set", f"signal={signal.rstrip(']')}"] if signal else []
            place.run("remove", f"Removing {present}", ["remove", kind, "--json", *options])
    elif button == "restore":
        step = str(chosen.get("step", ""))
        place.restore(int(step) if step.isdigit() and len(step) < MOST_DIGITS else -1)
    elif button == "apply":
        apply(place)
    elif button in RECORDED:
        follow_recording(place, button, str(effect or ""))
    elif button in TITLES:
        place.run(button, TITLES[button], [button, "--json", *list_options(place, button)])
    elif button in simple:
        simple[button]()
    else:
        known = ("add", "add-chosen", "remove", "restore", "apply", *RECORDED, *TITLES, *simple)
        expected = ", ".join(known)
        raise InputError(f"{button!r}: is no button of the page; expected one of {expected}.")


def follow_recording(place: Workplace, button: str, file: str) -> None:
    """Do what a button of a recording says.

    Raises:
        InputError: the page shows no recording of that log.
    """
    place.recordings.check(file)
    if button == COMPARE:
        place.look()
    elif button == DISMISS:
        place.forget_recording(file)
    else:
        option, title = RECORDED[button]
        place.run(button, title, ["record", option, file])


def list_options(place: Workplace, button: str) -> list[str]:
    """Return what the page asks of a command beside its result."""
    if button == "plan":
        file = place.directory / "build" / PLANNED
        return ["--budget", str(PLAN_BUDGET_S), "--out", str(file)]
    return ["--no-diagnose"] if button == "report" else []


def apply(place: Workplace) -> None:
    """Run the finished model over the test logs, or those it learnt from, as the chip would."""
    findings = place.findings
    files = findings.provenance.files if findings is not None else ()
    logs = [f.file for f in files if f.use == "test"] or [f.file for f in files if "train" in f.use]
    if not logs:
        place.tell("There is no log to apply the model to.", is_error=False)
        return
    paths = [str(place.directory / log) for log in logs]
    out = str(place.directory / "build" / APPLIED)
    place.run("apply", "Applying the model", ["apply", *paths, "--out", out, "--json"])


def begin(place: Workplace) -> None:
    """Begin a project from the logs in the directory."""
    logs = [str(place.directory / name) for name in list_logs(place.directory)]
    place.run("init", "Guessing columns", ["init", *logs, "--json"])


def practise(place: Workplace) -> None:
    """Begin a project from simulated logs with something hidden in them."""
    told = ["--told", PRACTICE_EFFECT, "--mystery", "1", "--seed", str(draw_seed())]
    place.run("twin", "Simulating a sensor", ["twin", *told, "--json"])


def draw_seed() -> int:
    """Return a random seed for a practice case."""
    import secrets

    return secrets.randbelow(1_000_000)


# Serves the page to this machine alone.


class _Quiet(WSGIRequestHandler):  # type: ignore[misc,unused-ignore]
    """A request handler that prints nothing."""

    def log(self, type: str, message: str, *args: object) -> None:  # noqa: A002 - the base's name
        """Say nothing."""


class Workbench:
    """A page being served."""

    def __init__(
        self,
        directory: Path,
        port: int = 0,
        *,
        skip_invalid: bool = False,
        sensor: str | None = None,
        early: EarlyPage | None = None,
    ) -> None:
        """Open a directory and a port, and look at the project.

        Args:
            directory: of the project.
            port: to listen on; 0 for any that is free.
            skip_invalid: drop invalid rows of the logs.
            sensor: a unit of a fleet.
            early: has the port already, and may answer on it until `serve`.

        Raises:
            InputError: another workbench is open there, or the port is taken.
        """
        self.place = Workplace(directory, skip_invalid=skip_invalid, sensor=sensor)
        try:
            self._early = early or EarlyPage(self.place.directory, port, sensor)
        except InputError:
            self.place.close()
            raise
        self.place.read_sketch = self._early.read_sketch
        self.port, self.token = self._early.port, self._early.token
        app = make_app(self.place)
        guard(app.server, self.token, self.port)
        add_routes(app.server, self.place)
        self._server = make_server(
            HOST,
            self.port,
            app.server,
            threaded=True,
            request_handler=_Quiet,
            fd=self._early.listener.fileno(),
        )
        self.place.look()
        # Dash collects its scripts and styles on the first request: here, while the logs are read.
        client = app.server.test_client()
        client.get("/", query_string={"token": self.token}, base_url=f"http://{HOST}:{self.port}")

    @property
    def url(self) -> str:
        """Where the page is, with its token."""
        return self._early.url

    def serve(self, interrupted: threading.Event | None = None) -> None:
        """Answer until `stop`, or until the user interrupts.

        Args:
            interrupted: set once the user has, also where a library that was just being loaded
                swallowed the interrupt itself.
        """

        def look() -> None:
            if interrupted is not None and interrupted.is_set():
                raise KeyboardInterrupt

        self._early.end()
        self._server.service_actions = look  # called each round
        self._server.serve_forever(poll_interval=0.2)

    def stop(self) -> None:
        """Stop answering, and end what runs."""
        self._server.shutdown()
        self.close()

    def close(self) -> None:
        """Release the port and the directory."""
        self._server.server_close()
        self._early.close()
        self.place.close()


def add_routes(server: Flask, place: Workplace) -> None:
    """Add the routes beside the page: a button pressed, a log going in, the report coming out."""

    def upload() -> tuple[Response, int]:
        name = request.args.get("name", "")
        try:
            if place.has_project:
                raise InputError(
                    "there is a project here already; copy further logs into it and name them in "
                    "zerodrift.toml."
                )
            target = place_upload(place.directory, name, request.content_length)
            receive(request.stream, target, request.content_length or 0)
        except InputError as error:
            place.tell(str(error))
            return jsonify({"error": str(error)}), 400
        place.tell(f"Took {target.name}.", is_error=False)
        return jsonify({"file": target.name}), 200

    def refuse() -> tuple[Response, int]:
        try:
            place_upload(
                place.directory, request.args.get("name", ""), int(request.args.get("size", "-1"))
            )
        except InputError as error:
            place.tell(str(error))
        return jsonify({}), 400

    def pressed() -> tuple[Response, int]:
        told = request.get_json(silent=True)
        try:
            if not isinstance(told, dict):
                raise InputError("what was pressed is not told; expected a JSON object.")
            press(place, str(told.get("button", "")), told)
        except InputError as error:
            return jsonify({"error": str(error)}), 400
        return jsonify({}), 200

    def picture() -> tuple[Response, int]:
        try:
            wish = from_json(PictureWish, json.loads(request.args.get("wish", "{}")))
            if place.findings is None:  # the page asks again as soon as there is something
                return jsonify(to_json(draw_waiting(place.look_first(), wish.width))), 200
            drawn = draw_wish(place, wish, hides=hides(place, bool(request.args.get("told"))))
        except (ValueError, RecursionError, InputError) as error:
            return jsonify({"error": str(error)}), 400
        return jsonify(to_dict(drawn)), 200

    def firmware() -> Response:
        findings = place.findings
        if findings is None or findings.firmware is None:
            return Response("There is no current firmware.", 404, mimetype="text/plain")
        text = pack_files(place.directory, findings.firmware.files)
        unit = "" if place.sensor is None else f"_{place.sensor}"
        name = f"{place.directory.name}{unit}_firmware.zip"
        return send_file(
            io.BytesIO(text), mimetype="application/zip", as_attachment=True, download_name=name
        )

    def wasm() -> Response:
        if place.chip_folder is None:
            return Response("No C is in the page yet.", 404, mimetype="text/plain")
        return Response((place.chip_folder / WASM).read_bytes(), mimetype="application/wasm")

    def replayed() -> Response:
        number = request.args.get("number", "")
        known = len(place.chip.runs) if place.chip is not None else 0
        if place.chip_folder is None or number not in map(str, range(known)):
            return Response("There is no such run.", 404, mimetype="text/plain")
        content = (place.chip_folder / name_answers(int(number))).read_bytes()
        return Response(content, mimetype="application/octet-stream")

    def lines() -> tuple[Response, int]:
        try:
            if (request.content_length or 0) > LONGEST_TEXT:
                raise InputError(
                    f"more than {LONGEST_TEXT} bytes of lines; expected fewer at once."
                )
            text = request.get_data().decode("utf-8", errors="replace")
            answers = place.answer_live(text, anew=bool(request.args.get("anew")))
        except InputError as error:
            return jsonify({"error": str(error)}), 400
        return jsonify(to_dict(answers)), 200

    def report() -> Response:
        path = place.directory / "report.html"
        if not path.is_file():
            return Response("No report was written yet.", 404, mimetype="text/plain")
        return send_file(path, mimetype="text/html")

    server.add_url_rule("/upload", view_func=upload, methods=["POST"])
    server.add_url_rule("/upload/refused", view_func=refuse, methods=["POST"])
    server.add_url_rule("/press", view_func=pressed, methods=["POST"])
    server.add_url_rule("/alive", view_func=lambda: ("", 204))
    server.add_url_rule("/picture", view_func=picture)
    server.add_url_rule("/firmware.zip", view_func=firmware)
    server.add_url_rule("/chip/wasm", view_func=wasm)
    server.add_url_rule("/chip/run", view_func=replayed)
    server.add_url_rule("/chip/lines", view_func=lines, methods=["POST"])
    server.add_url_rule("/report.html", view_func=report)
