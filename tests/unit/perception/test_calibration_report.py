"""The pages about a calibration: each drawing states the numbers that it is made of."""

from __future__ import annotations

import base64
import re
import xml.etree.ElementTree as ElementTree
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import surg_core
from helpers.endoscope_files import copied_cell
from helpers.perception.made_up_fits import SIZE, base, handeye, reaching, stereo
from surg_perception.calibration.board import Board
from surg_perception.calibration.chain import ChainError
from surg_perception.output import report_drawing
from surg_perception.output.calibration_report import (
    bases_page,
    chain_page,
    handeye_page,
    stereo_page,
)
from surg_perception.output.report_drawing import Line, in_space, nice, residuals_in_picture

CHAIN = ChainError(tool=1e-4, base=2e-4, handeye=2e-4, stereo=4e-4)


def test_an_arrow_is_the_residual_as_often_as_the_title_states() -> None:
    seen, residual = reaching(0.9), np.tile([0.3, -0.4], (4, 1))
    drawing = residuals_in_picture("left", SIZE, [seen], [residual])
    factor = float(re.search(r"arrows ([\d.]+) times", drawing.title)[1])
    (axes,) = drawing.figure.axes
    arrows = np.array(axes.collections[0].get_segments())
    np.testing.assert_allclose(arrows[:, 0], seen.pixels, atol=0.06)
    np.testing.assert_allclose(arrows[:, 1] - arrows[:, 0], factor * residual, atol=0.11)
    dots, bar = axes.lines
    np.testing.assert_allclose(dots.get_xydata(), seen.pixels, atol=0.06)
    stated = float(axes.texts[0].get_text().removesuffix(" px"))
    assert np.ptp(bar.get_xdata()) == pytest.approx(factor * stated, abs=0.11)
    assert axes.get_xlim() == (0, SIZE[0]) and axes.get_ylim() == (SIZE[1], 0), "y points down"


def test_a_drawing_in_space_has_the_scale_of_its_grid() -> None:
    """With x right and y down: equal scales, and the path in the millimetres of the ticks."""
    path = np.array([[0.0, 0.0, 0.0], [0.02, 0.03, 0.0], [0.04, -0.01, 0.0]])
    drawing = in_space("side", [Line(path, (1.0, 0.0, 0.0))], (0, 1), ("x", "y"), down=True)
    drawing.figure.draw_without_rendering()
    (axes,) = drawing.figure.axes
    np.testing.assert_allclose(axes.lines[0].get_xydata(), 1e3 * path[:, :2])
    corner, right, below = axes.transData.transform([(0, 0), (10, 0), (0, 10)])
    assert right[0] - corner[0] == pytest.approx(corner[1] - below[1], abs=1e-6)
    assert below[1] < corner[1]
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("x [mm]", "y [mm]")
    for axis, place in ((axes.xaxis, 0), (axes.yaxis, 1)):
        for tick in axis.get_major_ticks():
            number = float(tick.label1.get_text().replace("\N{MINUS SIGN}", "-"))
            assert number == pytest.approx(tick.get_loc()), place


@pytest.mark.parametrize("value", [1e-7, 0.99, 1.0, 1.99, 2.0, 4.9, 5.0, 730.0])
def test_a_nice_number_is_the_next_below(value: float) -> None:
    found = nice(value)
    assert 0.39 * value < found <= value * 1.001
    assert f"{found:e}"[0] in "125"


def pages(folder: Path) -> dict[str, str]:
    cell = surg_core.load_cell(copied_cell(folder))
    X_WV, board = np.eye(4), Board()
    made = replace(base(turn=0.001), residuals=np.full((16, 3), 1e-4))
    fit = handeye()
    seen = [(reaching(0.5), reaching(0.5))] * 10
    problem = replace(fit.fit.solution, seen=seen)
    shown = replace(fit, fit=replace(fit.fit, solution=problem, residuals=[np.full(16, 0.1)] * 10))
    return {
        "stereo": stereo_page(stereo(), board, "a < b"),
        "handeye": handeye_page(shown, board, "a < b"),
        "bases": bases_page(made, CHAIN, "a < b"),
        "check": chain_page(cell, X_WV, CHAIN, "a < b"),
    }


def test_each_step_has_a_page_of_its_own_with_the_error_at_80_mm(tmp_path: Path) -> None:
    for step, page in pages(tmp_path).items():
        assert "a &lt; b" in page and "a < b" not in page, step
        assert "80 mm" in page, step
        shown = re.sub(r'src="data:[^"]*"', "", page)
        assert not re.search(r"(src|href)=|url\(|nan", shown), step
        pictures = re.findall(r'src="data:image/svg\+xml;base64,([^"]*)"', page)
        assert len(pictures) == page.count("<figure>"), step
        for each in pictures:
            svg = base64.b64decode(each).decode()
            ElementTree.fromstring(svg)
            assert not re.search(r'href="(?!#)|url\((?!#)|nan', svg), step
        assert page.count("<figcaption>from the right") == 1, step
    assert "agree within 1.00 mm (2 sigma)" in page


def test_a_fit_without_residuals_has_a_page() -> None:
    assert "image/svg+xml" in bases_page(base(), None, "exact")
    assert report_drawing.magnification(np.zeros(3), 1.0) > 0.0
