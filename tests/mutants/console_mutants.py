"""Hand-written mutants of the console: a headset's dead-man, and what is shown beside the picture.

As in `mutants`, but the files are below `src/surg_console/src/surg_console`, and `first` names test
files of `tests/unit/console`.
"""

from __future__ import annotations

from mutants.mutants import Mutant, one

DEAD_MAN, OVERLAYS = ("test_console_dead_man",), ("test_console_overlays",)
HEADSET = ("test_console_headset_input", "test_console_protocol")
MUTANTS: tuple[Mutant, ...] = (
    # -- a headset's dead-man
    one(
        "a_squeeze_that_was_never_let_go",
        "after a hold the arm goes on with a hand that is still squeezed",
        "session/dead_man.py",
        "        self._armed = sample.tracked and (self._armed or not squeezed)",
        "        self._armed = sample.tracked",
        DEAD_MAN,
    ),
    one(
        "a_lost_controller_goes_on",
        "a controller that the headset does not see moves the arm",
        "session/dead_man.py",
        "        self._armed = sample.tracked and (self._armed or not squeezed)",
        "        self._armed = self._armed or not squeezed",
        DEAD_MAN,
    ),
    one(
        "motion_before_the_clutch_is_open",
        "motion overtakes the pedal, and the arm leaps when it opens",
        "session/dead_man.py",
        "        counts = settled and not self._clutched and not sample.clutch",
        "        counts = not sample.clutch",
        DEAD_MAN,
    ),
    one(
        "clutch_inverted",
        "a squeeze stops the arm, and letting go moves it",
        "session/dead_man.py",
        "            clutch=sample.clutch or self._clutched,",
        "            clutch=sample.clutch or not self._clutched,",
        DEAD_MAN,
    ),
    # -- what a page may say
    one(
        "a_quaternion_of_any_length",
        "a handle whose turn is none turns the instrument somewhere",
        "web/page_protocol.py",
        "        if not abs(length - 1.0) <= UNIT:",
        "        if not length > UNIT:",
        HEADSET,
    ),
    one(
        "nonsense_without_end",
        "a page sends nonsense for ever",
        "web/control_socket.py",
        "                if errors >= MAX_ERRORS:",
        "                if errors >= 1000 * MAX_ERRORS:",
        HEADSET,
    ),
    # -- overlays
    one(
        "collected_without_a_page",
        "marks and joints are collected after the last page has closed its view",
        "web/overlay_socket.py",
        "                self._source.watch(what, False)",
        "                pass",
        OVERLAYS,
    ),
    one(
        "a_connection_of_a_burst_is_lost",
        "a connection of a burst is accepted and cut",
        "web/connection_cap.py",
        "        if len(others) >= MAX_OPEN:",
        "        if len(others) >= 1:",
        ("test_console_attacks",),
    ),
    one(
        "a_silent_arm_stands_in_the_room",
        "an arm whose joints are not numbers is drawn",
        "session/scene_view.py",
        "            if q is None or len(q) != each.arm.chain.dof or not np.isfinite(q).all():",
        "            if q is None or len(q) != each.arm.chain.dof:",
        OVERLAYS,
    ),
    one(
        "the_shaft_ends_at_the_flange",
        "the instrument of a robot without capsules has no length",
        "session/scene_view.py",
        "        tip = (X_WF @ [*arm.tool.p_FTip, 1.0])[:3]",
        "        tip = X_WF[:3, 3]",
        OVERLAYS,
    ),
)
