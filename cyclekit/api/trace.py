"""`trace_sample`: the log lines from which a sample was made."""

from __future__ import annotations

from cyclekit.api.arguments import checked
from cyclekit.dataset.trace import trace

trace_sample = checked(trace, __name__, "trace_sample")
