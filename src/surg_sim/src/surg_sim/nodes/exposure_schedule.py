"""When the camera is exposed: the ticks whose state is drawn.

In lock-step every 25th tick: nothing is left out, whoever draws. In free-run a picture that is
begun late is an old picture. So, 20 times a second at most, the state is handed out when the
renderer is ready to draw it, instead of waiting for it in a queue while it ages.
"""

from __future__ import annotations

RENDERER = "endoscope"
"""Who says on /sim/ready what it has drawn."""
PERIOD = 25
"""Ticks between two exposures, at least: 20 Hz."""
PATIENCE = 250
"""Ticks for which a drawing is waited for: half a second. A renderer that takes longer, or does not
say when it has drawn, is shown a state every `PERIOD`."""


class Shutter:
    """Says at which ticks the state is exposed.

    One thread asks, another may say what was drawn.

    Args:
        waits: Whether it waits for the renderer (free-run).
    """

    def __init__(self, waits: bool) -> None:
        self._waits = waits
        self._exposed = 0
        self._drawn: int | None = None

    def drawn(self, tick: int) -> None:
        """The renderer has drawn the state of a tick."""
        self._drawn = tick

    def opens(self, tick: int) -> bool:
        """Whether the state of this tick is exposed; asked at every tick, once or again."""
        if not self._waits:
            return tick % PERIOD == 0
        since = tick - self._exposed
        if since < PERIOD or (self._draws() and since < PATIENCE):
            return False
        if self._draws():
            self._drawn = None  # nobody there: it is waited for again when it speaks again
        self._exposed = tick
        return True

    def _draws(self) -> bool:
        """Whether a renderer that has spoken before still draws the last exposure."""
        return self._drawn is not None and self._drawn < self._exposed
