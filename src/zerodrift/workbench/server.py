"""Serves the page to this machine alone."""

import io
import json
import threading
from pathlib import Path

from flask import Flask, Response, jsonify, request, send_file
from werkzeug.serving import WSGIRequestHandler, make_server

from zerodrift.base.errors import InputError
from zerodrift.base.records import from_json, to_dict, to_json
from zerodrift.workbench.actions import press
from zerodrift.workbench.app import make_app
from zerodrift.workbench.chart import draw_wish
from zerodrift.workbench.chip import LONGEST_TEXT, WASM, name_answers
from zerodrift.workbench.early import HOST, EarlyPage
from zerodrift.workbench.first_look import draw_waiting
from zerodrift.workbench.packing import pack_files
from zerodrift.workbench.security import guard
from zerodrift.workbench.state import PictureWish
from zerodrift.workbench.uploads import place_upload, receive
from zerodrift.workbench.views import hides
from zerodrift.workbench.workplace import Workplace


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
