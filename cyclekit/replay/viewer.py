"""Open a replay in the Rerun viewer that came with the installation, seen by this machine only.

The viewer is a process of its own. It counts its use and sends that to its makers unless it is told not to, so it is
told not to before it is started. Rerun's own default is to listen on all interfaces; here it is loopback.
"""

from __future__ import annotations

import socket
import subprocess
import sys
import time
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

from rerun.experimental import ViewerClient

from cyclekit.errors import CyclekitError, command_line
from cyclekit.replay.sink import PHASE

if TYPE_CHECKING:
    from cyclekit.replay.layout import Opening

LOOPBACK = "127.0.0.1"
PATIENCE_S = 20.0


def viewer_program() -> list[str]:
    """Return how to start the viewer itself: by `python -m rerun` it would be a child that outlives its parent."""
    found = find_spec("rerun_cli")
    folder = Path(found.origin).parent if found and found.origin else Path()
    for name in ("Rerun.app/Contents/MacOS/Rerun", "rerun.exe", "rerun"):
        if found and (folder / name).is_file():
            return [str(folder / name)]
    return [sys.executable, "-m", "rerun"]


def viewer_command(path: Path, port: int) -> list[str]:
    """Return the command that opens `path`; bound to loopback."""
    return [*viewer_program(), str(path), "--bind", LOOPBACK, "--port", str(port)]


def open_viewer(path: Path, first: Opening | None = None) -> subprocess.Popen[bytes]:
    """Start the viewer on `path` and return when it shows what is to be played first, or after PATIENCE_S.

    Rerun's usage counting is switched off first; that is a setting of the user's Rerun and stays (it can be switched
    on again by `rerun analytics enable`).

    Args:
        path: The replay.
        first: Its `ReplayFacts.first`; None leaves the viewer at the beginning.

    Raises:
        CyclekitError: There is no such file, or the viewer cannot be started.
    """
    require_replay(path)
    no_usage_counting()
    port = free_port()
    viewer = subprocess.Popen(viewer_command(path, port), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    until_s = time.monotonic() + PATIENCE_S
    while first is not None and viewer.poll() is None and time.monotonic() < until_s:
        if _goes_to(first, port):
            break
        time.sleep(0.2)
    return viewer


def _goes_to(first: Opening, port: int) -> bool:
    """Move a viewer to the beginning of `first`; False = it is not yet ready for that.

    A recording cannot say where it is entered, and the viewer's control by programs is experimental: whatever it
    answers, the viewer itself stays open.
    """
    try:
        with ViewerClient.connect(f"rerun+http://{LOOPBACK}:{port}/proxy") as viewer:
            if not viewer.get_state().active_recording:
                return False
            if first.timeline == PHASE:
                viewer.set_time(first.timeline, sequence=first.start, play_state="playing")
            else:
                viewer.set_time(first.timeline, duration=first.start / 1e9, play_state="playing")
    except Exception:
        return False
    return True


def free_port() -> int:
    """Return a free port of this machine."""
    with socket.socket() as free:
        free.bind((LOOPBACK, 0))
        return int(free.getsockname()[1])


def require_replay(path: Path) -> None:
    """Refuse a replay that is not there.

    Raises:
        CyclekitError: There is no such file.
    """
    if not path.is_file():
        msg = f"{path}: no such replay"
        write = command_line("replay", "DATASET", "--execution", "1", "--out", path)
        raise CyclekitError(msg, cure=f"Write it first: {write}")


def no_usage_counting() -> None:
    """Switch Rerun's usage counting off.

    Raises:
        CyclekitError: The viewer cannot be started.
    """
    quiet = subprocess.DEVNULL
    try:
        subprocess.run([*viewer_program(), "analytics", "disable"], stdout=quiet, stderr=quiet, check=True)
    except (OSError, subprocess.CalledProcessError) as error:
        msg = f"the Rerun viewer cannot be started ({error})"
        raise CyclekitError(msg, cure="Install rerun-sdk again, or open the file by another Rerun viewer.") from error
