"""Open a replay in the Rerun viewer that came with the installation, seen by this machine only.

The viewer is a process of its own; cyclekit does not wait for it.
"""

from __future__ import annotations

import os
import subprocess
import sys
from typing import TYPE_CHECKING

from cyclekit.errors import CyclekitError

if TYPE_CHECKING:
    from pathlib import Path

LOOPBACK = "127.0.0.1"


def viewer_command(path: Path) -> list[str]:
    """Return the command that opens `path`; bound to loopback, on a free port."""
    return [sys.executable, "-m", "rerun", str(path), "--bind", LOOPBACK, "--port", "auto"]


def open_viewer(path: Path) -> subprocess.Popen[bytes]:
    """Start the viewer on `path` and return at once.

    Raises:
        CyclekitError: There is no such file, or the viewer cannot be started.
    """
    if not path.is_file():
        msg = f"{path}: no such replay"
        raise CyclekitError(msg, cure="Write it first: cyclekit replay DATASET --execution ID --out FILE.rrd")
    quiet = {**os.environ, "RERUN_ANALYTICS": "off"}
    try:
        return subprocess.Popen(viewer_command(path), env=quiet, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    except OSError as error:
        msg = f"the Rerun viewer cannot be started ({error.strerror or error})"
        raise CyclekitError(msg, cure=f"Open the file yourself: rerun {path}") from error
