"""Hand-written mutants of the endoscope's calibration, depth and marks.

As in `mutants`, but the files are below `src/surg_perception/src/surg_perception`, and `first`
names test files of `tests/unit/perception`, `collecting` or `depth`.
"""

from __future__ import annotations

from mutants.mutants import Mutant, one

BOARD, LENS, CHAIN = ("test_board",), ("test_lens_model",), ("test_calibration_chain",)
DEPTH, MARKS, EYES = ("test_stereo_depth",), ("test_marks",), ("test_stereo_parts",)
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
        "hand_eye_without_the_lenses",
        "with exact joints the true error is far beyond the stated one",
        "calibration/handeye.py",
        "return self.of_views if self.lens_share is None else self.of_views + self.lens_share",
        "return self.of_views",
        CHAIN,
    ),
    one(
        "lenses_covariance_of_other_lenses",
        "a hand-eye pose is stated by how well another lens was known",
        "calibration/lens_covariance.py",
        "    check_measured_with(\n        path,",
        "    (lambda *_: None)(\n        path,",
        CHAIN,
    ),
    one(
        "any_corner_is_the_one_asked_for",
        "a base through swapped corners",
        "collecting/base_views.py",
        "        if off <= WRONG_CORNER:",
        "        if True:",
        ("test_base_views",),
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
        "base_by_tip_without_its_strain",
        "a turn by tip is stated as if every place of the tip erred by itself",
        "calibration/bases.py",
        "    if smooth:\n",
        "    if False:\n",
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
        "calibration/chain_steps.py",
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
    # -- depth and marks
    one(
        "points_of_half_the_step",
        "points of every 4th pixel lie four times too near the axis",
        "depth/rectification.py",
        "np.arange(0, depth.shape[1], step, dtype=np.float32)",
        "np.arange(0, len(z[0]), dtype=np.float32)",
        DEPTH,
    ),
    one(
        "vertical_focal_length_ignored",
        "points of pixels that are not square lie too high",
        "depth/rectification.py",
        "- np.float32(self.cy)) / self.fy",
        "- np.float32(self.cy)) / self.f * 1.1",
        DEPTH,
    ),
    one(
        "right_eye_undistorted_as_the_left",
        "rows of both eyes disagree, and depth is wrong",
        "depth/rectification.py",
        "_maps(right, P_right[:, :3], size)",
        "_maps(left, P_right[:, :3], size)",
        DEPTH,
    ),
    one(
        "fisheye_as_a_barrel",
        "a fisheye's pictures are bent, not straightened",
        "depth/rectification.py",
        'if lens.distortion_model == "equidistant":',
        'if lens.distortion_model == "fisheye":',
        DEPTH,
    ),
    one(
        "depth_beyond_its_range",
        "what the matcher guesses outside its range passes for depth",
        "depth/stereo_depth.py",
        "        depth[(depth < self.near) | (depth > self.far)] = np.nan\n",
        "",
        DEPTH,
    ),
    one(
        "marks_in_the_left_eye_only",
        "the right eye's marks are the left eye's",
        "marks/mark_projection.py",
        "self.eyes.append(EyeProjection(lenses[1], held.X_LR))",
        "self.eyes.append(EyeProjection(lenses[1], np.eye(4)))",
        MARKS,
    ),
    one(
        "one_sigma_for_two",
        "the ellipse round the tip is half as large as it is said to be",
        "marks/mark_projection.py",
        "two_sigma = 2.0 *",
        "two_sigma = 1.0 *",
        MARKS,
    ),
    one(
        "marks_of_a_silent_arm",
        "marks of an arm that fell silent stay where it was",
        "stereo/joint_history.py",
        "MOST_GAP_NS = 100_000_000",
        "MOST_GAP_NS = 100_000_000_000",
        EYES,
    ),
    one(
        "message_with_eyes_swapped",
        "the page draws the left eye's marks over the right eye",
        "stereo/live_marks_node.py",
        "for eye, marks in zip(EYES, found",
        "for eye, marks in zip(EYES[::-1], found",
        EYES,
    ),
    one(
        "a_pair_of_two_times",
        "depth of a left and a right picture of different moments",
        "stereo/newest_pair_node.py",
        " and len(stamps) == 1:",
        ":",
        ("test_newest_pair",),
    ),
)
