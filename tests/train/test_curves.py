"""curves.png: a whole picture, with a line where a panel has figures."""

import numpy as np
from matplotlib.image import imread

from train.curves import draw_curves

ROWS = [{"iteration": i, "eg_mpbpe_mm": 100.0 - i, "sigma/body": 0.1 / i, "falls": None} for i in (1, 2, 3)]


def picture(rows, path):
    draw_curves(rows, path)
    return imread(path)


def test_a_line_is_drawn_in_the_panel_of_its_figure_and_in_no_other(tmp_path):
    without = [{key: row[key] for key in row if key != "eg_mpbpe_mm"} for row in ROWS]
    whole, part = picture(ROWS, tmp_path / "whole.png"), picture(without, tmp_path / "part.png")
    assert whole.shape[:2] == (700, 1300)
    rows, columns = np.nonzero((whole != part).any(axis=2))
    assert len(rows) > 500
    assert rows.max() < 350 and columns.max() < 460  # the next panel begins at 490
