"""The compiled core against independent numpy oracles."""

from __future__ import annotations

import math

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


def test_forward_is_the_product_of_the_joints() -> None:
    rng = np.random.default_rng(1)
    for n in range(1, MAX_JOINTS + 1):
        chain = _chain(rng, n)
        q = rng.uniform(-3, 3, n)
        X = np.eye(4)
        for joint, angle in zip(chain.joints, q, strict=True):
            turn = np.eye(4)
            turn[:3, :3] = _rotation(joint.axis, angle)
            X = X @ joint.X_PJ @ turn
        assert chain.dof == n
        np.testing.assert_allclose(chain.forward(q), X @ chain.X_LF, atol=1e-7)


def test_jacobian_is_the_derivative_of_forward() -> None:
    rng = np.random.default_rng(2)
    h = 1e-6
    for _ in range(20):
        n = int(rng.integers(6, MAX_JOINTS + 1))
        chain = _chain(rng, n)
        q = rng.uniform(-3, 3, n)
        J = chain.jacobian(q)
        assert J.shape == (6, n)
        assert J.flags.c_contiguous
        for i in range(n):
            step = np.eye(n)[i] * h
            below, above = chain.forward(q - step), chain.forward(q + step)
            W = above[:3, :3] @ below[:3, :3].T
            omega = np.array([W[2, 1] - W[1, 2], W[0, 2] - W[2, 0], W[1, 0] - W[0, 1]]) / (4 * h)
            expected = np.concatenate([(above[:3, 3] - below[:3, 3]) / (2 * h), omega])
            np.testing.assert_allclose(J[:, i], expected, atol=1e-8)


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


def test_shaft_state_is_plain_geometry() -> None:
    rng = np.random.default_rng(8)
    for _ in range(100):
        X, s_F, p_FTip, p_rcm = _pose(rng), _unit(rng), rng.normal(size=3), rng.normal(size=3)
        shaft = surg_core.shaft_state(X, s_F, p_FTip, p_rcm)
        s, tip = X[:3, :3] @ s_F, X[:3, :3] @ p_FTip + X[:3, 3]
        np.testing.assert_allclose(shaft.s, s, atol=1e-12)
        np.testing.assert_allclose(shaft.p_BTip, tip, atol=1e-12)
        np.testing.assert_allclose(shaft.p_BF, X[:3, 3])
        # Distance of a point from a line.
        deviation = np.linalg.norm(np.cross(p_rcm - tip, s))
        assert np.linalg.norm(shaft.e) == pytest.approx(deviation, abs=1e-12)
        assert shaft.e @ s == pytest.approx(0, abs=1e-12)
        np.testing.assert_allclose(shaft.p_BNear + shaft.e, p_rcm, atol=1e-12)
        np.testing.assert_allclose(shaft.p_BNear + shaft.depth * s, tip, atol=1e-12)


def test_shaft_angles_and_direction_are_inverse() -> None:
    rng = np.random.default_rng(11)
    for _ in range(100):
        yaw, pitch = rng.uniform(-3.1, 3.1), rng.uniform(-1.5, 1.5)
        s = surg_core.shaft_direction(yaw, pitch)
        expected = [
            math.sin(yaw) * math.cos(pitch),
            math.sin(pitch),
            math.cos(yaw) * math.cos(pitch),
        ]
        np.testing.assert_allclose(s, expected, atol=1e-15)
        np.testing.assert_allclose(surg_core.shaft_angles(s), (yaw, pitch), atol=1e-9)


def test_rcm_frame_has_z_along_the_shaft_and_x_along_base_x() -> None:
    rng = np.random.default_rng(12)
    for _ in range(100):
        s, p = _unit(rng), rng.normal(size=3)
        X = surg_core.rcm_frame(s, p)
        np.testing.assert_allclose(X[:3, :3] @ X[:3, :3].T, np.eye(3), atol=1e-12)
        assert np.linalg.det(X[:3, :3]) == pytest.approx(1)
        np.testing.assert_allclose(X[:3, 2], s, atol=1e-12)
        np.testing.assert_array_equal(X[:3, 3], p)
        if abs(s[0]) < 0.99:
            assert X[0, 0] == pytest.approx(math.sqrt(1 - s[0] ** 2), abs=1e-12)
    along_x = surg_core.rcm_frame([1.0, 0.0, 0.0], [0.0, 0.0, 0.0])
    np.testing.assert_allclose(along_x[:3, 0], [0, 1, 0], atol=1e-15)


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
