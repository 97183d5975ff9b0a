"""What is costly and many tests only read - simulated, ingested and trained cells - is made once a run.

The tests run in several processes. Whoever asks first makes it, in a folder that all of them see; the others wait.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
import shutil
from typing import TYPE_CHECKING, Any

from filelock import FileLock

from cyclekit_sim import SimulationOptions, simulate

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    import pytest

SHARED = "shared"
MAX_NAME = 120
"""Maximum length of a folder's name; a longer one is cut and completed by its checksum."""


def shared_folder(factory: pytest.TempPathFactory) -> Path:
    """Return the folder of this run that every process of it sees."""
    own = factory.getbasetemp()
    folder = (own.parent if "PYTEST_XDIST_WORKER" in os.environ else own) / SHARED
    folder.mkdir(exist_ok=True)
    return folder


def made_once(factory: pytest.TempPathFactory, name: str, make: Callable[[Path], object]) -> Path:
    """Return the folder that `make` filled; nobody may change it: a test that writes takes a copy.

    Args:
        factory: Of this process.
        name: Of the folder; one name, one content.
        make: Is given the empty folder, in the process that asks first.
    """
    shared = shared_folder(factory)
    folder, seal = shared / name, shared / f"{name}.seal"
    with FileLock(shared / f"{name}.lock"):
        if not seal.exists():
            shutil.rmtree(folder, ignore_errors=True)  # left by a process that was killed meanwhile
            folder.mkdir()
            make(folder)
            part = seal.with_suffix(".part")
            part.write_text(json.dumps(_content(folder)), encoding="utf-8")
            part.replace(seal)
    return folder


def simulated(factory: pytest.TempPathFactory, scene: str, executions: int, seed: int, **options: Any) -> Path:
    """Return the folder `logs` of a simulated cell with these options."""
    about = "_".join(f"{name}-{value}" for name, value in sorted(options.items()))
    name = re.sub(r"[^\w.-]", "_", f"{scene}_{executions}_{seed}_{about}")
    if len(name) > MAX_NAME:
        name = f"{name[:MAX_NAME]}_{hashlib.sha1(name.encode(), usedforsecurity=False).hexdigest()}"

    def make(folder: Path) -> None:
        simulate(scene, folder / "logs", executions=executions, seed=seed, options=SimulationOptions(**options))

    return made_once(factory, name, make) / "logs"


def changed(shared: Path) -> list[str]:
    """Return every shared folder whose files are no longer those that were made, with the names of these files."""
    found = []
    for seal in sorted(shared.glob("*.seal")):
        before, after = json.loads(seal.read_text(encoding="utf-8")), _content(shared / seal.stem)
        names = [name for name in sorted({*before, *after}) if before.get(name) != after.get(name)]
        if names:
            found.append(f"{seal.stem}: {', '.join(names)}")
    return found


def _content(folder: Path) -> dict[str, list[int]]:
    """Return size and time of every file, by its name."""
    files = [file for file in folder.rglob("*") if file.is_file()]
    about = {file.relative_to(folder).as_posix(): file.stat() for file in files}
    return {name: [stat.st_size, stat.st_mtime_ns] for name, stat in sorted(about.items())}
