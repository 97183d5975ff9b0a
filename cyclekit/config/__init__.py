"""The cell file (cell.toml): read, checked, kept as frozen dataclasses, and written.

A cell file gives what the logs do not contain: role of each file, pose of the tracker, clock offsets, names of places.
Every key has a working default; an unknown key is an error that names the nearest known one.
"""

from __future__ import annotations

from cyclekit.config.cells import Cell as Cell
from cyclekit.config.cells import Executions as Executions
from cyclekit.config.cells import Frame as Frame
from cyclekit.config.cells import Furniture as Furniture
from cyclekit.config.cells import NamedPlace as NamedPlace
from cyclekit.config.cells import Robot as Robot
from cyclekit.config.cells import Source as Source
from cyclekit.config.cells import Sync as Sync
from cyclekit.config.cells import Wait as Wait
from cyclekit.config.read import load_cell as load_cell
from cyclekit.config.write import cell_to_toml as cell_to_toml
