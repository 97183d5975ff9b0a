"""The dataset: recordings, samples and tasks as Parquet files, and typed cards with their provenance.

In: a folder. Out: tables, cards, sessions (recordings on one time axis), changes of signals, the log lines of a sample.
`dataset` opens one; `cards` holds everything that is stored as JSON. Written by `derive` and `ingest`, read by all
rooms above.
"""
