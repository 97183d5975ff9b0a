"""`trace_sample`: the lines of the logs that a sample was made of."""

from __future__ import annotations

from cyclekit.api.arguments import checked
from cyclekit.dataset.trace import trace

trace_sample = checked(trace, __name__, "trace_sample")
