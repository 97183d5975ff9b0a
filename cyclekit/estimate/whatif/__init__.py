"""The same logs against another cell: `cyclekit whatif`. A forecast, no safety proof.

change  what is changed, as a TOML file says it
alter   the change made: another safety function, moved places, moved base, an operator who comes more or less often
answer  cycle times before and after
"""

from cyclekit.estimate.whatif.answer import NO_PROOF, WhatIf, what_if
from cyclekit.estimate.whatif.change import Change, LimitChange, load_changes

__all__ = ["NO_PROOF", "Change", "LimitChange", "WhatIf", "load_changes", "what_if"]
