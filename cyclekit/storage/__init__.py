"""Files: written atomically, read in parts, checked, locked, fetched from and published to a URL.

In: tables, bytes, paths. Out: Parquet and other files in place. Independent of the meaning of the tables. Used by every
folder above.
"""
