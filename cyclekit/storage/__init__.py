"""Files: written whole or not at all, read by parts, checked, locked, fetched from and published to a URL.

In: tables, bytes, paths. Out: Parquet and other files in place. What the tables mean is nobody's business here; every
room above may use it.
"""
