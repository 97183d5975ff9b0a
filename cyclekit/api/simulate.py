"""`simulate_logs`: vendor-format logs of a simulated cell, with the ground truth."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cyclekit.api.arguments import Place, Progress, checked
from cyclekit.dataset.guard import check_output
from cyclekit.errors import CyclekitError
from cyclekit.extras import need
from cyclekit.text.results import Result


@dataclass(frozen=True, repr=False)
class SimulatedLogs(Result):
    """Logs of a simulated cell, with the ground truth in `logs`/truth; as a frame one row per file, size in bytes."""

    logs: Path
    scene: str
    executions: int
    seed: int

    def _frame_rows(self) -> list[dict[str, object]]:
        files = sorted(file for file in self.logs.rglob("*") if file.is_file())
        return [{"file": file.relative_to(self.logs).as_posix(), "bytes": file.stat().st_size} for file in files]

    def _lines(self) -> list[str]:
        return [f"{self.logs}: {self.executions} executions of {self.scene}, seed {self.seed}"]


@checked
def simulate_logs(
    scene: str,
    out: Place,
    *,
    executions: int = 20,
    seed: int = 0,
    settings: Mapping[str, Any] | None = None,
    progress: Progress | None = None,
) -> SimulatedLogs:
    """Simulate a cell and log it in vendor formats; the same seed gives the same bytes.

    Args:
        scene: The cell: box-picking, pick-and-package, laser-zones, scanner-visits; scanner-fields, light-curtain,
            guard-door; shared-fixture, handover, fed-line, four-fixtures, machine-tending.
        out: Folder for the logs.
        executions: Number of executions.
        seed: Seed of all random draws.
        settings: Fields of `cyclekit_sim.SimulationOptions`, such as `delta_m` (tracker noise) or `robot_rate_hz`;
            `causes`: True for all causes of lost time other than the operator; `rule` may be the path of a rule file.
        progress: Called with the fraction done and a text.

    Raises:
        MissingExtra: A package of the simulator is not installed.
        CyclekitError: The simulator refuses the settings, or the logs cannot be written.
        OutputError: The folder holds something other than a simulation.
    """
    need("the simulator", "simulate")
    from cyclekit_sim import MixedCauses, SimulationOptions, read_rule, simulate
    from cyclekit_sim.errors import SimulationError

    asked, folder = dict(settings or {}), Path(out)
    rule = asked.get("rule")
    rule_file = rule if isinstance(rule, (str, Path)) else None
    check_output(folder, "logs", [asked.get("operator_log"), rule_file])
    try:
        if isinstance(asked.get("causes"), bool):
            asked["causes"] = MixedCauses() if asked["causes"] else None
        if rule_file is not None:
            asked["rule"] = read_rule(Path(rule_file))
        options = SimulationOptions(**asked)
        logs = simulate(scene, folder, executions=executions, seed=seed, options=options, progress=progress)
    except SimulationError as error:
        raise CyclekitError(str(error)) from error
    except OSError as error:
        msg = f"{folder}: cannot be written ({error.strerror or error})"
        raise CyclekitError(msg, cure="Check the folder, its permissions and the free space.") from error
    return SimulatedLogs(logs, scene, executions, seed)
