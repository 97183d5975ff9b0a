"""Show a replay in the Rerun viewer that came with the installation, seen by this machine only unless told otherwise.

The viewer is a process of its own. It counts its use and sends that to its makers unless it is told not to, so it is
told not to before it is started. Rerun's own default is to listen on all interfaces; here it is loopback.
"""

from __future__ import annotations

import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path
from urllib.parse import quote

from cyclekit.errors import CyclekitError

LOOPBACK = "127.0.0.1"
WEB_PORT = 9090


def viewer_program() -> list[str]:
    """Return how to start the viewer itself: by `python -m rerun` it would be a child that outlives its parent."""
    found = find_spec("rerun_cli")
    folder = Path(found.origin).parent if found and found.origin else Path()
    for name in ("Rerun.app/Contents/MacOS/Rerun", "rerun.exe", "rerun"):
        if found and (folder / name).is_file():
            return [str(folder / name)]
    return [sys.executable, "-m", "rerun"]


def viewer_command(path: Path) -> list[str]:
    """Return the command that opens `path`; bound to loopback, on a free port."""
    return [*viewer_program(), str(path), "--bind", LOOPBACK, "--port", "auto"]


def server_command(path: Path, *, bind: str = LOOPBACK, port: int = WEB_PORT) -> list[str]:
    """Return the command that serves `path` with the viewer for browsers at `bind`:`port`, its data one port on."""
    ports = ["--port", str(port + 1), "--web-viewer-port", str(port)]
    return [*viewer_program(), str(path), "--serve-web", "--bind", bind, *ports]


def server_address(*, bind: str = LOOPBACK, port: int = WEB_PORT) -> str:
    """Return what to open in a browser on this machine."""
    data = quote(f"rerun+http://{bind}:{port + 1}/proxy", safe="")
    return f"http://{bind}:{port}/?url={data}"


def open_viewer(path: Path) -> subprocess.Popen[bytes]:
    """Start the viewer on `path` and return at once.

    Rerun's usage counting is switched off first; that is a setting of the user's Rerun and stays (it can be switched
    on again by `rerun analytics enable`).

    Raises:
        CyclekitError: There is no such file, or the viewer cannot be started.
    """
    return _started(path, viewer_command(path))


def serve(path: Path, *, bind: str = LOOPBACK, port: int = WEB_PORT) -> subprocess.Popen[bytes]:
    """Start serving `path` to browsers and return at once; ends when the process is ended.

    Usage counting is switched off as by `open_viewer`.

    Args:
        path: The replay.
        bind: Address to listen on. Any other than loopback shows the replay to everybody who can reach it.
        port: Port of the page; the recording itself comes from the next one.

    Raises:
        CyclekitError: There is no such file, or the server cannot be started.
    """
    return _started(path, server_command(path, bind=bind, port=port))


def _started(path: Path, command: list[str]) -> subprocess.Popen[bytes]:
    if not path.is_file():
        msg = f"{path}: no such replay"
        raise CyclekitError(msg, cure="Write it first: cyclekit replay DATASET --execution ID --out FILE.rrd")
    quiet = subprocess.DEVNULL
    try:
        subprocess.run([*viewer_program(), "analytics", "disable"], stdout=quiet, stderr=quiet, check=True)
        return subprocess.Popen(command, stdout=quiet, stderr=quiet)
    except (OSError, subprocess.CalledProcessError) as error:
        msg = f"the Rerun viewer cannot be started ({error})"
        raise CyclekitError(msg, cure=f"Open the file yourself: rerun {path}") from error
