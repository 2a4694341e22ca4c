"""Selects the ticks whose state is sent to the renderer.

Lock-step: every 25th tick, so that the pictures of a run do not depend on the renderer. Free-run:
at most 20 times a second, and only when the renderer is ready. A state that waits in a queue would
become an old picture.
"""

from __future__ import annotations

from surg_core.contract import GRID

RENDERER = "endoscope"
"""Participant that reports rendered ticks on /sim/ready."""
RENDER_TIMEOUT = 250
"""Ticks to wait for a renderer: 0.5 s. After that, or if it never reports, it gets one state every
``GRID``."""


class ExposureSchedule:
    """Decides in each tick whether its state is exposed.

    One thread may ask while another reports rendered ticks. In free-run it waits for the renderer.
    """

    def __init__(self, wait_for_renderer: bool) -> None:
        self._wait_for_renderer = wait_for_renderer
        self._exposed = 0
        self._rendered: int | None = None

    def rendered(self, tick: int) -> None:
        """Report that the state of a tick has been rendered."""
        self._rendered = tick

    def due(self, tick: int) -> bool:
        """Whether the state of this tick is exposed. Call it in every tick; repeats are allowed."""
        if not self._wait_for_renderer:
            return tick % GRID == 0
        since = tick - self._exposed
        if since < GRID or (self._rendering() and since < RENDER_TIMEOUT):
            return False
        if self._rendering():
            self._rendered = None  # presumed dead; waited for again after its next report
        self._exposed = tick
        return True

    def _rendering(self) -> bool:
        """Whether a renderer that has reported before is still busy with the last exposure."""
        return self._rendered is not None and self._rendered < self._exposed
