"""The limited step through the Python binding: the same promises as in C++, on a short path."""

import numpy as np
import pytest

import surg_core
from surg_core import _core, testing

T = 0.002


def _arm() -> tuple[surg_core.Chain, np.ndarray]:
    """UR5e by its public DH parameters, and joints that hold a shaft downwards."""
    dh = [
        (0.1625, 0.0, np.pi / 2),
        (0.0, -0.425, 0.0),
        (0.0, -0.3922, 0.0),
        (0.1333, 0.0, np.pi / 2),
        (0.0997, 0.0, -np.pi / 2),
        (0.0996, 0.0, 0.0),
    ]
    joints = []
    X_PJ = np.eye(4)
    for i, (d, a, alpha) in enumerate(dh):
        joints.append(_core.Joint(f"joint{i}", X_PJ, [0, 0, 1]))
        c, s = np.cos(alpha), np.sin(alpha)
        X_PJ = np.array([[1, 0, 0, a], [0, c, -s, 0], [0, s, c, d], [0, 0, 0, 1.0]])
    return surg_core.Chain(joints, X_PJ), np.array([-0.294, -1.234, 1.511, -1.29, -1.63, -2.134])


def _limits(n: int = 6, **changes: object) -> testing.JointLimits:
    values: dict = {
        "position_min": np.full(n, -6.28),
        "position_max": np.full(n, 6.28),
        "velocity": np.full(n, 1.0),
        "acceleration": np.full(n, 10.0),
    }
    return testing.JointLimits(**{**values, **changes})


def test_a_fast_path_is_slowed_on_the_pivot_and_retraced() -> None:
    chain, q = _arm()
    s_F, p_FTip = np.array([0.0, 0, 1]), np.array([0.06, 0, 0.3])
    X = chain.forward(q)
    R_home, s_home = X[:3, :3], X[:3, 2]
    p_BRcm = X[:3, :3] @ p_FTip + X[:3, 3] - 0.08 * s_home
    side = np.cross(s_home, [1.0, 0, 0])
    side /= np.linalg.norm(side)
    limited = testing.LimitedStep(chain, s_F, p_FTip, _limits(), T)
    trace = testing.JointTrace()
    clock, q_begin, qd, slowed = 0.0, q.copy(), np.zeros(6), 0

    for _ in range(800):

        def path(t: float, now: float = clock) -> tuple[np.ndarray, np.ndarray, float, float]:
            at = min(now + t, 1.0)
            angle = 1.0 * (10 * at**3 - 15 * at**4 + 6 * at**5)
            s = np.cos(angle) * s_home + np.sin(angle) * side
            return p_BRcm, s, 0.08 + 0.02 * angle, 0.0

        step = limited.exact(q, qd, s_home, R_home, path, horizon=0.2)
        assert np.all(np.abs(step.qd) <= 1.0)
        assert np.all(np.abs(step.qd - qd) <= 10 * T)
        slowed += step.alpha < 1
        assert (step.limited_by == "") == (step.alpha == 1)
        qd = np.array(step.qd)
        q = q + T * qd
        clock += step.alpha * T
        trace.record(q)
        shaft = surg_core.shaft_state(chain.forward(q), s_F, p_FTip, p_BRcm)
        assert np.linalg.norm(shaft.e) < 1e-8
        assert step.tier == 0
    assert clock > 1.0
    assert slowed > 50

    back = 0.0
    for _ in range(4000):
        step = limited.retrace(q, qd, trace, back, 0.5, p_BRcm)
        qd = np.array(step.qd)
        q = q + T * qd
        back += step.alpha * 0.5 * T
    np.testing.assert_allclose(q, q_begin, atol=1e-3)


def test_velocity_form_scales_a_twist() -> None:
    chain, q = _arm()
    limited = testing.LimitedStep(chain, [0, 0, 1], [0, 0, 0.3], _limits(), T)
    X = chain.forward(q)
    p_BRcm = X[:3, 3] + 0.22 * X[:3, 2]
    forward = np.array([*(0.5 * X[:3, 2]), 0, 0, 0])  # along the shaft
    step = limited.velocity(q, np.zeros(6), p_BRcm, np.zeros(6), forward)
    assert 0 < step.alpha < 0.2
    assert step.limited_by == "joint_acceleration"
    np.testing.assert_allclose(chain.jacobian(q) @ step.qd, step.alpha * forward, atol=1e-12)
    with pytest.raises(ValueError):
        step.qd[0] = 1.0


def test_wrong_sizes_are_refused() -> None:
    chain, q = _arm()
    with pytest.raises(ValueError, match="7 joints"):
        testing.LimitedStep(chain, [0, 0, 1], [0, 0, 0.3], _limits(7), T)
    with pytest.raises(ValueError, match="velocity"):
        _limits(9)
    with pytest.raises(ValueError, match="position_min"):
        _limits(6, position_min=np.zeros(5))
    limited = testing.LimitedStep(chain, [0, 0, 1], [0, 0, 0.3], _limits(), T)
    with pytest.raises(ValueError, match="empty"):
        limited.retrace(q, np.zeros(6), testing.JointTrace(), 0, 0.5, np.zeros(3))
    trace = testing.JointTrace()
    with pytest.raises(ValueError, match="empty"):
        trace.at(0)
