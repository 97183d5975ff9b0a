"""Makes the simulated cells of the comparison, each once."""

from __future__ import annotations

import shutil
from typing import TYPE_CHECKING

from cyclekit.ingest.ingest import ingest

if TYPE_CHECKING:
    from pathlib import Path


def prepared(executions: int, scene: str, seed: int, folder: Path) -> None:
    """Simulate and ingest one scene unless that was done; keep dataset and truth, and delete the logs.

    Args:
        executions: Number of executions.
        scene: Name of the scene.
        seed: Seed of the simulation.
        folder: Folder for `dataset` and `truth.json`.
    """
    from cyclekit_sim import simulate

    dataset = folder / "dataset"
    if (dataset / "dataset.json").is_file() and (folder / "truth.json").is_file():
        return
    folder.mkdir(parents=True, exist_ok=True)
    logs = simulate(scene, folder / "logs", executions=executions, seed=seed)
    shutil.copyfile(logs / "truth" / "truth.json", folder / "truth.json")
    ingest([logs], dataset)
    shutil.rmtree(logs)
