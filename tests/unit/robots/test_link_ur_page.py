"""The page on the UR link names every sentence that the link can say of a UR."""

from surg_cli.host import paths
from surg_hardware import conditions
from surg_hardware.ur.orders import OLDEST, OLDEST_X

PAGE = (paths.ROOT / "docs" / "guide" / "link_ur.md").read_text("utf-8")


def test_every_sentence_of_a_ur_is_on_its_page() -> None:
    readings = {
        conditions.ur_reading(mode, safety, limiter, guided, slider, paused)
        for mode in range(-1, 9)
        for safety in range(1, 14)
        for limiter in (0.5, 1.0)
        for slider in (0.5, 1.0)
        for paused in (False, True)
        for guided in (False, True)
    }
    readings |= {conditions.OFFLINE, conditions.NOT_NUMBERS, conditions.READY}
    wrong = [r for r in readings if r.condition is not conditions.Condition.READY]
    sentences = {r.sentence for r in (*wrong, conditions.READY)}
    print(f"{len(sentences)} sentences")
    assert len(sentences) > 20
    assert [each for each in sorted(sentences) if each not in PAGE] == []


def test_the_oldest_versions_are_on_its_page() -> None:
    assert "PolyScope " + ".".join(map(str, OLDEST)) in PAGE
    assert "PolyScope X " + ".".join(map(str, OLDEST_X)) in PAGE
