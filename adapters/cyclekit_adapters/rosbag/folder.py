"""Files of a ROS 2 recording of several parts.

The order of the parts does not matter, because messages are ordered by time, but none may be missing or belong to
another recording. metadata.yaml lists them. If it cannot be read, all bags in the folder are used, with a warning.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from typing import Any

from cyclekit.adapter import inside
from cyclekit.errors import DamagedLog, OutsideFolder

_SUFFIXES = (".mcap", ".db3", ".zstd")
_MAX_BYTES = 1 << 20  # of metadata.yaml: no recorder writes more
_HEAD = "rosbag2_bagfile_information:\n"
_FILES = re.compile(r"^  relative_file_paths:\n((?: +- (['\"]?)[\w./ -]+\2\n)+)(?=  \w|\Z)", re.MULTILINE)


@dataclass
class Folder:
    """Files of a recording."""

    files: list[Path]
    warnings: list[str] = field(default_factory=list)


def folder_of(path: Path) -> Folder:
    """Return the files of the recording in a folder.

    Raises:
        DamagedLog: None of its files exists.
    """
    present = sorted(file for file in path.iterdir() if file.suffix in _SUFFIXES)
    folder = Folder(present)
    try:
        about = _about(path / "metadata.yaml")
        named = [
            inside(path, PurePosixPath(str(name)).name, follow_links=True) for name in about["relative_file_paths"]
        ]
    except OutsideFolder as error:
        raise DamagedLog(path, f"metadata.yaml: {error.cause}", cure="Copy the recording again.") from error
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        warning = f"metadata.yaml cannot be read ({type(error).__name__}): every bag in the folder is read"
        folder.warnings.append(warning)
        named = present
    folder.files = list(dict.fromkeys(file for file in named if file.is_file()))
    missing = [file.name for file in named if not file.is_file()]
    if not folder.files:
        cause = f"none of its files was found: {', '.join(missing) or 'no .mcap and no .db3'}"
        raise DamagedLog(path, cause, cure="Copy the whole folder again from where it was recorded.")
    if missing:
        folder.warnings.append(f"parts of the recording are missing: {', '.join(missing)}")
    return folder


def _about(file: Path) -> dict[str, Any]:
    """Return the content of metadata.yaml; rosbag2's usual form is read by line, as YAML parsing is slow."""
    if file.stat().st_size > _MAX_BYTES:
        raise ValueError("it is larger than any recorder writes")
    text = file.read_text(encoding="utf-8")
    files = _FILES.findall(text)
    if text.startswith(_HEAD) and len(files) == 1 and text.count("relative_file_paths") == 1:
        names = [line.strip()[1:].strip().strip("'\"") for line in files[0][0].splitlines()]
        return {"relative_file_paths": names}
    from ruamel.yaml import YAML
    from ruamel.yaml.error import YAMLError

    try:
        about: dict[str, Any] = YAML(typ="safe").load(text)["rosbag2_bagfile_information"]
    except YAMLError as error:
        raise ValueError(str(error)) from error
    return about
