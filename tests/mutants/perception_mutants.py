"""Hand-written mutants of the endoscope's calibration.

As in `mutants`, but the files are below `src/surg_perception/src/surg_perception`, and `first`
names test files of `tests/unit/perception`.
"""

from __future__ import annotations

from mutants.mutants import Mutant, one

BOARD, LENS, CHAIN = ("test_board",), ("test_lens_model",), ("test_calibration_chain",)
LIMITS, VIEWS, EYE = ("test_evidence_limits",), ("test_views",), ("test_one_eye",)
MUTANTS: tuple[Mutant, ...] = (
    # -- pictures
    one(
        "half_a_pixel_of_the_aruco_module",
        "the principal point of every lens is half a pixel off",
        "calibration/board.py",
        "        return np.asarray(refined, dtype=np.float64)",
        "        return np.asarray(refined, dtype=np.float64) + EDGE_TO_CENTRE",
        BOARD,
    ),
    one(
        "board_with_y_down",
        "the board's frame is mirrored; hand-eye poses look out of its back",
        "calibration/board.py",
        "self.square * (self.rows - 1 - row)",
        "self.square * (row + 1)",
        BOARD,
    ),
    one(
        "swapped_eyes",
        "the baseline points the wrong way; depth is negative",
        "calibration/views.py",
        'EYES = ("left", "right")',
        'EYES = ("right", "left")',
        ("test_views", "test_stereo_rendered"),
    ),
    # -- lenses
    one(
        "barrel_sign",
        "a barrel lens is undistorted into a stronger barrel",
        "calibration/lens_model.py",
        "    above = 1.0 + powers @ [k1, k2, k3]",
        "    above = 1.0 - powers @ [k1, k2, k3]",
        LENS,
    ),
    one(
        "undistort_skipped",
        "points near the picture's rim are millimetres off",
        "calibration/lens_model.py",
        "        xy = bent.copy()\n        for _ in range(20):",
        "        xy = bent.copy()\n        for _ in range(0):",
        LENS,
    ),
    one(
        "simplest_model_whatever_it_costs",
        "a fisheye is taken for a barrel lens",
        "calibration/intrinsics.py",
        "GOOD_ENOUGH = 1.05",
        "GOOD_ENOUGH = 1e9",
        LENS,
    ),
    # -- solvers and their evidence
    one(
        "covariance_over_corners",
        "stated errors are ten times too small, and everything is accepted",
        "calibration/adjustment.py",
        "        return jackknife(self.without())",
        "        return self.covariance_of_corners",
        CHAIN,
    ),
    one(
        "transposed_hand_eye",
        "the camera looks along the inverse rotation",
        "calibration/handeye.py",
        '        """The result."""\n        return self.fit.solution.X_FV',
        '        """The result."""\n        return inverse_pose(self.fit.solution.X_FV)',
        CHAIN,
    ),
    one(
        "inverse_of_the_base",
        "the second arm stands where the first one sees it from",
        "calibration/base_steps.py",
        "        X = surg_core.inverse_pose(X)\n",
        "",
        CHAIN,
    ),
    one(
        "base_without_the_cameras_error",
        "a base through a bad camera is stated as good as its touches",
        "calibration/bases.py",
        "    covariance = jackknife(np.array(steps)) + by_handeye\n",
        "    covariance = jackknife(np.array(steps))\n",
        ("test_seen_base",),
    ),
    one(
        "wrong_lens_not_asked_for",
        "a hand-eye pose through a wrong focal length is written",
        "calibration/evidence.py",
        "LARGEST_MISFIT, MISFIT_SIGMAS = 0.0025, 4.0",
        "LARGEST_MISFIT, MISFIT_SIGMAS = 0.25, 4.0",
        LIMITS,
    ),
    one(
        "limits_in_mm",
        "a base that is 0.2 m off is accepted",
        "calibration/evidence.py",
        "0.0005 / 2.5",
        "0.5 / 2.5",
        LIMITS,
    ),
    one(
        "board_in_mm",
        "every distance is a thousand times too large",
        "calibration/board.py",
        "    return square * measured_mm / 100.0",
        "    return square * measured_mm",
        BOARD,
    ),
    # -- files
    one(
        "stale_lens_ignored",
        "a camera measured through another focus is believed",
        "calibration/base_steps.py",
        "    check_camera_lenses(camera, file, folder / LEFT, folder / RIGHT)\n",
        "",
        CHAIN,
    ),
    one(
        "hash_of_one_lens_only",
        "a camera of two eyes is taken for one of a single eye",
        "calibration/result_files.py",
        "    eyes = [folder / name for name in (LEFT, RIGHT)]",
        "    eyes = [folder / name for name in (LEFT,)]",
        CHAIN,
    ),
    one(
        "one_eye_replaces_two",
        "the left lens changes, and the right one stays as it was",
        "calibration/result_files.py",
        "    for name in (RIGHT, STEREO):\n        if (folder / name).exists():",
        "    for name in (RIGHT, STEREO):\n        if (folder / name).is_symlink():",
        EYE,
    ),
)
