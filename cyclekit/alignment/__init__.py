"""One clock and one base frame per session: which clock each recording gets, where each tracker stands.

In: recordings in their own clocks and frames, the cell file. Out: fits of clocks and frames with how well they are
known. `clocks` holds the fits. Used by `people`, `derive`, `estimate`, `replay` and `api`.
"""
