"""Serves the page to this machine alone."""

import socket
from pathlib import Path

from flask import Flask, Response, jsonify, request, send_file
from werkzeug.serving import WSGIRequestHandler, make_server

from zerodrift.base.errors import InputError
from zerodrift.workbench.actions import press
from zerodrift.workbench.app import make_app
from zerodrift.workbench.security import guard, make_token
from zerodrift.workbench.uploads import place_upload, receive
from zerodrift.workbench.workplace import Workplace

HOST = "127.0.0.1"


class _Quiet(WSGIRequestHandler):  # type: ignore[misc,unused-ignore]
    """A request handler that prints nothing."""

    def log(self, type: str, message: str, *args: object) -> None:  # noqa: A002 - the base's name
        """Say nothing."""


class Workbench:
    """A page being served."""

    def __init__(self, directory: Path, port: int = 0, *, skip_invalid: bool = False) -> None:
        """Open a directory and a port, and look at the project.

        Args:
            directory: of the project.
            port: to listen on; 0 for any that is free.
            skip_invalid: drop invalid rows of the logs.

        Raises:
            InputError: another workbench is open there, or the port is taken.
        """
        self.place = Workplace(directory, skip_invalid=skip_invalid)
        listener = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            listener.bind((HOST, port))
        except OSError as error:
            listener.close()
            self.place.close()
            raise InputError(
                f"port {port} of {HOST} cannot be had ({error.strerror}); expected a free one. "
                "Name another by --port, or leave it out."
            ) from error
        listener.listen()
        self.port = int(listener.getsockname()[1])
        self.token = make_token()
        app = make_app(self.place)
        guard(app.server, self.token, self.port)
        add_routes(app.server, self.place)
        self._listener = listener
        self._server = make_server(
            HOST,
            self.port,
            app.server,
            threaded=True,
            request_handler=_Quiet,
            fd=listener.fileno(),
        )
        self.place.look()
        # Dash collects its scripts and styles on the first request: here, while the logs are read.
        client = app.server.test_client()
        client.get("/", query_string={"token": self.token}, base_url=f"http://{HOST}:{self.port}")

    @property
    def url(self) -> str:
        """Where the page is, with its token."""
        return f"http://{HOST}:{self.port}/?token={self.token}"

    def serve(self) -> None:
        """Answer until `stop`, or until the user interrupts."""
        self._server.serve_forever(poll_interval=0.2)

    def stop(self) -> None:
        """Stop answering, and end what runs."""
        self._server.shutdown()
        self.close()

    def close(self) -> None:
        """Let the port and the directory go."""
        self._server.server_close()
        self._listener.close()
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

    def report() -> Response:
        path = place.directory / "report.html"
        if not path.is_file():
            return Response("No report was written yet.", 404, mimetype="text/plain")
        return send_file(path, mimetype="text/html")

    server.add_url_rule("/upload", view_func=upload, methods=["POST"])
    server.add_url_rule("/upload/refused", view_func=refuse, methods=["POST"])
    server.add_url_rule("/press", view_func=pressed, methods=["POST"])
    server.add_url_rule("/report.html", view_func=report)
