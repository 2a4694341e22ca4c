"""The page on the UR link names the oldest versions that the link accepts."""

from surg_cli.host import paths
from surg_hardware.ur.orders import OLDEST, OLDEST_X

PAGE = (paths.ROOT / "docs" / "guide" / "link_ur.md").read_text("utf-8")


def test_the_oldest_versions_are_on_its_page() -> None:
    assert "PolyScope " + ".".join(map(str, OLDEST)) in PAGE
    assert "PolyScope X " + ".".join(map(str, OLDEST_X)) in PAGE
