"""Every tuned constant of the core says what it is; tools/tuned_constants.py lists them."""

from pathlib import Path

import tuned_constants
from tuned_constants import Constant


def test_every_constant_says_what_it_is() -> None:
    found = list(tuned_constants.constants())
    assert len(found) > 100, "the search for constants finds none any more"
    silent = [each for each in found if len(each.meaning.split()) < 2]
    assert silent == [], "write unit and meaning behind it: // [s] until it rests"
    assert len(tuned_constants.table().splitlines()) == len(found) + 2


def test_unit_and_meaning_are_the_comment(tmp_path: Path) -> None:
    folder = tmp_path / "src"
    folder.mkdir()
    (folder / "a.cpp").write_text(
        "constexpr double kOne = 0.5;  // [m/s] of the tip\n"
        "  static constexpr int kTwo =\n      4;  ///< samples that\n"
        "                                      ///< count\n"
        "  /// Of something else.\n"
        "constexpr int kThree = 3;\nconstexpr int kDof = 4;\n"
    )
    assert list(tuned_constants.constants(tmp_path)) == [
        Constant("a.cpp", "kOne", "0.5", "m/s", "of the tip"),
        Constant("a.cpp", "kTwo", "4", "", "samples that count"),
        Constant("a.cpp", "kThree", "3", "", ""),
    ]
