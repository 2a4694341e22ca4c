"""Motion files: what is read, what is refused and in which words."""

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from surg_teleop.playback.motion_file import JUMP_SPEED, MotionError, read_motion


def table(n: int = 50, **columns: object) -> dict[str, list[object]]:
    """A small good motion: a slow circle."""
    t = np.arange(n) * 0.02
    data: dict[str, list[object]] = {
        "t_s": list(t),
        "x_m": list(0.02 * np.cos(t)),
        "y_m": list(0.02 * np.sin(t)),
        "z_m": list(0.01 * t),
    }
    for name, values in columns.items():
        data[name] = list(values)  # type: ignore[call-overload]
    return data


def write(path: Path, data: dict[str, list[object]]) -> Path:
    rows = zip(*data.values(), strict=True)
    lines = [",".join(data), *(",".join(str(value) for value in row) for row in rows)]
    path.write_text("\n".join(lines) + "\n")
    return path


def rotation_columns(rotations: np.ndarray) -> dict[str, list[object]]:
    return {f"r{i + 1}{j + 1}": list(rotations[:, i, j]) for i in range(3) for j in range(3)}


def test_a_good_file_is_read(tmp_path: Path) -> None:
    data = table(gripper_rad=np.linspace(0, 0.4, 50), roll_rad=np.linspace(1, 2, 50), note=[7] * 50)
    motion = read_motion(write(tmp_path / "m.csv", data))
    assert motion.duration == pytest.approx(0.98)
    assert motion.p.shape == (50, 3)
    assert motion.roll[0] == 0.0
    assert motion.roll[-1] == pytest.approx(1.0)
    assert motion.gripper_at(0.98) == pytest.approx(0.4)
    assert motion.ignored == ("note",)
    assert motion.lines[0] == 2


def test_windows_and_excel_habits_are_understood(tmp_path: Path) -> None:
    text = write(tmp_path / "m.csv", table()).read_text()
    spaced = text.replace("t_s,x_m", " t_s , x_m ").replace("\n", "\r\n") + "\r\n"
    (tmp_path / "w.csv").write_bytes(b"\xef\xbb\xbf" + spaced.encode())
    assert len(read_motion(tmp_path / "w.csv").t) == 50


def spoil(column: str, row: int, value: object) -> dict[str, list[object]]:
    data = table()
    data[column][row] = value
    return data


def without(column: str) -> dict[str, list[object]]:
    data = table()
    del data[column]
    return data


REFUSED: dict[str, tuple[dict[str, list[object]], list[str]]] = {
    "missing column": (
        without("y_m"),
        ["line 1", "column y_m missing", "allowed: t_s,x_m,y_m,z_m"],
    ),
    "NaN": (spoil("x_m", 10, "nan"), [":12: x_m", "'nan' is not a finite number"]),
    "infinity": (spoil("t_s", 49, "inf"), [":51: t_s", "'inf' is not a finite number"]),
    "no number": (spoil("z_m", 3, "three"), [":5: z_m", "'three' is not a finite number"]),
    "empty cell": (spoil("z_m", 3, ""), [":5: z_m", "'' is not a finite number"]),
    "time backwards": (spoil("t_s", 20, 0.1), ["line 22", "t_s is 0.100000", "increasing times"]),
    "time stands": (spoil("t_s", 20, 0.38), ["line 22", "increasing times"]),
    "a gap in time": (
        {**table(), "t_s": [0.02 * i + (0.6 if i > 9 else 0) for i in range(50)]},
        ["line 12", "0.620 s after", "allowed: 0.5 s"],
    ),
    "a jump": (
        spoil("x_m", 30, 0.09),
        ["line 32", "jumps by", "mm in 0.0200 s", "allowed: 22.0 mm"],
    ),
    "a roll jump": (
        table(roll_rad=[0.0] * 25 + [1.0] * 25),
        ["line 27", "roll jumps by 1.000 rad", "allowed: 0.500 rad"],
    ),
    "one column twice": (
        {**table(), " x_m": table()["x_m"]},
        [":1: column x_m is there twice"],
    ),
    "half a rotation": (table(r11=[1.0] * 50), ["line 1", "column r12, r13", "all of r11 to r33"]),
    "two rolls": (
        table(roll_rad=[0.0] * 50, **rotation_columns(np.tile(np.eye(3), (50, 1, 1)))),
        ["line 1", "both roll_rad and r11 to r33"],
    ),
    "no rotation": (
        table(**rotation_columns(np.tile(np.eye(3) * 1.1, (50, 1, 1)))),
        ["line 2", "not a rotation"],
    ),
    "a mirror": (
        table(**rotation_columns(np.tile(np.diag([1.0, 1.0, -1.0]), (50, 1, 1)))),
        ["line 2", "not a rotation", "determinant -1"],
    ),
    "a handle that turns round": (
        table(
            **rotation_columns(
                Rotation.from_rotvec(np.outer(np.linspace(0, np.pi, 50), [1, 0, 0])).as_matrix()
            )
        ),
        ["line 51", "its roll is undefined"],
    ),
    "too few samples": (table(3), ["3 samples", "at least 4"]),
    "too short": (table(10), ["lasts 0.180 s", "at least 0.5 s"]),
}


