"""The compiled core against independent numpy oracles."""

from __future__ import annotations

import numpy as np
import pytest

import surg_core
from surg_core import _core
from surg_core.transforms import minimal_rotation

MAX_JOINTS = 8
TIP = _core.DofLimits(0.25, 2.0, 40.0)


def _unit(rng: np.random.Generator) -> np.ndarray:
    v = rng.normal(size=3)
    return v / np.linalg.norm(v)


def _skew(v: np.ndarray) -> np.ndarray:
    return np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])


def _rotation(axis: np.ndarray, angle: float) -> np.ndarray:
    """Rotation as the limit of many small ones: independent of Rodrigues' formula."""
    step = np.eye(3) + _skew(axis) * angle / 2**30
    for _ in range(30):
        step = step @ step
    u, _, vt = np.linalg.svd(step)
    return u @ vt


def _pose(rng: np.random.Generator) -> np.ndarray:
    X = np.eye(4)
    X[:3, :3] = _rotation(_unit(rng), rng.uniform(-3, 3))
    X[:3, 3] = 0.4 * rng.normal(size=3)
    return X


def _chain(rng: np.random.Generator, n: int) -> surg_core.Chain:
    joints = [_core.Joint(f"j{i}", _pose(rng), _unit(rng)) for i in range(n)]
    return surg_core.Chain(joints, _pose(rng))


@pytest.mark.parametrize(
    ("call", "names"),
    [
        (lambda chain: chain.forward(np.zeros(5)), ["q", "(6,)", "(5,)"]),
        (lambda chain: chain.jacobian(np.zeros((6, 1))), ["q", "(6,)", "(6, 1)"]),
        (lambda chain: _core.Joint("j", np.eye(3), [0, 0, 1]), ["X_PJ", "(4, 4)"]),
        (
            lambda chain: _core.Joint("j", np.ones((4, 4)), [0, 0, 1]),
            ["X_PJ", "not a pose"],
        ),
        (lambda chain: surg_core.Chain([], np.eye(4)), ["1 to 8 joints"]),
        (
            lambda chain: surg_core.Chain([_core.Joint("j", np.eye(4), [0, 0, 2])], np.eye(4)),
            ["'j'", "unit"],
        ),
        (
            lambda chain: minimal_rotation([1, 0], [0, 1, 0]),
            ["a", "(3,)", "(2,)"],
        ),
    ],
)
def test_wrong_input_raises_a_value_error_that_names_it(call, names) -> None:  # type: ignore[no-untyped-def]
    chain = _chain(np.random.default_rng(4), 6)
    with pytest.raises(ValueError) as error:
        call(chain)
    for name in names:
        assert name in str(error.value)


def test_any_layout_and_number_type_is_taken() -> None:
    chain = _chain(np.random.default_rng(5), 6)
    q = np.arange(6)
    expected = chain.forward(q.astype(float))
    np.testing.assert_array_equal(chain.forward(list(range(6))), expected)
    np.testing.assert_array_equal(chain.forward(np.arange(12.0)[::2] / 2), expected)
    np.testing.assert_array_equal(chain.forward(q.astype(np.float32)), expected)


def test_a_recorded_stream_is_followed() -> None:
    t = 0.002 * np.arange(3000)
    states = _core.stream_filter(t, 0.03 * np.sin(t)[:, None], TIP, stamped=False)
    # As in the controller, the target is one tick ahead of the end of the cycle.
    errors = states[500:, 0, 0] - 0.03 * np.sin(t[500:-1] + 0.004)
    assert np.abs(errors).max() < 2e-4


def test_every_reason_has_a_name_and_a_sentence() -> None:
    members = surg_core.Reason.__members__  # type: ignore[attr-defined]
    reasons = list(members.values())
    assert len(reasons) == len({int(reason) for reason in reasons}) >= 20
    assert len({surg_core.reason_name(reason) for reason in reasons}) == len(reasons)
    for word, reason in members.items():
        if reason != surg_core.Reason.NONE:
            assert len(surg_core.sentence(reason).split()) >= 3, word


def test_configuration_is_read_only() -> None:
    document = _core.Document(
        "tool.yaml",
        {
            "format": "surg_tool/1",
            "shaft_axis": [0.0, 0.0, 1.0],
            "tip": [0.0, 0.0, 0.3],
            "residual": 0.0,
            "n": 10,
            "condition": 2.0,
            "date": "2026-11-21",
        },
    )
    tool = _core.parse_tool(document)
    assert tool.n == 10
    with pytest.raises(AttributeError):
        tool.n = 3  # type: ignore[misc]
    with pytest.raises(ValueError, match="read-only"):
        tool.s_F[0] = 1.0
    with pytest.raises(TypeError, match=r"tip.*list may hold"):
        _core.Document("x.yaml", {"tip": [1.0, "two"]})  # type: ignore[dict-item]
    with pytest.raises(TypeError, match="tip"):
        _core.Document("x.yaml", {"tip": None})  # type: ignore[dict-item]


@pytest.mark.parametrize("limits", [(0.0, 2.0, 40.0), (0.25, -2.0, 40.0), (0.25, 2.0, np.nan)])
def test_limits_that_are_not_positive_are_refused(limits: tuple[float, float, float]) -> None:
    with pytest.raises(ValueError, match="must be > 0"):
        _core.DofLimits(*limits)
