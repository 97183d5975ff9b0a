"""A folder at a URL: its parts are fetched to the local cache, and published atomically by a manifest.

The entry point is `folders`; only `file_system` accesses object stores.
"""
