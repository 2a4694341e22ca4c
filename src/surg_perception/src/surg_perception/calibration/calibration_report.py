"""A page about a stereo calibration: residual arrows, coverage, errors held out, by distance."""

from __future__ import annotations

import html

import numpy as np

from surg_core.stereo_file import HELD_OUT_DISTANCES
from surg_core.transforms import FloatArray
from surg_perception.calibration.evidence import coverage
from surg_perception.calibration.stereo import StereoFit

MAGNIFIED = 100.0
"""Length of an arrow over the residual."""


def stereo_page(result: StereoFit, title: str) -> str:
    """The page, HTML with pictures in SVG and nothing from outside."""
    fit, stereo = result.fit, result.stereo
    facts = {
        "lens": stereo.left.model,
        "baseline": f"{1e3 * stereo.baseline:.4f} mm",
        "views": str(len(fit.residuals)),
        "rms": f"{fit.rms:.3f} px",
        "held out": f"{result.held_out:.3f} px",
        "rows": f"{result.rows:.3f} px",
        **{
            f"in space at {1e3 * z:g} mm": f"{1e3 * result.error_at(z):.3f} mm"
            for z in HELD_OUT_DISTANCES
        },
    }
    rows = "".join(
        f"<tr><th>{name}</th><td>{html.escape(v)}</td></tr>" for name, v in facts.items()
    )
    eyes = "".join(_eye(result, eye, name) for eye, name in enumerate(("left", "right")))
    return (
        f'<!doctype html><meta charset="utf-8"><title>{html.escape(title)}</title>'
        "<style>body{font-family:sans-serif}svg{border:1px solid #999;width:48%}"
        f"th{{text-align:left}}</style><h1>{html.escape(title)}</h1><table>{rows}</table>"
        f"<p>Residuals, {MAGNIFIED:g} times as long; each view has a colour.</p>{eyes}\n"
    )


def _eye(result: StereoFit, eye: int, name: str) -> str:
    """The residuals of one eye as arrows from the corners (svg)."""
    width, height = result.stereo.left.size
    seen = [view[eye] for view in result.fit.solution.seen]
    reached = ", ".join(f"{value:.2f}" for value in coverage(seen, (width, height)))
    lines = []
    for view, (corners, r) in enumerate(zip(seen, result.fit.residuals, strict=True)):
        both = r.reshape(-1, 2)
        n = len(result.fit.solution.seen[view][0].pixels)
        arrows = both[:n] if eye == 0 else both[n:]
        colour = f"hsl({137 * view % 360},70%,40%)"
        lines += [_arrow(p, d, colour) for p, d in zip(corners.pixels, arrows, strict=True)]
    return (
        f"<figure><figcaption>{name}: reaches {reached} of the half height (quarters)</figcaption>"
        f'<svg viewBox="0 0 {width} {height}">{"".join(lines)}</svg></figure>'
    )


def _arrow(pixel: FloatArray, residual: FloatArray, colour: str) -> str:
    (x, y), (u, v) = pixel, pixel + MAGNIFIED * np.asarray(residual)
    return (
        f'<line x1="{x:.1f}" y1="{y:.1f}" x2="{u:.1f}" y2="{v:.1f}" stroke="{colour}"/>'
        f'<circle cx="{x:.1f}" cy="{y:.1f}" r="1.5" fill="{colour}"/>'
    )
