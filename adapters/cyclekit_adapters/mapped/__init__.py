"""Tables described by a map in the cell file, and drafts of such maps for unknown tables."""
