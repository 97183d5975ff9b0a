"""Recordings -> samples and tasks: alignment, segmentation, people and scaling put to work, session by session.

In: the recordings of a dataset and the cell file. Out: the tables SAMPLES and TASKS. `passes` is the way in; called by
`ingest` only. Needs no vendor's file, so it can be done again.
"""
