"""Convert names from data to paths: a path stays in its folder, or the name is rejected.

Names come from a dataset's card, a manifest at a URL, a fleet file or a template, and must not be trusted. The rules
are the same on every operating system, so that files written on one can be read on another.
"""

from __future__ import annotations

import os
import re
from pathlib import Path

from cyclekit.errors import OutsideFolder
from cyclekit.storage.files import shortened

MAX_BYTES = 255
"""Maximum length of a file name in the usual file systems, bytes in UTF-8."""
_DRIVE = re.compile(r"[A-Za-z]:")
_DEVICE = re.compile(r"(con|prn|aux|nul|con(in|out)\$|(com|lpt)[0-9¹²³])[ ]*(\..*)?", re.IGNORECASE | re.DOTALL)
_CONTROL = re.compile("[\x00-\x1f\x7f-\x9f\ud800-\udfff]")
_INVALID = re.compile('[\x00-\x1f\x7f-\x9f\ud800-\udfff/\\\\:*?"<>|]')


def safe_path(folder: Path, *names: str, follow_links: bool = False) -> Path:
    """Return the path of a file or folder within a folder.

    Args:
        folder: The folder.
        names: Names of the subfolders and of the file; a name with `/` must be split first.
        follow_links: Whether links in the folder may lead out of it.

    Raises:
        OutsideFolder: The path would be outside the folder, or a name is not valid on every system.
    """
    for name in names:
        if (why := name_problem(name)) is not None:
            raise OutsideFolder(folder, name, why)
    path = folder.joinpath(*names)
    if not follow_links and leads_out(path, folder):
        raise OutsideFolder(folder, "/".join(names), "a link there leads out of the folder")
    return path


def name_problem(name: object) -> str | None:
    """Return why something is not a valid name of a file or folder on every system; None if it is valid."""
    if not isinstance(name, str) or not name:
        return "it is not a name"
    if name in (".", ".."):
        return "it leads out of the folder"
    if "/" in name or "\\" in name or _DRIVE.match(name) or (os.name == "nt" and ":" in name):
        return "it is a path, not a name"
    if _CONTROL.search(name):
        return "it holds bytes that are not text"
    if name[-1] in ". ":
        return "it ends in a dot or a blank, which Windows removes"
    if _DEVICE.fullmatch(name):
        return "it is a device on Windows"
    if len(name.encode()) > MAX_BYTES:
        return f"it is longer than {MAX_BYTES} bytes"
    return None


def valid_name(name: str) -> str:
    """Return a similar name that is valid on every system, with room for a suffix.

    Two names may become equal; the caller must number them if needed.
    """
    plain = _INVALID.sub("_", name).rstrip(". ")
    return shortened(f"_{plain}" if not plain or _DEVICE.fullmatch(plain) else plain)


def leads_out(path: Path, folder: Path) -> bool:
    """Return whether a path below a folder leads out of it through a link."""
    below = [path, *path.parents]
    if not any(step.is_symlink() for step in below[: len(path.parts) - len(folder.parts)]):
        return False
    return not Path(real_path(path)).is_relative_to(real_path(folder))


def real_path(path: Path) -> str:
    """Return a path with links resolved; circular or unreadable links are kept."""
    try:
        return os.path.realpath(path)
    except OSError:
        return str(path.absolute())
