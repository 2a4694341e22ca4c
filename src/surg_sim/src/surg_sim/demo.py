"""One episode of bowel grasping and retraction without ROS: a film and a figure.

::

    python -m surg_sim.demo

The options are those of ``surg_sim.envs.task_demo``.
"""

from __future__ import annotations

import sys

from surg_sim.envs.task_demo import main

if __name__ == "__main__":
    sys.exit(main())
