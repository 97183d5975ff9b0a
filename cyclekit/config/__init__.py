"""The cell file (cell.toml): read, checked, kept as frozen dataclasses, and written.

A cell file tells what the logs cannot: which file plays which role, where the tracker stands, how the clocks relate,
what the places are called. Every key has a default that works; an unknown key is refused with the nearest known one.
What the settings do is the business of the rooms that get them.
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
