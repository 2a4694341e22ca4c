"""Calls to the ROS master that give up when it does not answer."""

from __future__ import annotations

import hashlib
import json
import xmlrpc.client
from typing import Any

import rosgraph
import rospy

TIMEOUT_S = 2.0
LONG_PARAMETER = 2000

ERRORS = (OSError, xmlrpc.client.Error, ValueError, TypeError)
"""What a call raises when the master does not answer, or wrongly."""


class _TimeoutTransport(xmlrpc.client.Transport):
    def make_connection(self, host: Any) -> Any:
        connection = super().make_connection(host)
        connection.timeout = TIMEOUT_S
        return connection


def _master() -> Any:
    return xmlrpc.client.ServerProxy(rosgraph.get_master_uri(), transport=_TimeoutTransport())


def published_topics() -> dict[str, str]:
    """Type by topic of everything that is published; raises one of ``ERRORS``."""
    return dict(_master().getPublishedTopics(rospy.get_name(), "")[2])


def parameters() -> dict[str, Any] | None:
    """Every parameter of the system by name; None if the master does not answer."""
    try:
        tree = _master().getParam(rospy.get_name(), "/")[2]
    except ERRORS:
        return None
    content = _shortened(tree)
    return content if isinstance(content, dict) else None


def _shortened(value: Any) -> Any:
    if isinstance(value, dict):
        return {str(key): _shortened(item) for key, item in value.items()}
    text = value if isinstance(value, str) else json.dumps(value, default=str)
    if len(text) <= LONG_PARAMETER:
        return value
    return f"sha256:{hashlib.sha256(text.encode('utf-8', 'replace')).hexdigest()}"
