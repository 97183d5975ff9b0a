"""The safety function read back from logs and network: levels, thresholds in metres, zones on the floor, hysteresis.

fit     which gamma(x_r, x_h) explains the scaling: a distance or the place on the floor; thresholds and how sure
answer  what `cyclekit zones` says
picture the same as SVG
"""

from cyclekit.learning.safety_function.answer import SafetyFunction, read_zones

__all__ = ["SafetyFunction", "read_zones"]
