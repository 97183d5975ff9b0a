"""`convert_log`: one log to one table, for other tools."""

from __future__ import annotations

from cyclekit.api.arguments import checked
from cyclekit.ingest.convert import convert

convert_log = checked(convert, __name__, "convert_log")
