"""The in-tree CRTK definitions are the public ones: ROS 1 compares type name and md5 sum."""

import genmsg
import pytest
from genmsg import gentools

from surg_cli.host import paths

MESSAGES = {
    "CartesianImpedance": "59675c5b57c990d0b76f7f0c9954d4f3",
    "CartesianImpedanceHalfPlaneGains": "b8790a9e2c72de6fc930123c128d3b77",
    "CartesianServo": "6a249c3960a5b413513e5f1e23a82d6d",
    "CartesianState": "3913bf7ef8bcc8fa7a8eb33a46f273db",
    "JointServo": "660a5227424e1ddeb4a13710d9166974",
    "OperatingState": "b1bd4021639d9d9c5fbfff78d6ff3158",
    "SetpointMode": "45488f3061f396e81b1a70a7e6acdfa4",
    "StringStamped": "5e3e46086181199270f1ac3a28a5977f",
}
SERVICES = {
    "QueryForwardKinematics": "787c6da7a75e9886573c4af11f1a381f",
    "QueryInverseKinematics": "ce8dbc3b4384e2f7567488e7e75496d8",
    "TriggerOperatingState": "d941a2d049e2c9ac5773fc4a3a8a892d",
}
FOLDER = paths.ROOT / "src" / "crtk_msgs"
SEARCH = {
    "crtk_msgs": [str(FOLDER / "msg")],
    "std_msgs": ["/usr/share/std_msgs/msg"],
    "geometry_msgs": ["/usr/share/geometry_msgs/msg"],
}


@pytest.mark.parametrize("name", MESSAGES)
def test_crtk_message_md5(name: str) -> None:
    context = genmsg.MsgContext.create_default()
    path = FOLDER / "msg" / f"{name}.msg"
    spec = genmsg.msg_loader.load_msg_from_file(context, str(path), f"crtk_msgs/{name}")
    genmsg.msg_loader.load_depends(context, spec, SEARCH)
    assert gentools.compute_md5(context, spec) == MESSAGES[name]


@pytest.mark.parametrize("name", SERVICES)
def test_crtk_service_md5(name: str) -> None:
    context = genmsg.MsgContext.create_default()
    path = FOLDER / "srv" / f"{name}.srv"
    spec = genmsg.msg_loader.load_srv_from_file(context, str(path), f"crtk_msgs/{name}")
    genmsg.msg_loader.load_depends(context, spec, SEARCH)
    assert gentools.compute_md5(context, spec) == SERVICES[name]


def test_crtk_set_is_complete() -> None:
    assert {path.stem for path in (FOLDER / "msg").glob("*.msg")} == set(MESSAGES)
    assert {path.stem for path in (FOLDER / "srv").glob("*.srv")} == set(SERVICES)
