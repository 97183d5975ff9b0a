"""Estimates of a changed cell from the same logs: `cyclekit whatif`. A forecast, no safety proof.

change  the change, as read from a TOML file
alter   the changed safety function, places, base position, and frequency of the operator's visits
answer  cycle times before and after
"""

from cyclekit.estimate.whatif.answer import NO_PROOF, WhatIf, what_if
from cyclekit.estimate.whatif.change import Change, LimitChange, load_changes

__all__ = ["NO_PROOF", "Change", "LimitChange", "WhatIf", "load_changes", "what_if"]
