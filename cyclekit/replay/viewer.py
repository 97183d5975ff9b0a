"""Open a replay in the Rerun viewer that came with the installation, seen by this machine only.

The viewer is a process of its own; cyclekit does not wait for it. The viewer counts its use and sends that to its
makers unless it is told not to, so it is told not to, once, before it is started.
"""

from __future__ import annotations

import subprocess
import sys
from typing import TYPE_CHECKING

from cyclekit.errors import CyclekitError

if TYPE_CHECKING:
    from pathlib import Path

LOOPBACK = "127.0.0.1"
_RERUN = (sys.executable, "-m", "rerun")


def viewer_command(path: Path) -> list[str]:
    """Return the command that opens `path`; bound to loopback, on a free port."""
    return [*_RERUN, str(path), "--bind", LOOPBACK, "--port", "auto"]


def open_viewer(path: Path) -> subprocess.Popen[bytes]:
    """Start the viewer on `path` and return at once.

    Rerun's usage counting is switched off first; that is a setting of the user's Rerun and stays (it can be switched
    on again by `rerun analytics enable`).

    Raises:
        CyclekitError: There is no such file, or the viewer cannot be started.
    """
    if not path.is_file():
        msg = f"{path}: no such replay"
        raise CyclekitError(msg, cure="Write it first: cyclekit replay DATASET --execution ID --out FILE.rrd")
    quiet = subprocess.DEVNULL
    try:
        subprocess.run([*_RERUN, "analytics", "disable"], stdout=quiet, stderr=quiet, check=True)
        return subprocess.Popen(viewer_command(path), stdout=quiet, stderr=quiet)
    except (OSError, subprocess.CalledProcessError) as error:
        msg = f"the Rerun viewer cannot be started ({error})"
        raise CyclekitError(msg, cure=f"Open the file yourself: rerun {path}") from error
