"""Task lists and events: columns, times, cells, JSON and XES documents, and their common table."""
