"""Who may ask: the owner of the token, from this machine, for nothing but the page."""

import hmac

from flask import Flask, Response, request

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
