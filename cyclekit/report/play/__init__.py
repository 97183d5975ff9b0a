"""The part of the page to play with: other orders, other thresholds, and the cycle time that follows.

`tables` collects what the script needs for sequences of the robot alone, `both` for cells with waits and plans for
both agents, `lists` for plans of task lists. `scaling_grid` prepares a network, `scaling_table` a model on states of
the operator; a rule goes into the page as it is. `packed` puts all into the page. The script rolls cycles out in the
browser in the steps of `estimate.cycle.engine`, `estimate.joint` or `learning.task_times.roll`, and corrects them as
`estimate` does. Tests compare its numbers with the library's.
"""

from cyclekit.report.play.part import PlayPart as PlayPart
from cyclekit.report.play.part import play_lists as play_lists
from cyclekit.report.play.part import play_part as play_part
