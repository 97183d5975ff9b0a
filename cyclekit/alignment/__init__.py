"""One clock and one base frame per session: clock of each recording, pose of each tracker.

In: recordings in their own clocks and frames, the cell file. Out: fits of clocks and frames with their uncertainty.
`clocks` contains the fits. Used by `people`, `derive`, `estimate`, `replay` and `api`.
"""
