"""Open a replay in the Rerun viewer that came with the installation, seen by this machine only.

The viewer is a process of its own. It counts its use and sends that to its makers unless it is told not to, so it is
told not to before it is started. Rerun's own default is to listen on all interfaces; here it is loopback.
"""

from __future__ import annotations

import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

from cyclekit.errors import CyclekitError

LOOPBACK = "127.0.0.1"


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


def open_viewer(path: Path) -> subprocess.Popen[bytes]:
    """Start the viewer on `path` and return at once.

    Rerun's usage counting is switched off first; that is a setting of the user's Rerun and stays (it can be switched
    on again by `rerun analytics enable`).

    Raises:
        CyclekitError: There is no such file, or the viewer cannot be started.
    """
    require_replay(path)
    no_usage_counting()
    return subprocess.Popen(viewer_command(path), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)


def require_replay(path: Path) -> None:
    """Refuse a replay that is not there.

    Raises:
        CyclekitError: There is no such file.
    """
    if not path.is_file():
        msg = f"{path}: no such replay"
        raise CyclekitError(msg, cure="Write it first: cyclekit replay DATASET --execution ID --out FILE.rrd")


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
