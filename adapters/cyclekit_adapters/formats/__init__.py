"""The log formats: one module per format, each with its `ADAPTER`.

A new format needs a module here and one line in pyproject.toml. Code shared by several formats is in the sibling
folders.
"""
