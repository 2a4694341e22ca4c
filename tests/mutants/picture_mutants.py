"""Hand-written mutants of the projection into pictures.

As in `mutants`, but the files are below `src/surg_core/python/surg_core`, and `first` names test
files of `tests/unit/pictures` or `perception`.
"""

from __future__ import annotations

from mutants.mutants import Mutant, one

LENS, PLAN = ("test_lens_model",), ("test_plan_projection",)
MUTANTS: tuple[Mutant, ...] = (
    one(
        "barrel_sign",
        "a barrel lens is undistorted into a stronger barrel",
        "pictures/lens_model.py",
        "    above = 1.0 + powers @ [k1, k2, k3]",
        "    above = 1.0 - powers @ [k1, k2, k3]",
        LENS,
    ),
    one(
        "undistort_skipped",
        "points near the picture's rim are millimetres off",
        "pictures/lens_model.py",
        "        xy = bent.copy()\n        for _ in range(20):",
        "        xy = bent.copy()\n        for _ in range(0):",
        LENS,
    ),
    one(
        "plan_seen_from_the_world",
        "the plan is drawn as if the endoscope's pose were its inverse",
        "pictures/plan_projection.py",
        "X_VR = inverse_pose(X_WV) @ X_WR",
        "X_VR = X_WV @ X_WR",
        PLAN,
    ),
    one(
        "plan_on_the_other_side",
        "the plan is drawn on the other side of the trocar",
        "pictures/plan_projection.py",
        "X_BR[:3, 3] = p_BRcm",
        "X_BR[:3, 3] = -np.asarray(p_BRcm)",
        PLAN,
    ),
)
