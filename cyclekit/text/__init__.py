"""Text from logs and files, made safe to show: escaped names, JSON without NaN.

In: any text or value. Out: one visible line, one JSON document. Knows nothing else of cyclekit; everybody may use it.
"""
