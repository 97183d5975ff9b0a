"""The comparative analysis of the source paper, done again: every network, beside rivals and noise floors.

`plan` says what is trained, `cells` simulates it, `runs` trains and keeps each result in a file of its own, `floors`
computes what nobody can beat from the true safety function, `tables` and `figures` draw. `python -m benchmarks.paper`.
"""

from __future__ import annotations

from benchmarks.paper.runs import Settings, benchmark_paper

__all__ = ["Settings", "benchmark_paper"]
