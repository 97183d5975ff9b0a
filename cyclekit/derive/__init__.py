"""Recordings -> samples and tasks: runs alignment, segmentation, people and scaling, session by session.

In: the recordings of a dataset and the cell file. Out: the tables SAMPLES and TASKS. The entry point is `passes`,
called only by `ingest`. It reads no vendor file, so it can be repeated.
"""
