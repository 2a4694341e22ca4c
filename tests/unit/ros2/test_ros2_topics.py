"""Which topics ROS 2 sees, which it may say, and their names."""

import io
import struct
from pathlib import Path
from types import SimpleNamespace

import pytest
from PIL import Image

from surg_cli.graph import topic_contract
from surg_ros2 import jpeg
from surg_ros2.bridged_topics import (
    COMMANDS,
    NotBridged,
    Quality,
    Topics,
    caller_name,
    dds_service,
    dds_topic,
    dds_type,
)


@pytest.fixture
def topics() -> Topics:
    return Topics(topic_contract.SOURCE)


def test_every_topic_of_the_contract_has_its_direction(topics: Topics) -> None:
    for entry in topic_contract.load().entries:
        name = "/" + entry.name.lstrip("/").replace("<arm>", "PSM1").replace("<leader>", "pad")
        if entry.direction == "out":
            quality = topics.outgoing(name, entry.type)
            assert quality is not None
            assert quality.latched or not entry.latched[1]
        elif entry.direction == "in":
            inside = "/robot/servo_" in name or name.endswith("tool/servo_jp") or name in (
                "/sim/inject", "/sim/guide_home", "/sim/undeclared",
            )  # fmt: skip
            assert topics.incoming(name, entry.type) == (None if inside else COMMANDS)
        else:
            assert topics.service(name) == entry.type
    assert topics.service("/PSM1/controller/get_loggers") is None


@pytest.mark.parametrize(
    ("topic", "kind", "quality"),
    [
        ("/PSM1/measured_cp", "geometry_msgs/PoseStamped", Quality()),
        ("/PSM1/operating_state", "crtk_msgs/OperatingState", Quality(latched=True, depth=1)),
        ("/tf_static", "tf2_msgs/TFMessage", Quality(latched=True, depth=100)),
        ("/tf", "tf2_msgs/TFMessage", Quality()),
        ("/endoscope/left/image_raw", "sensor_msgs/Image", Quality(reliable=False, depth=1)),
        ("/PSM1/measured_cp", "std_msgs/String", None),
        ("/PSM1/deeper/measured_cp", "geometry_msgs/PoseStamped", None),
        ("/rosout", "rosgraph_msgs/Log", None),
        ("/PSM1/servo_cp", "geometry_msgs/PoseStamped", None),
    ],
)
def test_how_a_topic_is_offered(
    topics: Topics, topic: str, kind: str, quality: Quality | None
) -> None:
    assert topics.outgoing(topic, kind) == quality


def test_in_lock_step_cycles_are_latched() -> None:
    lockstep = Topics(topic_contract.SOURCE, lockstep=True)
    assert lockstep.outgoing("/PSM1/cycle", "surg_msgs/Cycle") == Quality(latched=True, depth=1)


def test_a_file_that_is_no_contract_is_named(tmp_path: Path) -> None:
    file = tmp_path / "topics.yaml"
    with pytest.raises(ValueError, match=r"topics\.yaml: no contract"):
        Topics(file)
    file.write_text("[1")
    with pytest.raises(ValueError, match=r"topics\.yaml: no contract"):
        Topics(file)


def test_names_on_dds() -> None:
    assert dds_topic("/PSM1/jaw/servo_jp") == "rt/PSM1/jaw/servo_jp"
    assert dds_type("sensor_msgs/JointState") == "sensor_msgs::msg::dds_::JointState_"
    made = "crtk_msgs::srv::dds_::QueryInverseKinematics"
    assert dds_service("/PSM1/inverse_kinematics", "crtk_msgs/QueryInverseKinematics") == (
        ("rq/PSM1/inverse_kinematicsRequest", f"{made}_Request_"),
        ("rr/PSM1/inverse_kinematicsReply", f"{made}_Response_"),
    )
    for name in ("/1arm/servo_cp", "/a__b", "/a/", "a"):
        with pytest.raises(NotBridged, match="ROS 2 allows no such name"):
            dds_topic(name)


def test_each_process_has_a_name_of_its_own() -> None:
    key = "010f78fd-131c-3454-0000-0000000001c1"
    assert caller_name(["/lab/my_script"], key, []) == "ros2_lab_my_script"
    assert caller_name(["/a"], key, ["ros2_a", "ros2_a_2"]) == "ros2_a_3"
    assert caller_name([], key, []) == "ros2_peer_131c_3454"
    assert caller_name(["/PSM1/controller"], key, []) == "ros2_PSM1_controller"


@pytest.mark.parametrize(("space", "full"), [("/", "/n"), ("/lab", "/lab/n")])
def test_the_first_node_of_a_process(space: str, full: str) -> None:
    dds_port = pytest.importorskip("surg_ros2.dds_port")
    text = space.encode() + b"\0"
    sample = bytes(20) + struct.pack("<II", 1, len(text)) + text
    sample += bytes(-len(sample) % 4) + struct.pack("<I", 2) + b"n\0" + bytes(10)
    assert dds_port.first_node(sample) == full
    assert dds_port.first_node(bytes(24)) == ""
    for cut in range(len(sample) - 11):
        assert dds_port.first_node(sample[:cut]) in ("", full, full[:-1])


def test_raw_pictures_become_jpeg() -> None:
    picture = SimpleNamespace(
        encoding="bgr8", width=16, height=8, step=50, data=(b"\xff\0\0" * 16 + b"xx") * 8
    )
    data = jpeg.encode(picture)
    assert data is not None
    decoded = Image.open(io.BytesIO(data)).convert("RGB")
    assert decoded.size == (16, 8)
    red, _, blue = decoded.getpixel((8, 4))
    assert blue > 240 and red < 15
    picture.data = picture.data[:-60]
    assert jpeg.encode(picture) is None
    picture.encoding = "32FC1"
    assert jpeg.encode(picture) is None
