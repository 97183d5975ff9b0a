"""A folder at a URL: its parts fetched to this machine's cache, and published as a whole by a manifest.

`folders` is the way in; `file_system` is the one module that talks to object stores.
"""
