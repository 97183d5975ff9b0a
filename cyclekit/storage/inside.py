"""A name that comes from data becomes a path here and nowhere else: it stays in its folder, or it is refused.

Data are a dataset's card, a manifest at a URL, a fleet file, a template: whoever wrote them may be anybody. What is
refused is refused on every system, so that what one machine writes another one can read.
"""

from __future__ import annotations

import os
import re
from pathlib import Path

from cyclekit.errors import OutsideFolder
from cyclekit.storage.files import shortened

MAX_BYTES = 255
"""The longest name that the usual file systems take, in UTF-8."""
_DRIVE = re.compile(r"[A-Za-z]:")
_DEVICE = re.compile(r"(con|prn|aux|nul|con(in|out)\$|(com|lpt)[0-9¹²³])[ ]*(\..*)?", re.IGNORECASE | re.DOTALL)
_CONTROL = re.compile("[\x00-\x1f\x7f-\x9f\ud800-\udfff]")
_UNFIT = re.compile('[\x00-\x1f\x7f-\x9f\ud800-\udfff/\\\\:*?"<>|]')


def inside(folder: Path, *names: str, follow_links: bool = False) -> Path:
    """Return the path of something in a folder, by the names of the folders on the way and its own.

    Args:
        folder: Where it must lie.
        names: One name of a file or folder each; what has `/` in it must be split first.
        follow_links: Links in the folder may lead out of it; else that is refused.

    Raises:
        OutsideFolder: A name would lead out of the folder, or is none that every system takes for a file.
    """
    for name in names:
        if (why := unfit(name)) is not None:
            raise OutsideFolder(folder, name, why)
    path = folder.joinpath(*names)
    if not follow_links and leads_out(path, folder):
        raise OutsideFolder(folder, "/".join(names), "a link there leads out of the folder")
    return path


def unfit(name: object) -> str | None:
    """Return why something cannot be the name of one file or folder on every system; None if it can."""
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


def fitting(name: str) -> str:
    """Return a name as alike as can be that every system takes for one file or folder, with room for an ending.

    Two names may become one; who needs them apart numbers them.
    """
    plain = _UNFIT.sub("_", name).rstrip(". ")
    return shortened(f"_{plain}" if not plain or _DEVICE.fullmatch(plain) else plain)


def leads_out(path: Path, folder: Path) -> bool:
    """Tell whether a path below a folder is elsewhere, since a link on the way leads out."""
    below = [path, *path.parents]
    if not any(step.is_symlink() for step in below[: len(path.parts) - len(folder.parts)]):
        return False
    return not Path(real(path)).is_relative_to(real(folder))


def real(path: Path) -> str:
    """Return a path without its links; of links in circles, and of one that cannot be read, the path itself."""
    try:
        return os.path.realpath(path)
    except OSError:
        return str(path.absolute())
