"""The pages about a calibration: each drawing states the numbers that it is made of."""

from __future__ import annotations

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


def drawing(figure: str) -> ElementTree.Element:
    return ElementTree.fromstring(figure)


def numbers(element: ElementTree.Element, *names: str) -> list[float]:
    return [float(element.attrib[name]) for name in names]


def test_an_arrow_is_the_residual_as_often_as_the_title_states() -> None:
    seen, residual = reaching(0.9), np.tile([0.3, -0.4], (4, 1))
    svg = drawing(residuals_in_picture("left", SIZE, [seen], [residual]))
    factor = float(re.search(r"arrows ([\d.]+) times", svg[0].text)[1])
    *arrows, bar = svg.iter("line")
    for arrow, pixel in zip(arrows, seen.pixels, strict=True):
        x, y, u, v = numbers(arrow, "x1", "y1", "x2", "y2")
        np.testing.assert_allclose([x, y], pixel, atol=0.06)
        np.testing.assert_allclose([u - x, v - y], factor * residual[0], atol=0.11)
    x, u = numbers(bar, "x1", "x2")
    stated = float(next(svg.iter("text")).text.removesuffix(" px"))
    assert u - x == pytest.approx(factor * stated, abs=0.11)


def test_a_drawing_in_space_has_the_scale_of_its_grid() -> None:
    """With x right and y down: the tick that is stated beside a line is its place."""
    path = np.array([[0.0, 0.0, 0.0], [0.02, 0.03, 0.0], [0.04, -0.01, 0.0]])
    svg = drawing(in_space("side", [Line(path, "red")], (0, 1), ("x", "y"), down=True))
    words = {(round(float(t.attrib["x"])), round(float(t.attrib["y"]))): t.text for t in
             svg.iter("text")}  # fmt: skip
    across, along = {}, {}
    for line in svg.iter("line"):
        x, y, u, v = numbers(line, "x1", "y1", "x2", "y2")
        where = (round(x - 8), round(v + 18)) if x == u else (8, round(y + 4))
        near = min(words, key=lambda at: abs(at[0] - where[0]) + abs(at[1] - where[1]))
        (across if x == u else along)[float(words[near])] = x if x == u else y
    points = next(svg.iter("polyline")).attrib["points"].split()
    for point, p in zip(points, 1e3 * path, strict=True):
        x, y = (float(word) for word in point.split(","))
        ticks = sorted(across), sorted(along)
        assert x == pytest.approx(np.interp(p[0], ticks[0], [across[t] for t in ticks[0]]), abs=1)
        assert y == pytest.approx(np.interp(p[1], ticks[1], [along[t] for t in ticks[1]]), abs=1)


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
        assert not re.search(r"(src|href)=|url\(|nan", page), step
        for figure in re.findall(r"<figure>.*?</figure>", page):
            drawing(figure)
        assert page.count("from the right") == 1, step
    assert "agree within 1.00 mm (2 sigma)" in page


def test_a_fit_without_residuals_has_a_page() -> None:
    assert "<svg" in bases_page(base(), None, "exact")
    assert report_drawing.magnification(np.zeros(3), 1.0) > 0.0
