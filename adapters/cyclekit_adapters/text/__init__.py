"""Text tables of any dialect, read by blocks: delimiters, headers, numbers, JSON rows, worksheets."""
