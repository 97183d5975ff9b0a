"""`ingest_logs`: logs of any mix of supported formats to one dataset."""

from __future__ import annotations

from cyclekit.api.arguments import checked
from cyclekit.ingest.ingest import ingest

ingest_logs = checked(ingest, __name__, "ingest_logs")
