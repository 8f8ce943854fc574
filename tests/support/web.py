"""A web server that takes what webhooks send, and behaves as it is told."""

import json
import socket
import threading
from collections.abc import Callable
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

Answer = Callable[[BaseHTTPRequestHandler], None]


def with_status(status: int, **headers: str) -> Answer:
    """An answer of a status line and headers."""

    def answer(handler: BaseHTTPRequestHandler) -> None:
        handler.send_response(status)
        for name, value in headers.items():
            handler.send_header(name, value)
        handler.send_header("Content-Length", "0")
        handler.end_headers()

    return answer


class WebServer:
    """It listens at a port of its own, or at `port`; `answers` are used up, the last one stays."""

    def __init__(self, *answers: Answer, port: int = 0) -> None:
        self.answers = list(answers or [with_status(204)])
        self.taken: list[dict[str, Any]] = []
        """The JSON of each request."""
        self.headers: list[dict[str, str]] = []
        self.paths: list[str] = []
        self.released = threading.Event()
        """Ends what `hang` waits for."""
        outer = self

        class Handler(BaseHTTPRequestHandler):
            def do_POST(self) -> None:
                body = self.rfile.read(int(self.headers["Content-Length"]))
                outer.taken.append(json.loads(body))
                outer.headers.append(dict(self.headers))
                outer.paths.append(self.path)
                answer = outer.answers[0]
                if len(outer.answers) > 1:
                    del outer.answers[0]
                answer(self)

            def log_message(self, format: str, *args: Any) -> None:
                pass

        self._server = ThreadingHTTPServer(("127.0.0.1", port), Handler)
        self._server.daemon_threads = True
        self.port: int = self._server.server_address[1]
        self._thread = threading.Thread(target=self._server.serve_forever, args=(0.01,))
        self._thread.start()

    @property
    def url(self) -> str:
        """Where it is, with a path that nobody may see."""
        return f"http://127.0.0.1:{self.port}/hook/s3cret?key=s3cret"

    def hang(self, _handler: BaseHTTPRequestHandler) -> None:
        """Answer nothing."""
        self.released.wait(60.0)

    def drip(self, handler: BaseHTTPRequestHandler) -> None:
        """Send one byte after another, and never a whole line."""
        while not self.released.wait(0.05):
            try:
                handler.wfile.write(b"H")
            except OSError:
                return

    def garble(self, handler: BaseHTTPRequestHandler) -> None:
        """Speak something else."""
        handler.wfile.write(b"220 mail.example ESMTP\r\n")
        handler.connection.shutdown(socket.SHUT_RDWR)

    def close(self) -> None:
        """Listen no longer."""
        self.released.set()
        self._server.shutdown()
        self._thread.join()
        self._server.server_close()
