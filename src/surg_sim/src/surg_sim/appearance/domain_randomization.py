"""How the picture of an episode may look: ranges, and one look that a seed draws from them.

A policy that was trained on one light, one tissue and one pose of the camera needs them. Here each
episode draws its own (domain randomisation: J. Tobin et al., IROS 2017). A look changes pictures
only: neither physics nor the task's draws nor its judgement know of it.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from surg_core.checked_document import CheckedDocument
from surg_sim.arrays import Array

FORMAT = "surg_looks/1"
"""Key ``format`` of a file of ranges."""
TISSUES = ("fat", "bowel", "mesentery", "peritoneum")
"""Materials with a look of their own."""

Range = tuple[float, float]
"""Lowest and highest value."""

_STREAM = tuple(b"look")  # beside the seed, so that no draw of the task is used up


@dataclass(frozen=True)
class TissueAppearance:
    """How a tissue looks, relative to the scene's own texture."""

    colour: tuple[float, float, float]  # factors of red, green, blue
    contrast: float  # factor of the pattern about its mean colour
    gloss: float  # factor of the highlights
    shift: tuple[float, float]  # of the pattern along its two sides, as shares of them


@dataclass(frozen=True)
class Appearance:
    """How an episode looks. Camera and light move in the left optical frame (x right, y down)."""

    light_strength: float  # factor of the endoscope's light
    light_warmth: float  # red is so much stronger, blue so much weaker, as a share
    light_tilt_deg: tuple[float, float]  # rotation vector of the light's direction about x, y
    exposure: float  # factor of the pixel values
    blur_px: float  # standard deviation, in a picture 480 px high
    edge: float  # share of the light that the picture's corners lose
    camera_shift_mm: tuple[float, float, float]  # of cameras and light as one piece
    camera_turn_deg: tuple[float, float, float]  # rotation vector, about the left camera's centre
    tissues: tuple[TissueAppearance, ...]  # of ``TISSUES``

    def described(self) -> dict[str, Any]:
        """The same as values of JSON, tissues by name."""
        words = asdict(self)
        words["tissues"] = dict(zip(TISSUES, words["tissues"], strict=True))
        return words


@dataclass(frozen=True)
class DomainRandomization:
    """Ranges from which a look is drawn, all evenly; directions are even on circle or sphere.

    Raises:
        ValueError: A range is reversed or beyond ``ALLOWED``.
    """

    light_strength: Range = (0.6, 1.4)
    light_warmth: Range = (-0.15, 0.15)
    light_tilt_deg: Range = (0.0, 8.0)  # angle
    tissue_colour: Range = (0.9, 1.1)  # of each tissue and colour
    tissue_contrast: Range = (0.6, 1.4)
    tissue_gloss: Range = (0.4, 1.1)
    tissue_shift: Range = (0.0, 1.0)
    exposure: Range = (0.8, 1.2)
    blur_px: Range = (0.0, 1.5)
    edge: Range = (0.0, 0.4)
    camera_shift_mm: Range = (0.0, 4.0)  # distance
    camera_turn_deg: Range = (0.0, 2.0)  # angle

    ALLOWED: ClassVar[dict[str, Range]] = {
        "light_strength": (0.0, 4.0),
        "light_warmth": (-1.0, 1.0),
        "light_tilt_deg": (0.0, 45.0),
        "tissue_colour": (0.0, 2.0),
        "tissue_contrast": (0.0, 4.0),
        "tissue_gloss": (0.0, 4.0),
        "tissue_shift": (0.0, 1.0),
        "exposure": (0.0, 4.0),
        "blur_px": (0.0, 20.0),
        "edge": (0.0, 1.0),
        "camera_shift_mm": (0.0, 50.0),
        "camera_turn_deg": (0.0, 45.0),
    }

    def __post_init__(self) -> None:
        """Check the ranges."""
        for name, (least, most) in self.ALLOWED.items():
            low, high = getattr(self, name)
            if not least <= low <= high <= most:  # false for what is not a number
                raise ValueError(
                    f"{name}: {low:g} to {high:g}; allowed: low to high within "
                    f"{least:g} to {most:g}"
                )

    @classmethod
    def none(cls) -> DomainRandomization:
        """Ranges without width, which draw the plain look; to vary some with ``replace``."""
        ones = ("light_strength", "tissue_colour", "tissue_contrast", "tissue_gloss", "exposure")
        return cls(**{f.name: (float(f.name in ones),) * 2 for f in fields(cls)})

    @classmethod
    def read(cls, file: Path | str) -> DomainRandomization:
        """Ranges of a YAML file, ``name: [low, high]``; what it leaves out does not vary.

        Raises:
            ConfigError: It is missing, no YAML, or holds an unknown key or a bad range.
        """
        document = CheckedDocument.read(file)
        document.choice("format", [FORMAT])
        ranges = asdict(cls.none())
        for name, (least, most) in cls.ALLOWED.items():
            if document.has(name):
                bound = max(-least, most)
                low, high = document.numbers(name, 2, bound, "").tolist()
                if not least <= low <= high <= most:
                    allowed = f"low, high within {least:g} to {most:g}"
                    raise document.refusal(name, f"[{low:g}, {high:g}]", allowed)
                ranges[name] = (low, high)
        document.finish()
        return cls(**ranges)

    def draw(self, seed: int) -> Appearance:
        """The look of an episode. A range without width does not change the other draws."""
        rng = np.random.default_rng([seed, *_STREAM])

        def even(name: str, count: int) -> list[float]:
            low, high = getattr(self, name)
            return list(rng.uniform(low, high, count).tolist())

        def aimed(name: str, axes: int) -> Array:
            direction: Array = rng.normal(size=axes)
            return even(name, 1)[0] * direction / math.hypot(*direction)

        tissues = []
        for _ in TISSUES:
            red, green, blue = even("tissue_colour", 3)
            (contrast,), (gloss,) = even("tissue_contrast", 1), even("tissue_gloss", 1)
            along, across = even("tissue_shift", 2)
            tissues.append(TissueAppearance((red, green, blue), contrast, gloss, (along, across)))
        light, shift, turn = (
            aimed(name, axes).tolist()
            for name, axes in (
                ("light_tilt_deg", 2),
                ("camera_shift_mm", 3),
                ("camera_turn_deg", 3),
            )
        )
        return Appearance(
            light_strength=even("light_strength", 1)[0],
            light_warmth=even("light_warmth", 1)[0],
            light_tilt_deg=(light[0], light[1]),
            exposure=even("exposure", 1)[0],
            blur_px=even("blur_px", 1)[0],
            edge=even("edge", 1)[0],
            camera_shift_mm=(shift[0], shift[1], shift[2]),
            camera_turn_deg=(turn[0], turn[1], turn[2]),
            tissues=tuple(tissues),
        )
