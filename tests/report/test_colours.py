from __future__ import annotations

import numpy as np
import pytest
from fabricated import LEVELS
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from cyclekit.dataset.dataset import Place
from cyclekit.plots import colours
from cyclekit.plots.floor import SHADE, draw_cell, label_axes, square
from cyclekit.plots.labels import CellOnFloor, place_labels


def _seen_by(rgb, kind):
    """Linear RGB as seen with a full colour blindness (Viénot, Brettel and Mollon 1999)."""
    linear = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
    matrices = {
        "none": np.eye(3),
        "red": np.array([[0.11238, 0.88762, 0], [0.11238, 0.88762, 0], [0.00401, -0.00401, 1]]),
        "green": np.array([[0.29275, 0.70725, 0], [0.29275, 0.70725, 0], [-0.02234, 0.02234, 1]]),
    }
    return np.clip(linear @ matrices[kind].T, 0, 1)


def _lab(linear):
    to_xyz = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])
    xyz = linear @ to_xyz.T / np.array([0.9505, 1.0, 1.089])
    f = np.where(xyz > 0.008856, np.cbrt(xyz), 7.787 * xyz + 16 / 116)
    return np.stack([116 * f[..., 1] - 16, 500 * (f[..., 0] - f[..., 1]), 200 * (f[..., 1] - f[..., 2])], axis=-1)


@pytest.mark.parametrize("kind", ["none", "red", "green"])
def test_the_levels_are_told_apart_by_colour_blind_people_too(kind):
    lab = _lab(_seen_by(colours.scaling_rgb(LEVELS) / 255.0, kind))
    apart = [np.linalg.norm(lab[a] - lab[b]) for a in range(5) for b in range(a)]
    assert min(apart) > 15


def test_unknown_scaling_is_grey_and_values_outside_are_clipped():
    assert tuple(colours.scaling_rgb(np.nan)) == colours.to_rgb(colours.UNKNOWN)
    assert colours.scaling_hex(1.7) == colours.scaling_hex(1.0)
    assert colours.scaling_rgb(np.zeros((3, 2))).shape == (3, 2, 3)


@pytest.mark.parametrize("colour", [colours.OPERATOR, colours.ROBOT, colours.PREDICTED, "#1c232b", "#55606c"])
def test_words_on_the_page_stand_out_from_white(colour):
    linear = _seen_by(np.array(colours.to_rgb(colour)) / 255.0, "none")
    luminance = float(linear @ np.array([0.2126, 0.7152, 0.0722]))
    assert 1.05 / (luminance + 0.05) >= 4.5


def test_close_places_of_one_family_share_a_label_and_distant_ones_do_not(dataset):
    from dataclasses import replace

    row = {f"left_{n}": Place(f"left_{n}", (0.2 * n, 1.0, 0.0), 0.1, inferred=False) for n in (1, 2, 3)}
    assert [label.text for label in place_labels(row)] == ["left_1 … 3"]
    named = {n: replace(place, label=f"Left table, slot {n[-1]}") for n, place in row.items()}
    assert [label.text for label in place_labels(named)] == ["Left table, slot 1 … 3"]
    far = {f"table_{n}": Place(f"table_{n}", (2.0 * n, 1.0, 0.0), 0.1, inferred=False) for n in (1, 2)}
    assert [label.text for label in place_labels(far)] == ["table_1", "table_2"]
    assert [label.text for label in place_labels(dataset.places)] == list(dataset.places)


def _floor(places, side_in=2.6):
    figure = Figure(figsize=(side_in, side_in))
    axes = figure.add_subplot()
    axes.update_datalim([(-1.0, -1.0), (3.0, 3.0)])
    named = {name: Place(name, (x, y, 0.0), 0.1, inferred=False) for name, (x, y) in places.items()}
    label_axes(axes, "x, m", "y, m", "speed", draw_cell(axes, CellOnFloor(places=named), "robot"))
    figure.draw_without_rendering()
    return axes, {text.get_text(): text for text in axes.texts}


def test_the_label_of_several_places_covers_neither_the_robot_nor_a_place_and_stays_beside_them():
    row = {f"rack_{n}": at for n, at in enumerate([(-0.12, -0.6), (0.02, -0.62), (0.05, -0.48), (0.46, -0.45)], 1)}
    others = {"home": (0.4, 0.0), "fixture": (0.55, 0.3), "feeder": (0.6, -0.1), "tray": (0.3, -0.6)}
    axes, texts = _floor(others | row)
    box = texts["rack_1 … 4"].get_window_extent()
    marks = axes.transData.transform([(0.0, 0.0), *row.values()])
    assert not any(box.contains(x, y) for x, y in marks.tolist())
    away = [max(box.x0 - x, x - box.x1, box.y0 - y, y - box.y1) for x, y in marks[1:].tolist()]
    assert min(away) < 20


def test_the_scale_of_the_speed_has_the_colours_of_the_squares():
    axes, _ = _floor({"home": (0.4, 0.0)})
    drawn = square(axes, 1.0, 1.0, 0.2, colours.scaling_hex(1.0), alpha=SHADE)
    red, green, blue, alpha = drawn.get_facecolor()
    on_white = [1.0 - alpha * (1.0 - part) for part in (red, green, blue)]
    (bar,) = axes.child_axes
    last = max((each for each in bar.get_children() if isinstance(each, Rectangle)), key=lambda each: each.get_x())
    assert last.get_facecolor()[:3] == pytest.approx(on_white, abs=0.05)
