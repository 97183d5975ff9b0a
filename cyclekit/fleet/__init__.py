"""Many cells: what is new of each becomes dataset, model and report, and all of them one page.

A cell is one task of the engine; what fails in one is told, and the others go on. A cell's folder holds

    OUT/NAME/dataset, OUT/NAME/model, OUT/NAME/report.html
    OUT/NAME/cell.json     what was done, when, what failed and why, and the figures of the page
    OUT/index.html         the page of the fleet

How a dataset, a model or a report comes about is the business of the rooms below.
"""

from __future__ import annotations

from cyclekit.fleet.read import Fleet as Fleet
from cyclekit.fleet.read import FleetCell as FleetCell
from cyclekit.fleet.read import load_fleet as load_fleet
from cyclekit.fleet.run import FleetRun as FleetRun
from cyclekit.fleet.run import run_fleet as run_fleet
from cyclekit.fleet.stages import STAGES as STAGES
from cyclekit.fleet.stages import StageResult as StageResult
