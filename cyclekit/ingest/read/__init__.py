"""One log -> its tables on the disk and its card; resumed after a kill, reused when nothing changed.

`read_logs` is the way in: one log a task of the engine.
"""
