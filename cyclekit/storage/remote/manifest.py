"""The manifest of a published folder, which assigns parts to files; it is checked completely before use.

A manifest at a URL must not be trusted. So its names must stay in the folder, and the path of each part must follow
from the file's name and checksum.
"""

from __future__ import annotations

from pathlib import PurePosixPath
from typing import Annotated

import msgspec

from cyclekit.errors import StorageError
from cyclekit.storage.safe_path import name_problem

MANIFEST = "manifest.json"
FORMAT, VERSION = "cyclekit-folder", 1
MAX_BYTES = 64 << 20
"""Maximum size of a manifest, bytes; one of a hundred thousand files has 30 MB."""


class ManifestEntry(msgspec.Struct, frozen=True):
    """One file: path of its part, size in bytes, SHA-256 in hexadecimal digits."""

    part: str
    size: Annotated[int, msgspec.Meta(ge=0)]
    sha256: Annotated[str, msgspec.Meta(pattern="^[0-9a-f]{64}$", max_length=64)]


Files = dict[str, ManifestEntry]
"""The files of a folder by relative path, with `/` as separator."""


class Manifest(msgspec.Struct, frozen=True):
    """Content of `manifest.json`."""

    format: str
    version: int
    files: Files


def parsed(text: bytes, url: str) -> Manifest:
    """Return a checked manifest.

    Raises:
        StorageError: It is not a valid manifest of cyclekit.
    """
    try:
        manifest = msgspec.json.decode(text, type=Manifest)
        _check_format(manifest)
        check(manifest.files)
    except (msgspec.MsgspecError, ValueError, RecursionError) as error:  # includes errors of UTF-8
        cause = f"its {MANIFEST} is not one of cyclekit's ({error})"
        raise StorageError(url, cause, cure="Publish it there again, or use another address.") from error
    return manifest


def read_known(text: str) -> Files:
    """Return the files of a cached folder from its list; empty if the list is damaged."""
    try:
        return msgspec.json.decode(text, type=Files)
    except (msgspec.MsgspecError, ValueError, RecursionError):
        return {}


def _check_format(manifest: Manifest) -> None:
    if (manifest.format, manifest.version) != (FORMAT, VERSION):
        raise ValueError(f"it is not of format {FORMAT!r}, version {VERSION}")


def check(files: Files) -> None:
    """Raise an error unless all files are valid paths in one folder, each with the expected part.

    Raises:
        ValueError: Names the file and the reason.
    """
    folders = {parent.as_posix() for name in files for parent in PurePosixPath(name).parents}
    for name, entry in files.items():
        for step in name.split("/"):
            if (why := name_problem(step)) is not None or step.startswith("."):
                raise ValueError(
                    f"{name[:120]!r} cannot be the name of a file: {why or 'hidden files are not published'}"
                )
        if name in folders:
            raise ValueError(f"{name[:120]!r} is a file and a folder")
        if entry.part != part_of(name, entry.sha256):
            raise ValueError(f"the part of {name[:120]!r} is not at the address where it would be published")


def part_of(name: str, sha256: str) -> str:
    """Return the path of a file's part, from the file's name and checksum."""
    whole = PurePosixPath(name)
    return f"parts/{whole.with_name(f'{whole.stem}-{sha256[:20]}{whole.suffix}')}"
