"""The first seconds of thread in hole: the thread swings, and its end comes to the hole."""

from __future__ import annotations

from surg_sim.tasks.thread_in_hole import thread_in_hole_task


class ShortThread(thread_in_hole_task.ThreadInHole):
    """As thread_in_hole, but nobody has the time."""

    name = "short_thread"
    title = "The first seconds of thread in hole"
    time_limit = 3.5
