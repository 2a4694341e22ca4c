"""Hand-written mutants of the console's pages: which eye a pixel belongs to, where a hand goes.

As in `mutants`, but the files are below `src/surg_console/src/surg_console/web/page`, and
`first` names test files of `tests/e2e`.
"""

from __future__ import annotations

from mutants.mutants import Edit, Mutant, one

MONITOR, HEADSET, CONSOLE = ("test_monitor_page",), ("test_headset_page",), ("test_console_touch",)
MUTANTS: tuple[Mutant, ...] = (
    # -- /monitor: each eye its pixels
    one(
        "rows_of_the_other_eye",
        "on a monitor of rows each eye sees the other's picture: depth is inside out",
        "eyes.js",
        "rows: (x, y) => y % 2 === 0",
        "rows: (x, y) => y % 2 === 1",
        MONITOR,
    ),
    one(
        "columns_of_the_other_eye",
        "on a monitor of columns depth is inside out",
        "eyes.js",
        "columns: (x) => x % 2 === 0",
        "columns: (x) => x % 2 === 1",
        MONITOR,
    ),
    one(
        "checkers_are_rows",
        "a checkerboard monitor shows each eye half of both pictures",
        "eyes.js",
        "checker: (x, y) => (x + y) % 2 === 0",
        "checker: (x, y) => y % 2 === 0",
        MONITOR,
    ),
    one(
        "the_first_eye_below",
        "on a top-and-bottom monitor depth is inside out",
        "eyes.js",
        "top_bottom: [[0, 0, 1, 0.5], [0, 0.5, 1, 0.5]]",
        "top_bottom: [[0, 0.5, 1, 0.5], [0, 0, 1, 0.5]]",
        MONITOR,
    ),
    Mutant(
        "red_for_the_right_eye",
        "red and cyan glasses show depth inside out",
        (
            Edit("eyes.js", 'tint(this.context, "#f00")', 'tint(this.context, "#0ff")'),
            Edit("eyes.js", 'tint(other.context, "#0ff")', 'tint(other.context, "#f00")'),
        ),
        MONITOR,
    ),
    one(
        "swap_does_nothing",
        "a monitor whose eyes are the other way round cannot be served",
        "eyes.js",
        "swap ? [1, 0] : [0, 1]",
        "swap ? [0, 1] : [0, 1]",
        MONITOR,
    ),
    one(
        "the_scene_comes_nearer",
        "the slider that pushes the scene back pulls it before the screen",
        "eyes.js",
        "(which === 0) === shift > 0",
        "(which === 1) === shift > 0",
        MONITOR,
    ),
    # -- /headset: each eye its picture
    one(
        "eyes_of_the_headset_swapped",
        "in the headset depth is inside out",
        "headset_view.js",
        "[right ? 0.5 : 0, 0.5]",
        "[right ? 0 : 0.5, 0.5]",
        HEADSET,
    ),
    one(
        "the_scene_before_the_screen",
        "in the headset the scene is pulled towards the viewer",
        "headset_view.js",
        "((right ? -1 : 1) * this.shift)",
        "((right ? 1 : -1) * this.shift)",
        HEADSET,
    ),
    # -- /headset: axes of the screen
    one(
        "up_is_down",
        "the hand goes up and the tip down",
        "headset_hand.js",
        "return { p: [x, -y, -z]",
        "return { p: [x, y, -z]",
        HEADSET,
    ),
    one(
        "away_is_near",
        "the hand goes away and the tip comes nearer",
        "headset_hand.js",
        "return { p: [x, -y, -z]",
        "return { p: [x, -y, z]",
        HEADSET,
    ),
    one(
        "the_wrist_turns_back",
        "the instrument turns against the wrist",
        "headset_hand.js",
        "q: [qx, -qy, -qz, qw]",
        "q: [-qx, qy, qz, qw]",
        HEADSET,
    ),
    one(
        "axes_of_the_room",
        "an operator who looks sideways moves the tip sideways",
        "headset_hand.js",
        "const back = inverse(screen.q);",
        "const back = [0, 0, 0, 1];",
        HEADSET,
    ),
    one(
        "the_other_hand",
        "the right hand moves the endoscope",
        "headset_hand.js",
        "const camera = holds(left);",
        "const camera = holds(right);",
        HEADSET,
    ),
    one(
        "the_trigger_opens",
        "the jaws open when the trigger is pulled",
        "headset_hand.js",
        "1 - Math.min(1, pull)",
        "Math.min(1, pull)",
        HEADSET,
    ),
    one(
        "always_tracked",
        "a controller that the headset does not see moves the arm",
        "headset_hand.js",
        "tracked: pose !== null && !gone,",
        "tracked: true,",
        HEADSET,
    ),
    one(
        "vibrates_after_it_was_let_go",
        "the hand feels the tip although it does not move it",
        "headset.js",
        "mine() && surgHeadset.sent?.squeeze && ",
        "mine() && ",
        HEADSET,
    ),
    # -- /: axes of the picture
    one(
        "fingers_pull",
        "two fingers that go up pull the tip back",
        "hand.js",
        "this.goal.z -= ((after[1]",
        "this.goal.z += ((after[1]",
        CONSOLE,
    ),
    one(
        "fingers_turn_back",
        "the instrument turns against two fingers",
        "hand.js",
        "Math.atan2(Math.sin(turn)",
        "Math.atan2(-Math.sin(turn)",
        CONSOLE,
    ),
    one(
        "a_finger_down_is_up",
        "the finger goes down and the tip up",
        "hand.js",
        "this.goal.y += (after[1]",
        "this.goal.y -= (after[1]",
        CONSOLE,
    ),
    one(
        "the_key_away_is_near",
        "the key that moves away pulls the tip back",
        "hand.js",
        'KeyR: ["z", 1]',
        'KeyR: ["z", -1]',
        CONSOLE,
    ),
)
