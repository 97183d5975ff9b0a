"""The library: one function for each command, in one module of the command's name.

In go paths (str or Path), URLs where the command takes them, or what is open already (`Dataset`, `TrainedModel`,
sequences, changes, jobs); out come frozen dataclasses (`cyclekit.text.results`). Every default is here, nowhere else.
The command line, the fleet and the demo call these functions and no others; users import them from `cyclekit`.
"""
