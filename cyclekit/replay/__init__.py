"""A replay of one or several executions in Rerun: the scene, the plots and the words that say why the robot was slow.

    facts = write_replay(dataset, "run-001", Path("x.rrd"), model=model)
    open_viewer(facts.path, facts.first)

The file holds its own layout and opens in any Rerun viewer of the same minor version. What is missing from the log is
missing from the replay, and the replay says so. The only room that knows rerun, which is the extra `replay`.
"""
# ruff: noqa: E402 - whether rerun is there is asked before anything imports it

from __future__ import annotations

from cyclekit.extras import need

need("a replay", "replay")

from cyclekit.replay.floor import PredictsNow
from cyclekit.replay.misses import Miss
from cyclekit.replay.recording import ReplayFacts, write_replay
from cyclekit.replay.server import serve
from cyclekit.replay.viewer import open_viewer

__all__ = ["Miss", "PredictsNow", "ReplayFacts", "open_viewer", "serve", "write_replay"]
