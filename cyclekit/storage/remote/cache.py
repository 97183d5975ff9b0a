"""Paths of the local copies of URLs."""

from __future__ import annotations

import hashlib
import os
import sys
from pathlib import Path, PurePosixPath
from urllib.parse import urlsplit

WAIT_S = 600.0
"""Maximum time, s, to wait for another local process that fetches the same URL."""


def of_file_url(url: str) -> Path | None:
    """Return the local path of a `file:` URL; None for another URL."""
    from urllib.request import url2pathname  # slow to import, as it brings network modules along

    parts = urlsplit(url)
    return Path(url2pathname(parts.path)) if parts.scheme.lower() == "file" else None


def cached(url: str, kind: str = "folder") -> Path:
    """Return the path of the copy of a URL: a published `folder`, or `logs` as they are."""
    name = PurePosixPath(urlsplit(url).path).name or "folder"
    return _cache() / hashlib.sha256(f"{kind} {url}".encode()).hexdigest()[:20] / name


def known_parts(folder: Path) -> Path:
    """Return the file that lists the parts of a cached folder."""
    return folder.with_name(f"{folder.name}.json")


def _cache() -> Path:
    if given := os.environ.get("CYCLEKIT_CACHE"):
        return Path(given)
    if sys.platform == "win32":
        return Path(os.environ.get("LOCALAPPDATA", Path.home())) / "cyclekit" / "cache"
    return Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache")) / "cyclekit"
