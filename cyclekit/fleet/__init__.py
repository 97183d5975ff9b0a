"""Many cells: updates dataset, model and report of each cell, and one page for all.

A cell is one task of the engine; an error in one cell is reported, and the others continue. The output:

    OUT/NAME/dataset, OUT/NAME/model, OUT/NAME/report.html
    OUT/NAME/cell.json     stages with state, time and text, and the figures for the page
    OUT/index.html         the page of the fleet
"""

from __future__ import annotations

from cyclekit.fleet.read import Fleet as Fleet
from cyclekit.fleet.read import FleetCell as FleetCell
from cyclekit.fleet.read import load_fleet as load_fleet
from cyclekit.fleet.run import FleetRun as FleetRun
from cyclekit.fleet.run import run_fleet as run_fleet
from cyclekit.fleet.stages import STAGES as STAGES
from cyclekit.fleet.stages import StageResult as StageResult
