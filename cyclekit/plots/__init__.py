"""Pictures that stand alone, as SVG, PNG or PDF files or from `.plot()`: levels, zones, time charts, trainings.

In: arrays and plain values. Out: matplotlib figures. Also the one colour scale of speed and the labels of places. The
report's own figures are in `report.figures`. Every room above may use it.
"""
