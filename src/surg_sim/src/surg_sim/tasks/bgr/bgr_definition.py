"""Every number and name that defines bowel grasping and retraction (docs/reference/tasks.md)."""

from __future__ import annotations

ROBOT, ASSISTANT = "PSM1", "assistant"
"""Names of the two instruments."""

TARGETS = (17, 22)
"""First and last bowel node that an episode may choose as its target."""
LEAST_APART = 3
"""Smallest number of nodes between the two holds; closer holds expose no tissue."""

POINT_AT = 0.022
"""Largest distance of the assistant's tip from the target on the bowel axis while it points [m]."""
POINT_FOR = 0.3
"""Time for which the assistant must point [s]."""
RIGHT = 1
"""Largest number of nodes between the target and the node that the robot holds."""
TAUT = 0.5
"""Smallest elastic tension in every segment between the two holds [N]."""
STILL_SPEED = 0.005
"""Largest speed of either tip, averaged over 50 ms, that counts as still [m/s]."""
STILL_FOR = 2.0
"""Time for which the tissue must be taut and visible and both instruments still [s]."""

PHASES = ("point", "grasp", "assist", "retract", "still", "done")
"""Phases of an episode in their order."""
INSTRUCTION = "Grasp the bowel where the assistant points, and retract it together."
STAGES = {
    "point": "Wait until the assistant points at the bowel.",
    "grasp": "Grasp the bowel where the assistant points.",
    "assist": "Hold the bowel still while the assistant grasps it beside you.",
    "retract": "Retract the bowel together with the assistant until it is taut and visible.",
    "still": "Hold the taut bowel still.",
}
"""Sentences for datasets and policies; a phase's is said to the robot."""
NOBODY = -1.0
"""Value of a node number in the task state while nothing is held."""
