"""The first seconds of bowel grasping and retraction: tissue, assistant, both senders."""

from __future__ import annotations

from surg_sim.tasks.bgr import bgr_task


class ShortBgr(bgr_task.Bgr):
    """As bgr, but nobody has the time."""

    name = "short_bgr"
    title = "The first seconds of bowel grasping and retraction"
    time_limit = 3.5
