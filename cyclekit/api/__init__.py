"""The library: one function for each command, in one module of the command's name.

In: paths (str or Path), URLs where the command takes them, or open objects (`Dataset`, `TrainedModel`, sequences,
changes, jobs). Out: frozen dataclasses (`cyclekit.text.results`). All defaults are defined in this room. The command
line, the fleet and the demo call only these functions; users import them from `cyclekit`.
"""
