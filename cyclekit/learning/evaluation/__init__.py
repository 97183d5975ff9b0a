"""How good a model is on executions that it never saw, beside simple rivals; and whether the cell has drifted.

`evaluate` is the way in.
"""
