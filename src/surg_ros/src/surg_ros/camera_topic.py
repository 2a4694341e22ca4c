"""Names of cameras and their topics. No ROS."""

from __future__ import annotations


def camera_topic(given: str) -> tuple[str, str]:
    """Name and topic of a camera, from ``endoscope_left`` or ``/endoscope/left/image_raw``."""
    if given.startswith("/"):
        short = given.removesuffix("/compressed").removesuffix("/image_raw")
        return short.strip("/").replace("/", "_"), given
    head, _, tail = given.rpartition("_")
    return given, f"/{head}/{tail}/image_raw" if head else f"/{given}/image_raw"
