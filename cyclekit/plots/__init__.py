"""Pictures of what was learned, as SVG or PNG files: levels, calibration, accuracy. matplotlib is imported here only.

Figures of the report are the report's own; these stand alone.
"""
