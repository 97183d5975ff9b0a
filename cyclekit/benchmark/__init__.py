"""The comparative analysis of the source paper, done again: every network, beside rivals and noise floors.

`plan` says what is trained, `runs` does it and keeps each result in a file of its own, `floors` computes what nobody
can beat from the true safety function, `tables` writes the page. Simulating is the caller's business: nothing here
imports the simulator.
"""

from __future__ import annotations

from cyclekit.benchmark.runs import Settings, benchmark_paper

__all__ = ["Settings", "benchmark_paper"]
