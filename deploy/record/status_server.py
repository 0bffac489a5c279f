"""The status over HTTP, for this computer only: text at /, JSON at /json."""

import json
import threading
from http.server import BaseHTTPRequestHandler, HTTPServer
from typing import Any, Self

from core.errors import InputError
from deploy.record.status import Status, text

LOOPBACK = "127.0.0.1"
PATIENCE_S = 2.0


class StatusServer:
    """Answers in a thread of its own, one caller at a time: it neither delays nor ends the loop. A context manager.

    port: 0 takes any that is free. Raises InputError where the port is taken.
    """

    def __init__(self, status: Status, port: int) -> None:
        class Handler(_StatusHandler):
            shown = status

        try:
            self._server = HTTPServer((LOOPBACK, port), Handler)
        except (OSError, OverflowError) as error:
            why = error.strerror if isinstance(error, OSError) else "no such port"
            raise InputError(f"no status can be offered ({why})", where=f"--status {port}") from error
        self._thread = threading.Thread(target=self._server.serve_forever, name="status", daemon=True)

    @property
    def address(self) -> str:
        """Where it answers."""
        return f"http://{LOOPBACK}:{self._server.server_address[1]}/"

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        """Stop listening; a caller that holds the line does not hold up the end."""
        threading.Thread(target=self._server.shutdown, daemon=True).start()
        self._thread.join(PATIENCE_S)
        self._server.server_close()


class _StatusHandler(BaseHTTPRequestHandler):
    """Only GET; who does not ask within 2 s is let go."""

    shown: Status
    timeout = PATIENCE_S

    def do_GET(self) -> None:
        if self.path == "/json":
            kind, body = "application/json", json.dumps(self.shown.content()).encode()
        elif self.path == "/":
            kind, body = "text/plain", text(self.shown.content()).encode()
        else:
            self.send_error(404, "there is / and /json")
            return
        self.send_response(200)
        self.send_header("Content-Type", f"{kind}; charset=utf-8")
        self.send_header("Content-Length", str(len(body)))
        self.send_header("Cache-Control", "no-store")
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, format: str, *arguments: Any) -> None:
        """Callers are not worth a line."""
