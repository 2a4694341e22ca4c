"""Which library speaks with which robot: a wrong pair is refused with its cure."""

from __future__ import annotations

import re

_VERSIONS = re.compile(
    r"(?:server version: |robot speaks protocol version )(\d+)"
    r".*(?:library version: |libfranka that speaks version )(\d+)",
    re.DOTALL,
)
"""As libfranka says it, and as panda-python does."""
_OTHERS = {"fr3": ("a Panda", "panda"), "panda": ("an FR3", "fr3")}
LAST_OF_PANDA = 5
"""Version of the research interface; later ones belong to the FR3."""


def refusal(said: str, model: str) -> str:
    """Why a robot cannot be driven by the library of a model, from what the library said.

    Args:
        said: Text of the library's exception.
        model: ``fr3`` or ``panda``.

    Returns:
        A sentence with the cure; empty: the library said something else.
    """
    what, link = _OTHERS[model]
    found = _VERSIONS.search(said)
    other = "object size" in said  # an answer of another length
    if found is not None:
        is_panda = int(found[1]) <= LAST_OF_PANDA
        other = is_panda != (model == "panda")
    if not other and found is None and "ncompatible" not in said:
        return ""
    text = f"link: {said.strip()}: the robot's research interface is unlike the library's; "
    if other:
        return text + f"this is probably {what}: write link: {link}, with the robot's YAML"
    return text + "update the robot's system, or change the library in franka/packages.lock"
