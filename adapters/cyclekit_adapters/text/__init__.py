"""Readers of text tables of any dialect, block by block: delimiters, headers, numbers, JSON rows, worksheets."""
