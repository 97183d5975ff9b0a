"""Replays one or several executions in Rerun: 3-D scene, plots, and text with the cause of each slow-down.

    facts = write_replay(dataset, "run-001", Path("x.rrd"), model=model)
    open_viewer(facts.path, facts.first)

The file contains its layout and opens in any Rerun viewer of the same minor version. Data that the log lacks are left
out, with a note. The only room that imports rerun, which is the extra `replay`.
"""
# ruff: noqa: E402 - the extra is checked before any module imports rerun

from __future__ import annotations

from cyclekit.extras import need

need("a replay", "replay")

from cyclekit.replay.floor import PredictsNow
from cyclekit.replay.prediction_errors import Miss
from cyclekit.replay.recording import ReplayFacts, write_replay
from cyclekit.replay.server import serve
from cyclekit.replay.viewer import open_viewer

__all__ = ["Miss", "PredictsNow", "ReplayFacts", "open_viewer", "serve", "write_replay"]