@pytest.mark.parametrize("case", REFUSED)
def test_bad_files_are_refused_with_file_line_value_and_what_is_allowed(
    case: str, tmp_path: Path
) -> None:
    data, words = REFUSED[case]
    path = write(tmp_path / "bad.csv", data)
    with pytest.raises(MotionError) as caught:
        read_motion(path)
    for word in [str(path), *words]:
        assert word in str(caught.value)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "is empty; a header and rows are needed"),
        (b"t_s,x_m,y_m,z_m\n", "0 samples"),
        (b"t_s,x_m,y_m,z_m\n0,1,2\n", ":2: 3 values; the header has 4"),
        (bytes(range(256)), "is not a text file"),
        (None, "cannot be read: No such file"),
    ],
)
def test_files_that_are_no_tables_are_refused(
    content: bytes | None, words: str, tmp_path: Path
) -> None:
    path = tmp_path / "bad.csv"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(MotionError, match=words):
        read_motion(path)


@pytest.mark.parametrize(
    ("scale", "column", "hint"),
    [(1000.0, "xyz", "looks like millimetres"), (1000.0, "t", "looks like milliseconds")],
)
def test_another_unit_is_recognised(scale: float, column: str, hint: str, tmp_path: Path) -> None:
    data = {
        name: [scale * float(value) for value in values] if name[0] in column else values  # type: ignore[arg-type]
        for name, values in table().items()
    }
    with pytest.raises(MotionError, match=hint):
        read_motion(write(tmp_path / "m.csv", data))


def test_a_glitch_in_metres_has_no_hint_of_another_unit(tmp_path: Path) -> None:
    data = table()
    data["x_m"][20] = 0.4
    with pytest.raises(MotionError) as caught:
        read_motion(write(tmp_path / "m.csv", data))
    assert "jumps" in str(caught.value)
    assert "looks like" not in str(caught.value)


def test_a_fast_but_human_motion_passes(tmp_path: Path) -> None:
    """Just below the jump's threshold; just above it is refused."""
    for factor, good in ((0.99, True), (1.2, False)):
        data = table()
        data["x_m"] = [i * 0.02 * JUMP_SPEED * factor for i in range(50)]
        data["y_m"] = data["z_m"] = [0.0] * 50
        path = write(tmp_path / "m.csv", data)
        if good:
            assert read_motion(path).box[1][0] > 0.9
        else:
            with pytest.raises(MotionError, match="jumps"):
                read_motion(path)


def test_spline_meets_the_samples_and_is_smooth(tmp_path: Path) -> None:
    motion = read_motion(write(tmp_path / "m.csv", table()))
    spline = motion.spline()
    assert np.abs(spline(motion.t)[:, :3] - motion.p).max() < 1e-15
    for order in (1, 2):  # continuous velocity and acceleration at every sample
        left, right = spline(motion.t[1:-1] - 1e-9, order), spline(motion.t[1:-1] + 1e-9, order)
        assert np.abs(left - right).max() < 1e-6
    fine = np.linspace(0.1, 0.9, 997)
    assert np.abs(spline(fine)[:, 0] - 0.02 * np.cos(fine)).max() < 1e-7


def test_roll_beyond_half_a_turn_is_unwrapped(tmp_path: Path) -> None:
    turn = np.linspace(0, 9.0, 50)
    rotations = Rotation.from_rotvec(np.outer(turn, [0, 0, 1])).as_matrix()
    by_matrix = read_motion(write(tmp_path / "a.csv", table(**rotation_columns(rotations))))
    wrapped = np.angle(np.exp(1j * turn))
    by_angle = read_motion(write(tmp_path / "b.csv", table(roll_rad=wrapped)))
    assert by_matrix.roll[-1] == pytest.approx(9.0)
    assert by_angle.roll[-1] == pytest.approx(9.0)


def test_cut_keeps_the_first_seconds(tmp_path: Path) -> None:
    motion = read_motion(write(tmp_path / "m.csv", table(gripper_rad=[0.1] * 50)))
    short = motion.cut(0.5)
    assert short.duration == pytest.approx(0.5)
    assert short.gripper is not None
    assert len(short.gripper) == len(short.lines) == 26
    assert motion.cut(99.0) is motion
