"""Logs -> dataset: logs found, read by their adapters, checked, and handed to `derive`.

In: files and folders of logs, the cell file. Out: a dataset, put in place as a whole; or one log as one table
(`convert`). `registry` knows the adapters. Used by `api` and `inspect`.
"""
