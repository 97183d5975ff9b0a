"""Draws figures as SVG, PNG or PDF files or for `.plot()`: levels, zones, time charts, trainings.

In: arrays and plain values. Out: matplotlib figures. Also holds the common colour scale of speed and the labels of
places. Figures of the report are in `report.figures`. Every room above may use it.
"""
