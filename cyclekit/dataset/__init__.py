"""The dataset: recordings, samples and tasks as Parquet, and the typed cards that tell where each came from.

In: a folder. Out: tables, cards, sessions (recordings that share a time), changes of signals, the log lines of a sample.
`dataset` opens one; `cards` holds everything that is kept as JSON. Written by `derive` and `ingest`, read by all above.
"""
