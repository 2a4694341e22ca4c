"""surg_force_sensor/1: the bundled file, and what is refused with its key."""

from pathlib import Path

import numpy as np
import pytest

from surg_cli.host import paths
from surg_core import ConfigError
from surg_core.force.sensor_file import load_sensor

BUNDLED = paths.ROOT / "src" / "surg_description" / "force_sensors" / "simulated.yaml"


def test_the_bundled_sensor_has_its_figures() -> None:
    sensor = load_sensor(BUNDLED)
    assert (sensor.rate, sensor.sign) == (500.0, 1.0)
    np.testing.assert_allclose(sensor.noise[:3], 0.05)
    assert np.linalg.norm(sensor.bias) > 1.0 and np.linalg.norm(sensor.turn) > 0.005


@pytest.mark.parametrize(
    ("was", "now", "key"),
    [
        ("rate: 500", "rate: 5", "rate"),
        ("range: [200,", "range: [0,", "range"),
        ("noise: [0.05,", "noise: [.nan,", "noise"),
        ("drift: [0.05,", "drift: [-0.05,", "drift"),
        ("reading: tool_on_sensor", "reading: up", "reading"),
        ("position: [0, 0, 0]", "position: [0, 0, 1]", "position"),
        ("  turn: [0.004,", "  turn: [4,", "simulated.turn"),
        ("name: simulated", "name: simulated\ncolour: red", "colour"),
        ("rate: 500", "", "rate"),
    ],
)
def test_what_a_sensor_must_not_state_is_refused_by_its_key(
    tmp_path: Path, was: str, now: str, key: str
) -> None:
    text = BUNDLED.read_text("utf-8")
    assert was in text
    file = tmp_path / "sensor.yaml"
    file.write_text(text.replace(was, now), encoding="utf-8")
    with pytest.raises(ConfigError, match=f"{file}(:[0-9]+)?: {key}: .*; allowed: "):
        load_sensor(file)


def test_a_real_sensor_states_nothing_simulated(tmp_path: Path) -> None:
    file = tmp_path / "sensor.yaml"
    file.write_text(BUNDLED.read_text("utf-8").split("simulated:\n")[0], encoding="utf-8")
    sensor = load_sensor(file)
    assert not sensor.bias.any() and not sensor.turn.any()
