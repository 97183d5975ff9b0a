"""The simulated cells that everything is judged on, each made once."""

from __future__ import annotations

import shutil
from typing import TYPE_CHECKING

from cyclekit.ingest.ingest import ingest

if TYPE_CHECKING:
    from pathlib import Path


def prepared(executions: int, scene: str, seed: int, folder: Path) -> None:
    """Simulate and ingest one scene unless that was done; keep the truth beside the dataset, and drop the logs.

    Args:
        executions: How many.
        scene: Name of the cell.
        seed: Of the simulation.
        folder: Gets `dataset` and `truth.json`.
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
