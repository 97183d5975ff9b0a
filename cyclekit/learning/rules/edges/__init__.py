"""Thresholds and edges of a rule, located at changes of the level, with hysteresis."""
