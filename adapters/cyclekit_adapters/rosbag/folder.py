"""Which files a ROS 2 recording of several parts consists of.

The order of the parts does not matter, since messages are put in the order of their time; what matters is that none
is missing and none is another recording's. metadata.yaml says so; where it cannot be read, every bag in the folder is
taken, and that is said.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from typing import Any

from ruamel.yaml import YAML
from ruamel.yaml.error import YAMLError

from cyclekit.errors import DamagedLog

_SUFFIXES = (".mcap", ".db3", ".zstd")


@dataclass
class Folder:
    """The files of a recording; `compressed`: they, or their messages one by one, are packed once more."""

    files: list[Path]
    compressed: bool = False
    warnings: list[str] = field(default_factory=list)


_MOST_BYTES = 1 << 20
"""Of a metadata.yaml: thousands of parts and topics. The parser needs seconds for each MiB."""


def folder_of(path: Path) -> Folder:
    """Return the files of the recording in a folder.

    Raises:
        DamagedLog: None of its files is there.
    """
    present = sorted(file for file in path.iterdir() if file.suffix in _SUFFIXES)
    folder = Folder(present)
    try:
        about = _about(path / "metadata.yaml")
        named = [path / PurePosixPath(str(name)).name for name in about["relative_file_paths"]]
        folder.compressed = str(about.get("compression_mode") or "none").lower() != "none"
    except (OSError, YAMLError, ValueError, KeyError, TypeError, AttributeError) as error:
        said = f"metadata.yaml cannot be read ({type(error).__name__}): every bag in the folder is taken"
        folder.warnings.append(said)
        named = present
    folder.files = list(dict.fromkeys(file for file in named if file.is_file()))
    missing = [file.name for file in named if not file.is_file()]
    if not folder.files:
        cause = f"none of its files is there: {', '.join(missing) or 'no .mcap and no .db3'}"
        raise DamagedLog(path, cause, cure="Copy the whole folder again from where it was recorded.")
    if missing:
        folder.warnings.append(f"parts of the recording are missing: {', '.join(missing)}")
    return folder


def _about(file: Path) -> dict[str, Any]:
    if file.stat().st_size > _MOST_BYTES:
        msg = "no recorder writes so much"
        raise ValueError(msg)
    loaded = YAML(typ="safe").load(file.read_text(encoding="utf-8"))
    about: dict[str, Any] = loaded["rosbag2_bagfile_information"]
    return about
