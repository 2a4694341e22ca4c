"""docs/reference/dependencies.md gives a reason for every package that the set-up installs."""

import re

from surg_cli.host import paths, provision

PAGE = paths.ROOT / "docs/reference/dependencies.md"


def test_every_package_has_a_reason_on_the_page() -> None:
    rows = [line.split("|")[1] for line in PAGE.read_text("utf-8").splitlines() if "|" in line]
    listed = {name for row in rows for name in re.findall(r"`([\w.+-]+)`", row)}
    locks = "".join(file.read_text("utf-8") for file in (paths.LOCK_FILE, paths.DDS_LOCK))
    locked = re.findall(r"^([\w-]+)==", locks, re.MULTILINE)
    needed = {*provision.listed_packages(optional=provision.OPTIONAL), *locked}
    assert sorted(needed - listed) == [], "no reason on the page"
    assert sorted(listed - needed) == [], "on the page, but not installed"
