"""Serves a replay to browsers with Rerun's web viewer, without connections to other machines.

Rerun's server listens on all interfaces by default, and its page contacts the makers' servers for news and usage
statistics; no local setting prevents this. So the viewer's files are fetched once from Rerun's server on loopback, and
served with a Content-Security-Policy that lets the page load only from this server.

Pages of other origins cannot read the replay: requests under a foreign host name (DNS rebinding) are refused, and so
are cross-origin requests.
"""

from __future__ import annotations

import ipaddress
import re
import socket
import subprocess
import time
import urllib.request
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from socketserver import TCPServer
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
_HOST = re.compile(r"(\[[0-9A-Fa-f:.]+\]|[A-Za-z0-9._-]+)(:[0-9]{1,5})?")
_EVERYWHERE = ("0.0.0.0", "::", "")
_LOCAL = ("localhost", LOOPBACK, "::1")


class ReplayServer(ThreadingHTTPServer):
    """Serves one replay and the viewer; call `serve_forever` until interrupted, then `server_close`."""

    daemon_threads = True

    def __init__(self, bind: str, port: int, replay: Path, files: dict[str, bytes]) -> None:
        """Listen on `bind`:`port`."""
        self.replay, self.files = replay, files
        self.names = {*_LOCAL, bind.lower(), *([socket.gethostname().lower()] if bind in _EVERYWHERE else [])}
        self.address_family = socket.AF_INET6 if ":" in bind else socket.AF_INET
        super().__init__((bind, port), _Answer)

    def server_bind(self) -> None:
        """Bind without the reverse name lookup of `HTTPServer`."""
        TCPServer.server_bind(self)
        self.server_name, self.server_port = str(self.server_address[0]), int(self.server_address[1])

    @property
    def address(self) -> str:
        """URL of the page."""
        host, port = self.server_address[:2]
        return f"http://[{host!s}]:{port}/" if ":" in str(host) else f"http://{host!s}:{port}/"


class _Answer(BaseHTTPRequestHandler):
    server: ReplayServer

    def do_GET(self) -> None:
        if not self._is_for_us():
            self.send_error(421, explain="This replay is served only under the address that it was started with.")
            return
        if self.headers.get("Origin", self._here) != self._here:
            self.send_error(403, explain="Requests from pages of other sites are refused.")
            return
        path, _, query = self.path.partition("?")
        if path == "/" and "url=" not in query:
            address = quote(self._here + RECORDING, safe="")
            self.send_response(302)
            self.send_header("Location", f"/?url={address}&theme=dark")  # labels are light
            self.send_header("Content-Length", "0")
            self.end_headers()
        elif path == RECORDING:
            self._send("application/octet-stream", self.server.replay.read_bytes())
        elif path in self.server.files:
            self._send(_FILES[path], self.server.files[path])
        else:
            self.send_error(404)

    @property
    def _here(self) -> str:
        return f"http://{self.headers.get('Host', '')}"

    def _is_for_us(self) -> bool:
        """Return whether the `Host` of the request is a name or address of this server.

        Unlike a name, an address cannot be redirected, so the local address of the connection is accepted.
        """
        hosts = self.headers.get_all("Host", [])
        match = _HOST.fullmatch(hosts[0]) if len(hosts) == 1 else None
        if match is None:
            return False
        name = match[1].strip("[]").lower()
        return name in self.server.names or _same_address(name, str(self.connection.getsockname()[0]))

    def _send(self, kind: str, content: bytes) -> None:
        self.send_response(200)
        for name, value in {"Content-Type": kind, "Content-Length": str(len(content))}.items():
            self.send_header(name, value)
        self.send_header("Content-Security-Policy", POLICY)
        self.send_header("Cross-Origin-Resource-Policy", "same-origin")
        self.send_header("Referrer-Policy", "no-referrer")
        self.send_header("X-Content-Type-Options", "nosniff")
        self.end_headers()
        self.wfile.write(content)

    def log_message(self, *_: object) -> None:
        """Do not log requests."""


def _same_address(name: str, address: str) -> bool:
    try:
        return ipaddress.ip_address(name) == ipaddress.ip_address(address)
    except ValueError:
        return False


def serve(path: Path, *, bind: str = LOOPBACK, port: int = WEB_PORT) -> ReplayServer:
    """Return a listening server of a replay for browsers.

    Args:
        path: The replay.
        bind: Address or name of this machine to listen on. Except on loopback, everybody who can reach it sees the
            replay, unencrypted and without a password. Requests for other host names get status 421.
        port: Port of the page; 0 = a free one.

    Raises:
        CyclekitError: The file does not exist, the port is in use, or Rerun's viewer is not available.
    """
    require_replay(path)
    try:
        return ReplayServer(bind, port, path, _viewer_files())
    except (OSError, UnicodeError) as error:  # UnicodeError: invalid host name
        msg = f"cannot serve the replay at {bind}:{port} ({getattr(error, 'strerror', None) or error})"
        raise CyclekitError(msg, cure="Give another port with --port, or another address with --bind.") from error


def _viewer_files() -> dict[str, bytes]:
    """Return the viewer's files, fetched from Rerun's server on loopback, which is then stopped."""
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
                msg = f"Rerun's viewer for browsers does not start ({error})"
                raise CyclekitError(msg, cure="Open the replay in the native viewer instead: --open.") from error
            time.sleep(0.1)
