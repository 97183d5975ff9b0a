"""Adapters for the log formats that cyclekit reads out of the box; one module per format."""
