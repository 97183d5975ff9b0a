from __future__ import annotations

import numpy as np
import pytest
from fabricated import LEVELS

from cyclekit.plots import colours
from cyclekit.plots.labels import place_labels


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

    from cyclekit.dataset.dataset import Place

    row = {f"left_{n}": Place(f"left_{n}", (0.2 * n, 1.0, 0.0), 0.1, inferred=False) for n in (1, 2, 3)}
    assert [label.text for label in place_labels(row)] == ["left_1 … 3"]
    named = {n: replace(place, label=f"Left table, slot {n[-1]}") for n, place in row.items()}
    assert [label.text for label in place_labels(named)] == ["Left table, slot 1 … 3"]
    far = {f"table_{n}": Place(f"table_{n}", (2.0 * n, 1.0, 0.0), 0.1, inferred=False) for n in (1, 2)}
    assert [label.text for label in place_labels(far)] == ["table_1", "table_2"]
    assert [label.text for label in place_labels(dataset.places)] == list(dataset.places)
