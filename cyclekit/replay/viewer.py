"""Opens a replay in the installed Rerun viewer, on this machine only.

The viewer is a separate process. By default it sends usage statistics to its makers and listens on all interfaces:
before it starts, statistics are switched off, and it listens on loopback.
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
    """Return the command of the viewer's program; started by `python -m rerun`, it would outlive its parent process."""
    found = find_spec("rerun_cli")
    folder = Path(found.origin).parent if found and found.origin else Path()
    for name in ("Rerun.app/Contents/MacOS/Rerun", "rerun.exe", "rerun"):
        if found and (folder / name).is_file():
            return [str(folder / name)]
    return [sys.executable, "-m", "rerun"]


def viewer_command(path: Path, port: int) -> list[str]:
    """Return the command that opens `path`, listening on loopback."""
    return [*viewer_program(), str(path), "--bind", LOOPBACK, "--port", str(port)]


def open_viewer(path: Path, first: Opening | None = None) -> subprocess.Popen[bytes]:
    """Start the viewer on `path`; return when it shows the interval to play first, or after PATIENCE_S.

    Rerun's usage statistics are switched off first, permanently for this user (`rerun analytics enable` switches them
    on again).

    Args:
        path: The replay.
        first: Interval to play first, `ReplayFacts.first`; None = start at the beginning.

    Raises:
        CyclekitError: The file does not exist, or the viewer cannot be started.
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
    """Move a viewer to the start of `first`; return False if it is not yet ready.

    A recording cannot set its start time, and remote control of the viewer is experimental: on any error the viewer
    stays open.
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
    """Check that a replay exists.

    Raises:
        CyclekitError: The file does not exist.
    """
    if not path.is_file():
        msg = f"{path}: no such replay"
        write = command_line("replay", "DATASET", "--execution", "1", "--out", path)
        raise CyclekitError(msg, cure=f"Write it first: {write}")


def no_usage_counting() -> None:
    """Switch Rerun's usage statistics off.

    Raises:
        CyclekitError: The viewer cannot be started.
    """
    quiet = subprocess.DEVNULL
    try:
        subprocess.run([*viewer_program(), "analytics", "disable"], stdout=quiet, stderr=quiet, check=True)
    except (OSError, subprocess.CalledProcessError) as error:
        msg = f"the Rerun viewer cannot be started ({error})"
        raise CyclekitError(msg, cure="Install rerun-sdk again, or open the file by another Rerun viewer.") from error
