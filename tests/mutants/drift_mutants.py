"""Hand-written mutants of the watch for drift, of a correction, and of who obeys it.

As in `mutants`, but `file` is below `src`, and `first` names all tests that must notice, of any
folder: a live watch and a hand that does not begin are seen in a running graph only.
"""

from __future__ import annotations

from mutants.mutants import Mutant, one

WATCH, ACCEPTED = ("test_drift",), ("test_drift_accepted",)
LIVE, STATUS = ("test_live_drift",), ("test_status_fields",)
DRIFT = "surg_perception/src/surg_perception/drift/"
NODES = "surg_perception/src/surg_perception/stereo/"
MUTANTS: tuple[Mutant, ...] = (
    # -- what is seen
    one(
        "nothing_ever_moves",
        "a bumped camera is believed for ever",
        DRIFT + "drift_evidence.py",
        "SCALES = (0.1, 0.3, 1.0)",
        "SCALES = (1e-6, 1e-6, 1e-6)",
        WATCH,
    ),
    one(
        "the_first_guess_is_the_cause",
        "a camera is corrected where a base may have moved",
        DRIFT + "drift_state.py",
        "held >= SURE",
        "held >= 0.0",
        WATCH,
    ),
    one(
        "one_judgement_is_enough",
        "what joints do not drive stops an operation",
        DRIFT + "drift_state.py",
        "SURE and verdict.confirmed",
        "SURE",
        ("test_drift_figures",),
    ),
    one(
        "what_steps_throw_away_is_explained",
        "a bump that puts every shaft behind the lens explains all",
        DRIFT + "seen_shafts.py",
        "A[thrown], r[thrown] = 0.0, THROWN",
        "A[thrown], r[thrown] = 0.0, 0.0",
        WATCH,
    ),
    one(
        "a_frozen_picture_says_something",
        "a camera that hangs looks like an instrument that is elsewhere",
        DRIFT + "drift_watch.py",
        "        if still or not moving:",
        "        if not moving:",
        WATCH,
    ),
    one(
        "camera_steps_the_wrong_way",
        "a correction doubles the error",
        DRIFT + "moving_parts.py",
        "= -_carried(shafts.p_V)",
        "= _carried(shafts.p_V)",
        ACCEPTED,
    ),
    one(
        "a_scopes_base_moves_like_a_tools",
        "a correction of the endoscope's base doubles the error",
        DRIFT + "moving_parts.py",
        "D[..., part.at] = -way if part.of == scope",
        "D[..., part.at] = way if part.of == scope",
        ACCEPTED,
    ),
    # -- a correction
    one(
        "one_of_several_is_corrected",
        "a camera is corrected although a base may have moved",
        DRIFT + "accepted_drift.py",
        "len(named) == len(names) == 1",
        "named",
        ACCEPTED,
    ),
    one(
        "a_corrected_camera_makes_bases_stale",
        "after a correction the cell does not load",
        DRIFT + "accepted_drift.py",
        "        if base.camera_sha256 == before:",
        "        if base.camera_sha256 != before:",
        ACCEPTED,
    ),
    one(
        "seconds_are_enough",
        "a correction by six seconds of motion is ten times worse than a calibration",
        DRIFT + "whole_recording.py",
        "    if short <= 1.0:",
        "    if short <= 100.0:",
        ACCEPTED,
    ),
    one(
        "one_look_is_enough",
        "after 10 degrees derivatives no longer hold",
        DRIFT + "whole_recording.py",
        "SETTLED = 2e-5",
        "SETTLED = 2.0",
        ACCEPTED,
    ),
    one(
        "another_shaft_counts",
        "a second instrument in some pictures shifts the camera",
        DRIFT + "whole_recording.py",
        "        weight = sd**-2 / less",
        "        weight = sd**-2 + 0.0 * less",
        ACCEPTED,
    ),
    one(
        "the_wrong_part_is_corrected",
        "a base is turned where the camera was bumped",
        DRIFT + "whole_recording.py",
        "    if fit.gain > np.log(1.0 / PRIOR):",
        "    if fit.gain > 1e9:",
        ACCEPTED,
    ),
    one(
        "what_does_not_fit_is_corrected",
        "a part that moved twice is put in between",
        DRIFT + "whole_recording.py",
        "    if fit.misfit > MISFIT:",
        "    if fit.misfit > 1e9:",
        ACCEPTED,
    ),
    one(
        "sightings_before_the_motion_count",
        "a correction is the mean of before and after",
        DRIFT + "drift_step.py",
        "since = min(since, state.since) if state.word == MOVED else np.inf",
        "since = min(since, state.since)",
        ACCEPTED,
    ),
    # -- the live watch
    one(
        "a_bump_is_not_refused",
        "a hand follows in a picture that is turned",
        NODES + "live_drift_node.py",
        "        if state.far and not self.refusal:",
        "        if False:",
        LIVE,
    ),
    one(
        "no_stamp_is_no_matter",
        "pictures of no known time are compared with joints of any",
        NODES + "live_drift_node.py",
        "        if not stamp_ns:\n",
        "        if False:\n",
        LIVE,
    ),
    one(
        "a_silent_eye_is_steady",
        "the last word stands although an eye has failed",
        NODES + "live_drift_node.py",
        "        if time.monotonic() - self._looked > SILENT_S:",
        "        if False:",
        LIVE,
    ),
    one(
        "marks_beside_their_place",
        "marks are drawn where no instrument is",
        NODES + "stereo_depth_node.py",
        "                self._marks.withheld = self._drift.refusal",
        '                self._marks.withheld = ""',
        LIVE,
    ),
    # -- who obeys
    one(
        "a_hand_begins_in_a_moved_view",
        "right is no longer right, and the arm follows",
        "surg_teleop/src/surg_teleop/follow/interlocks.py",
        "    if camera.moved:",
        "    if False:",
        ("test_teleop_core",),
    ),
    one(
        "a_hand_does_not_hear_the_watch",
        "right is no longer right, and the arm follows",
        "surg_teleop/src/surg_teleop/follow/teleop_node.py",
        "                self._moved = message.refusal",
        "                pass",
        STATUS,
    ),
    one(
        "a_policy_goes_on_in_a_moved_view",
        "a policy grasps beside the tissue",
        "surg_policy_bridge/src/surg_policy_bridge/server/operator_first.py",
        "        return StopReason.CAMERA_MOVED, moved",
        "        return MAY",
        STATUS,
    ),
    one(
        "a_policy_does_not_hear_the_watch",
        "a policy grasps beside the tissue",
        "surg_policy_bridge/src/surg_policy_bridge/nodes/server_io_node.py",
        "                self._moved = message.refusal",
        "                pass",
        STATUS,
    ),
    one(
        "a_recording_does_not_say_it",
        "a policy is trained on pictures of a bumped camera",
        "surg_recording/src/surg_recording/nodes/recorder_topics_node.py",
        "            self._state.drift = {",
        "            _ = {",
        STATUS,
    ),
    one(
        "a_manifest_does_not_say_it",
        "a policy is trained on pictures of a bumped camera",
        "surg_recording/src/surg_recording/nodes/recording_switch_node.py",
        '            **({"drift": state.drift} if state.drift else {}),\n',
        "",
        ("test_recorder_topics",),
    ),
)
