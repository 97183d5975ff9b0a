"""The safety function read from logs and network: levels, thresholds in metres, zones on the floor, hysteresis.

fit     finds the gamma(x_r, x_h) that explains the scaling (a distance or the place on the floor), with thresholds
answer  the result of `cyclekit zones`
picture draws it
"""

from cyclekit.learning.safety_function.answer import SafetyFunction, read_zones

__all__ = ["SafetyFunction", "read_zones"]
