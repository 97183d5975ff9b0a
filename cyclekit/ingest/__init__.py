"""Logs to a dataset: finds the logs, reads them with their adapters, checks them, and hands them to `derive`.

In: files and folders of logs, the cell file. Out: a dataset, written atomically; or one log as one table (`convert`).
`registry` knows the adapters. Used by `api` and `inspect`.
"""
