"""The part of the page to play with: other orders, other thresholds, and the cycle time that follows.

`tables` collects what the script needs (`scaling_table` where the model is no rule of positions), `both` where robot
and operator wait for each other, `lists` for plans of task lists; `packed` puts it into the page. The script, in parts
by concern, rolls it out in the browser in the steps of `estimate.walk`, `estimate.joint` or `learning.task_times.roll`
and corrects it as `estimate` does. Its numbers are held against the library's by tests.
"""

from cyclekit.report.play.part import PlayPart as PlayPart
from cyclekit.report.play.part import play_lists as play_lists
from cyclekit.report.play.part import play_part as play_part
