"""What tests of ingest share: a robot that goes there and back, and what is in the files of a dataset."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

ROUND_TRIP = [("stand", 0.5), ("move", 0.3), ("stand", 0.6), ("move", 0.0), ("stand", 0.5)]
"""Of fixture `robot_log`: seconds of standing, metres along x."""


def bytes_and_times(folder: Path) -> dict[str, tuple[str, int]]:
    files = sorted(file for file in folder.rglob("*") if file.is_file())
    digest = {file: hashlib.sha256(file.read_bytes()).hexdigest() for file in files}
    return {f.relative_to(folder).as_posix(): (digest[f], f.stat().st_mtime_ns) for f in files}


def only_bytes(folder: Path) -> dict[str, str]:
    return {name: digest for name, (digest, _) in bytes_and_times(folder).items()}


def without_checksums(folder: Path) -> Path:
    """Make a dataset one that keeps no checksums, as earlier versions wrote them: its files may be changed."""
    file = folder / "dataset.json"
    card = json.loads(file.read_text(encoding="utf-8"))
    kept = {name: value for name, value in card.items() if name not in ("files", "card_blake3")}
    file.write_text(json.dumps(kept), encoding="utf-8")
    return folder
