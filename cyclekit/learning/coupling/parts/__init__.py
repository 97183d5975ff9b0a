"""Parts that no signal reports: their gaps, and how many may wait."""
