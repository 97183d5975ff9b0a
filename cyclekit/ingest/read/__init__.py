"""One log to its tables on disk and its card; resumed after a kill, reused if unchanged.

Entry point: `read_logs`, with one log per task of the engine.
"""
