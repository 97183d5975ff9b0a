"""The formats: one module a format, each with its `ADAPTER`.

A new format is a module here and one line in pyproject.toml. What several formats share lies in the folders beside.
"""
