"""Samples to which rules are fitted: positions, distances, signals, and where a region holds."""
