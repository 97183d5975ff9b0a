"""The TCP speed of a run that a test makes up."""

import numpy as np

from cyclekit.segmentation.motion import half_window, slope


def tcp_speed(t_s, xyz_m):
    """Return the speed along the path, shape (T,), as `slope` has it over the usual window."""
    return slope(t_s, xyz_m, half_window(float(np.median(np.diff(t_s))))) if len(t_s) > 2 else np.zeros(len(t_s))
