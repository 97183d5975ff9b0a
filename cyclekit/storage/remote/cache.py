"""Local copies of URLs: where they are kept."""

from __future__ import annotations

import hashlib
import os
import sys
from pathlib import Path, PurePosixPath
from urllib.parse import urlsplit

WAIT_S = 600.0
"""So long a process waits for another one of this machine that is fetching the same."""


def of_file_url(url: str) -> Path | None:
    """Return the path of this machine that a `file:` URL means, None for another URL."""
    from urllib.request import url2pathname  # brings the web along, which takes longer to import than most logs to find

    parts = urlsplit(url)
    return Path(url2pathname(parts.path)) if parts.scheme.lower() == "file" else None


def cached(url: str, kind: str = "folder") -> Path:
    """Return where the copy of a URL is kept: what cyclekit has published, or `logs` as they lie there."""
    name = PurePosixPath(urlsplit(url).path).name or "folder"
    return _cache() / hashlib.sha256(f"{kind} {url}".encode()).hexdigest()[:20] / name


def known_parts(folder: Path) -> Path:
    """Return the file that says which parts a cached folder was made of."""
    return folder.with_name(f"{folder.name}.json")


def _cache() -> Path:
    if given := os.environ.get("CYCLEKIT_CACHE"):
        return Path(given)
    if sys.platform == "win32":
        return Path(os.environ.get("LOCALAPPDATA", Path.home())) / "cyclekit" / "cache"
    return Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache")) / "cyclekit"
