"""The environment variable that turns transport optimisations off."""

from __future__ import annotations

import pytest

from surg_ros.transport import switches


@pytest.mark.parametrize(
    ("value", "off"),
    [
        ("", set()),
        ("direct_publisher", {"direct_publisher"}),
        ("direct_publisher, polled_subscriber", {"direct_publisher", "polled_subscriber"}),
        ("all", set(switches.NAMES)),
    ],
)
def test_only_what_is_named_is_off(
    value: str, off: set[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(switches.VARIABLE, value)
    assert {name for name in switches.NAMES if switches.plain(name)} == off


def test_an_unknown_name_is_an_error_that_lists_what_is_allowed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv(switches.VARIABLE, "direct_publishers")
    with pytest.raises(ValueError, match="direct_publishers") as caught:
        switches.plain("direct_publisher")
    assert all(name in str(caught.value) for name in switches.NAMES)
