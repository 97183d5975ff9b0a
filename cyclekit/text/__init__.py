"""Makes text from logs and files safe to show: escaped names, JSON without NaN.

In: any text or value. Out: one visible line, one JSON document. Imports nothing else of cyclekit; all rooms may use it.
"""
