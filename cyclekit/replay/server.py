"""Show a replay to browsers: Rerun's own web viewer, served by us, so that it calls nobody.

Rerun's server listens on all interfaces by default, and its page asks the makers' servers for news and counts its use
there, which no setting of this machine's Rerun changes. So the viewer's files are taken from Rerun's server once, on
loopback, and served with a policy (Content-Security-Policy) by which the browser lets the page load nothing but what
comes from here.
"""

from __future__ import annotations

import subprocess
import time
import urllib.request
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import TYPE_CHECKING
from urllib.parse import quote

from cyclekit.errors import CyclekitError
from cyclekit.replay.viewer import LOOPBACK, free_port, no_usage_counting, require_replay, viewer_program

if TYPE_CHECKING:
    from pathlib import Path

WEB_PORT = 9090
RECORDING = "/replay.rrd"
POLICY = (
    "default-src 'self' 'unsafe-inline' 'wasm-unsafe-eval' blob: data:; connect-src 'self' blob: data:; "
    "form-action 'none'; frame-ancestors 'none'"
)
_FILES = {
    "/": "text/html; charset=utf-8",
    "/re_viewer.js": "text/javascript",
    "/re_viewer_bg.wasm": "application/wasm",
    "/favicon.ico": "image/x-icon",
}
_PATIENCE_S = 30.0


class ReplayServer(ThreadingHTTPServer):
    """Serves one replay and the viewer; `serve_forever` until it is interrupted, then `server_close`."""

    daemon_threads = True

    def __init__(self, bind: str, port: int, replay: Path, files: dict[str, bytes]) -> None:
        """Listen on `bind`:`port`."""
        self.replay, self.files = replay, files
        super().__init__((bind, port), _Answer)

    @property
    def address(self) -> str:
        """What to open in a browser."""
        host, port = self.server_address[:2]
        return f"http://{host!s}:{port}/"


class _Answer(BaseHTTPRequestHandler):
    server: ReplayServer

    def do_GET(self) -> None:
        path, _, query = self.path.partition("?")
        if path == "/" and "url=" not in query:
            here = f"http://{self.headers.get('Host', LOOPBACK)}"
            self.send_response(302)
            self.send_header("Location", f"/?url={quote(here + RECORDING, safe='')}&theme=dark")  # labels are light
            self.send_header("Content-Length", "0")
            self.end_headers()
        elif path == RECORDING:
            self._send("application/octet-stream", self.server.replay.read_bytes())
        elif path in self.server.files:
            self._send(_FILES[path], self.server.files[path])
        else:
            self.send_error(404)

    def _send(self, kind: str, content: bytes) -> None:
        self.send_response(200)
        for name, value in {"Content-Type": kind, "Content-Length": str(len(content))}.items():
            self.send_header(name, value)
        self.send_header("Content-Security-Policy", POLICY)
        self.send_header("Referrer-Policy", "no-referrer")
        self.end_headers()
        self.wfile.write(content)

    def log_message(self, *_: object) -> None:
        """Say nothing about single requests."""


def serve(path: Path, *, bind: str = LOOPBACK, port: int = WEB_PORT) -> ReplayServer:
    """Return a server of `path` for browsers, listening already.

    Args:
        path: The replay.
        bind: Address to listen on. Any other than loopback shows the replay to everybody who can reach it.
        port: Port of the page; 0 takes a free one.

    Raises:
        CyclekitError: There is no such file, the port is taken, or Rerun's viewer cannot be had.
    """
    require_replay(path)
    try:
        return ReplayServer(bind, port, path, _viewer_files())
    except OSError as error:
        msg = f"nothing can be served at {bind}:{port} ({error.strerror or error})"
        raise CyclekitError(msg, cure="Give another port with --port, or another address with --bind.") from error


def _viewer_files() -> dict[str, bytes]:
    """Take the viewer's files from Rerun's own server, on loopback, which ends with it."""
    no_usage_counting()
    page, data = free_port(), free_port()
    ports = ["--port", str(data), "--web-viewer-port", str(page)]
    command = [*viewer_program(), "--serve-web", "--bind", LOOPBACK, *ports]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        return {name: _fetched(f"http://{LOOPBACK}:{page}{name}") for name in _FILES}
    finally:
        process.terminate()
        process.wait()


def _fetched(address: str) -> bytes:
    until_s = time.monotonic() + _PATIENCE_S
    while True:
        try:
            with urllib.request.urlopen(address, timeout=_PATIENCE_S) as answer:
                return bytes(answer.read())
        except OSError as error:
            if time.monotonic() > until_s:
                msg = f"Rerun does not give its viewer for browsers ({error})"
                raise CyclekitError(msg, cure="Open the replay in the native viewer instead: --open.") from error
            time.sleep(0.1)
