"""The manifest of a published folder: which part is which file; looked through as a whole before any of it is used.

Whoever can write at a URL can write any manifest. So its names must stay in the folder, and its parts are where a
publisher would have put them: the place of a part follows from the file's name and checksum.
"""

from __future__ import annotations

from pathlib import PurePosixPath
from typing import Annotated

import msgspec

from cyclekit.errors import StorageError
from cyclekit.storage.inside import unfit

MANIFEST = "manifest.json"
FORMAT, VERSION = "cyclekit-folder", 1
MAX_BYTES = 64 << 20
"""A manifest of a hundred thousand files has 30 MB; a larger one is not read."""


class ManifestEntry(msgspec.Struct, frozen=True):
    """One file: where its part is, its size in bytes, its SHA-256 in hexadecimal digits."""

    part: str
    size: Annotated[int, msgspec.Meta(ge=0)]
    sha256: Annotated[str, msgspec.Meta(pattern="^[0-9a-f]{64}$", max_length=64)]


Files = dict[str, ManifestEntry]
"""The files of a folder by name, `/` between the folders on the way."""


class Manifest(msgspec.Struct, frozen=True):
    """What `manifest.json` says."""

    format: str
    version: int
    files: Files


def parsed(text: bytes, url: str) -> Manifest:
    """Return a manifest, looked through.

    Raises:
        StorageError: It is none, or one that no cyclekit publishes.
    """
    try:
        manifest = msgspec.json.decode(text, type=Manifest)
        _check_format(manifest)
        check(manifest.files)
    except (msgspec.MsgspecError, ValueError, RecursionError) as error:  # of UTF-8 as well
        cause = f"its {MANIFEST} is not one of cyclekit's ({error})"
        raise StorageError(url, cause, cure="Publish it there again, or use another address.") from error
    return manifest


def read_known(text: str) -> Files:
    """Return the files that a cached folder was made of; none where that was not written whole."""
    try:
        return msgspec.json.decode(text, type=Files)
    except (msgspec.MsgspecError, ValueError, RecursionError):
        return {}


def _check_format(manifest: Manifest) -> None:
    if (manifest.format, manifest.version) != (FORMAT, VERSION):
        raise ValueError(f"it is not of format {FORMAT!r}, version {VERSION}")


def check(files: Files) -> None:
    """Refuse files that would not all lie in one folder, each with a part of its own.

    Raises:
        ValueError: Which, and why.
    """
    folders = {parent.as_posix() for name in files for parent in PurePosixPath(name).parents}
    for name, entry in files.items():
        for step in name.split("/"):
            if (why := unfit(step)) is not None or step.startswith("."):
                raise ValueError(
                    f"{name[:120]!r} cannot be the name of a file: {why or 'hidden files are not published'}"
                )
        if name in folders:
            raise ValueError(f"{name[:120]!r} is a file and a folder")
        if entry.part != part_of(name, entry.sha256):
            raise ValueError(f"the part of {name[:120]!r} is not at the address where it would be published")


def part_of(name: str, sha256: str) -> str:
    """Return where the part of a file is published, by the file's name and checksum."""
    whole = PurePosixPath(name)
    return f"parts/{whole.with_name(f'{whole.stem}-{sha256[:20]}{whole.suffix}')}"
