"""Reproduces the comparative analysis of the source paper: every network, with rivals and noise floors.

`plan` lists the trainings, `cells` simulates, `runs` trains and stores each result in a separate file, `floors`
computes lower bounds of the error from the true safety function, `tables` and `figures` draw. Run by
`python -m benchmarks.paper`.
"""

from __future__ import annotations

from benchmarks.paper.runs import Settings, benchmark_paper

__all__ = ["Settings", "benchmark_paper"]
