"""Polygons on the floor: fitted, with the fewest sides that explain the samples."""
