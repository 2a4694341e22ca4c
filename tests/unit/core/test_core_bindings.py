"""The compiled core against independent numpy oracles."""

from __future__ import annotations

import math

import numpy as np
import pytest

import surg_core
from surg_core import _core, testing
from surg_core.testing import DofLimits, Kinematic
from surg_core.transforms import minimal_rotation

TIP = DofLimits(0.25, 2.0, 40.0)
ROLL = DofLimits(3.0, 40.0, 800.0)


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
    for n in range(1, testing.MAX_JOINTS + 1):
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
        n = int(rng.integers(6, testing.MAX_JOINTS + 1))
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


def test_inverse_velocity_is_the_pseudo_inverse_with_a_posture() -> None:
    rng = np.random.default_rng(3)
    for n in (6, 7, 8):
        for _ in range(50):
            J = rng.normal(size=(6, n))
            twist, posture = rng.normal(size=6), rng.normal(size=n)
            pinv = np.linalg.pinv(J)
            expected = pinv @ twist + (np.eye(n) - pinv @ J) @ posture
            result = testing.inverse_velocity(J, twist, posture)
            np.testing.assert_allclose(result.qd, expected, atol=1e-7 * np.linalg.cond(J) ** 2)
            assert 0 < result.conditioning <= 1
    singular = np.zeros((6, 7))
    result = testing.inverse_velocity(singular, np.ones(6))
    assert result.conditioning == 0
    assert not result.qd.any()


@pytest.mark.parametrize(
    ("call", "names"),
    [
        (lambda chain: chain.forward(np.zeros(5)), ["q", "(6,)", "(5,)"]),
        (lambda chain: chain.jacobian(np.zeros((6, 1))), ["q", "(6,)", "(6, 1)"]),
        (
            lambda chain: testing.inverse_velocity(np.zeros((6, 5)), np.zeros(6)),
            ["J", "six"],
        ),
        (
            lambda chain: testing.inverse_velocity(np.zeros((6, 9)), np.zeros(6)),
            ["J", "(6, 9)"],
        ),
        (
            lambda chain: testing.inverse_velocity(np.zeros((6, 6)), np.zeros(5)),
            ["twist"],
        ),
        (
            lambda chain: testing.inverse_velocity(np.eye(6), np.zeros(6), [1]),
            ["posture"],
        ),
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
        (lambda chain: testing.Profiler([TIP] * 4, 0.0), ["base duration"]),
        (lambda chain: testing.StreamFilter(DofLimits(1, 0, 1)), ["limits must be > 0"]),
        (
            lambda chain: testing.Profiler([TIP] * 4).plan([0] * 4, [[1, 0]] * 4),
            ["bounds", "row 0"],
        ),
        (
            lambda chain: testing.Profiler([TIP] * 4).plan([0] * 4, [0, 1]),
            ["bounds", "(4, 2)", "(2,)"],
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
    J = np.asfortranarray(np.random.default_rng(6).normal(size=(6, 7)))
    qd = testing.inverse_velocity(J, np.ones(6)).qd
    np.testing.assert_allclose(J @ qd, np.ones(6), atol=1e-9)


def test_quintic_meets_the_boundary_conditions_as_a_linear_system() -> None:
    rng = np.random.default_rng(7)
    for _ in range(50):
        d = float(rng.uniform(0.1, 3))
        a, b = rng.normal(size=3), rng.normal(size=3)
        rows = []
        for end in (0.0, d):
            rows.append([end**i for i in range(6)])
            rows.append([i * end ** max(i - 1, 0) for i in range(6)])
            rows.append([i * (i - 1) * end ** max(i - 2, 0) for i in range(6)])
        c = np.linalg.solve(np.array(rows), np.concatenate([a, b]))
        q = testing.Quintic(Kinematic(*a), Kinematic(*b), d)
        p = np.polynomial.Polynomial(c)
        t = np.linspace(0, d, 2001)
        for ti in t[::100]:
            state = q.at(ti)
            np.testing.assert_allclose(
                [state.x, state.v, state.a, q.jerk(ti)],
                [p(ti), p.deriv(1)(ti), p.deriv(2)(ti), p.deriv(3)(ti)],
                rtol=1e-6,
                atol=1e-6 * np.abs(p.deriv(3)(t)).max(),
            )
        for largest, order in ((q.max_velocity, 1), (q.max_acceleration, 2), (q.max_jerk, 3)):
            np.testing.assert_allclose(largest(), np.abs(p.deriv(order)(t)).max(), rtol=1e-5)
        assert q.max_position() >= p(t).max() - 1e-9
        assert q.min_position() <= p(t).min() + 1e-9


def test_profiler_stays_within_its_limits_and_arrives() -> None:
    limits = [TIP, TIP, TIP, ROLL]
    profiler = testing.Profiler(limits)
    profiler.reset(np.zeros(4))
    profiler.plan([0.05, -0.1, 0.02, 1.0])
    assert profiler.duration == pytest.approx(15 * 0.1 / (8 * 0.25))
    for _ in range(50):
        profiler.advance(0.002)
    profiler.plan([0.0, 0.1, 0.02, -1.0])  # a change of mind on the way
    while not profiler.done:
        profiler.advance(0.002)
        for state, limit in zip(profiler.state, limits, strict=True):
            assert abs(state.v) <= limit.velocity + 1e-9
            assert abs(state.a) <= limit.acceleration + 1e-9
    assert [state.x for state in profiler.state] == [0.0, 0.1, 0.02, -1.0]
    assert [state.v for state in profiler.state] == [0.0] * 4
    profiler.reset_to([Kinematic(0.1, 0.2, 0.3)] * 4)
    assert profiler.state[3].a == 0.3
    with pytest.raises(IndexError):
        profiler.quintic(4)


def test_profiler_keeps_position_bounds_and_says_how_far_it_goes() -> None:
    profiler = testing.Profiler([TIP] * 4)
    start = [Kinematic(0.0, 0.2, 0.0)] + [Kinematic()] * 3
    profiler.reset_to(start)
    assert profiler.plan([0.01, 0.2, 0.0, 0.0])
    assert profiler.excursion(0, 0.0, profiler.duration)[1] > 0.05
    assert profiler.brake_duration == 0
    bounds = [[-0.01, 0.03]] + [[-math.inf, math.inf]] * 3
    profiler.reset_to(start)
    assert profiler.plan([0.01, 0.2, 0.0, 0.0], bounds)
    assert profiler.excursion(0, 0.0, profiler.duration)[1] <= 0.03
    stop = testing.Braking.stop(start[0], TIP)
    assert profiler.brake_duration == stop.duration
    bounds[0][1] = 0.9 * stop.distance
    profiler.reset_to(start)
    assert not profiler.plan([0.01, 0.2, 0.0, 0.0], bounds)
    assert profiler.excursion(0, 0.0, profiler.duration)[1] == pytest.approx(stop.distance)


def test_a_stop_is_a_second_integral() -> None:
    rng = np.random.default_rng(14)
    for _ in range(50):
        start = Kinematic(rng.normal(), rng.uniform(-0.25, 0.25), rng.uniform(-2, 2))
        stop = testing.Braking.stop(start, TIP)
        t = np.linspace(0, stop.duration, 20001)
        a = np.array([stop.at(time).a for time in t])
        step = t[1]
        v = start.v + np.concatenate([[0], np.cumsum((a[1:] + a[:-1]) / 2)]) * step
        x = start.x + np.concatenate([[0], np.cumsum((v[1:] + v[:-1]) / 2)]) * step
        assert np.abs(a).max() <= 2 * (1 + 1e-12)
        assert np.abs(np.diff(a)).max() <= 40 * step * (1 + 1e-6)
        assert v[-1] == pytest.approx(0, abs=1e-7)
        assert x[-1] - start.x == pytest.approx(stop.distance, abs=1e-7)
        np.testing.assert_allclose(stop.range(0, stop.duration), (x.min(), x.max()), atol=1e-7)


def test_stream_filter_brakes_within_its_limits() -> None:
    stream = testing.StreamFilter(TIP)
    stream.reset(Kinematic(0.0, 0.25, 0.0))
    ticks = 0
    while abs(stream.state.v) > 1e-12:
        stream.brake(0.002)
        ticks += 1
    stop = testing.Braking.stop(Kinematic(0.0, 0.25, 0.0), TIP)
    assert ticks <= math.ceil(stop.duration / 0.002) + 1
    assert stop.distance <= stream.state.x <= stop.distance + 0.25 * 0.002


def test_a_recorded_stream_is_followed() -> None:
    t = 0.002 * np.arange(3000)
    states = testing.stream_filter(t, 0.03 * np.sin(t)[:, None], TIP, stamped=False)
    # As in the controller, the target is one tick ahead of the end of the cycle.
    errors = states[500:, 0, 0] - 0.03 * np.sin(t[500:-1] + 0.004)
    assert np.abs(errors).max() < 2e-4


def test_a_stream_clock_takes_the_senders_spacing_and_its_own_offset() -> None:
    clock = testing.StreamClock(5.0, 1_000_000_000_000)
    elapsed = [
        clock.advance(5.0 + 0.02 * (k // 10), 1_000_000_000_000 + 2_000_000 * k)
        for k in range(1, 2000)
    ]
    assert clock.stamped
    np.testing.assert_allclose(elapsed, 0.002, atol=1e-9)
    assert clock.period == pytest.approx(0.002)
    # Bursts of 20 ms that begin with their newest sample: the mean delay is -9 ms.
    assert clock.time == pytest.approx(5.0 + 0.002 * 1999 - 0.009, abs=1e-3)


def test_stream_delay_is_late_by_its_delay() -> None:
    delay = testing.StreamDelay(0.05)
    delay.reset(Kinematic())
    assert delay.works(0.002)
    assert not testing.StreamDelay(0.0).works(0.002)
    for k in range(1000):
        delay.step(0.1 * 0.002 * (k + 0.5), 0.002)
    assert delay.predict(0.0).x == pytest.approx(0.1 * (2.0 - 0.05), abs=1e-6)
    assert delay.predict(0.01).x == pytest.approx(0.1 * (2.01 - 0.05), abs=1e-6)


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


def test_rcm_twist_moves_the_tip_as_asked_and_decays_the_error() -> None:
    """Integrates the flange by the twist over a short time and looks at tip, error and roll."""
    rng = np.random.default_rng(9)
    h = 1e-6
    for _ in range(100):
        X = _pose(rng)
        s_F, p_FTip = _unit(rng), 0.3 * rng.normal(size=3)
        s = X[:3, :3] @ s_F
        tip = X[:3, :3] @ p_FTip + X[:3, 3]
        sideways = np.cross(s, _unit(rng))
        p_rcm = tip - rng.uniform(0.05, 0.2) * s + 0.001 * sideways
        v_tip, v_rcm = 0.1 * rng.normal(size=3), 0.01 * rng.normal(size=3)
        roll_rate, gain = float(rng.normal()), 30.0
        before = surg_core.shaft_state(X, s_F, p_FTip, p_rcm)
        twist = testing.rcm_twist(before, v_tip, roll_rate, v_rcm, gain, 0.01)
        after_X = X.copy()
        omega = twist[3:]
        turn = _rotation(omega / np.linalg.norm(omega), float(np.linalg.norm(omega)) * h)
        after_X[:3, :3] = turn @ X[:3, :3]
        after_X[:3, 3] += twist[:3] * h
        after = surg_core.shaft_state(after_X, s_F, p_FTip, p_rcm + v_rcm * h)
        np.testing.assert_allclose((after.p_BTip - before.p_BTip) / h, v_tip, atol=1e-4)
        rate = (np.linalg.norm(after.e) - np.linalg.norm(before.e)) / h
        assert rate == pytest.approx(-gain * np.linalg.norm(before.e), abs=1e-4)
        assert omega @ s == pytest.approx(roll_rate, abs=1e-9)


def test_paper_twists_are_the_printed_equations() -> None:
    rng = np.random.default_rng(10)
    for _ in range(50):
        p_ee, p_tip, p_rcm, v_tip = rng.normal(size=(4, 3))
        roll = float(rng.normal())
        r_ee, r_shaft = p_rcm - p_ee, p_tip - p_rcm
        r_hat = r_shaft / np.linalg.norm(r_shaft)
        omega = np.cross(r_shaft, v_tip) / (r_shaft @ r_shaft) + roll * r_hat
        v = (v_tip @ r_hat) * r_hat - np.cross(omega, r_ee)
        twist = testing.paper_cartesian_twist(p_ee, p_tip, p_rcm, v_tip, roll)
        np.testing.assert_allclose(twist, np.concatenate([v, omega]), atol=1e-9)
        pitch, yaw, v_trans = (float(x) for x in rng.normal(size=3))
        e_hat = r_ee / np.linalg.norm(r_ee)
        omega = np.array([pitch, yaw, 0.0]) + roll * e_hat
        v = v_trans * e_hat - np.cross(omega, r_ee)
        twist = testing.paper_spherical_twist(p_ee, p_rcm, pitch, yaw, roll, v_trans)
        np.testing.assert_allclose(twist, np.concatenate([v, omega]), atol=1e-9)


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
        rates = rng.normal(size=2)
        h = 1e-6
        difference = surg_core.shaft_direction(
            yaw + h * rates[0], pitch + h * rates[1]
        ) - surg_core.shaft_direction(yaw - h * rates[0], pitch - h * rates[1])
        np.testing.assert_allclose(
            testing.shaft_direction_rate(yaw, pitch, *rates),
            difference / (2 * h),
            atol=1e-8,
        )


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


def test_absolute_roll_is_what_was_put_in() -> None:
    rng = np.random.default_rng(13)
    for _ in range(100):
        R_home = _pose(rng)[:3, :3]
        s_F = _unit(rng)
        s_home = R_home @ s_F
        s = s_home + 0.8 * rng.normal(size=3)
        s /= np.linalg.norm(s)
        if s @ s_home < -0.5:
            continue
        psi = float(rng.uniform(-3.1, 3.1))
        M = minimal_rotation(s_home, s)
        np.testing.assert_allclose(M @ s_home, s, atol=1e-12)
        np.testing.assert_allclose(M @ M.T, np.eye(3), atol=1e-12)
        angle = math.acos(np.clip((np.trace(M) - 1) / 2, -1, 1))
        assert angle == pytest.approx(math.acos(np.clip(s @ s_home, -1, 1)), abs=1e-6)
        R = M @ _rotation(s_home, psi) @ R_home
        assert testing.absolute_roll(R, R_home, s_home, s) == pytest.approx(psi, abs=1e-6)


def test_holonomy_rate_keeps_the_absolute_roll_over_a_closed_loop() -> None:
    """Turns a tool round a cone without and with the term: the solid angle comes and goes."""
    s_home = np.array([0.0, 0.0, 1.0])
    n = 20000
    tilt, dt = 0.6, 1.0 / n

    def direction(t: float) -> np.ndarray:
        turn = 2 * math.pi * t
        return np.array(
            [
                math.sin(tilt) * math.cos(turn),
                math.sin(tilt) * math.sin(turn),
                math.cos(tilt),
            ]
        )

    def roll_after_one_turn(with_term: bool) -> float:
        R = minimal_rotation(s_home, direction(0.0))
        for k in range(n):
            middle = direction((k + 0.5) * dt)
            s_dot = (direction((k + 1) * dt) - direction(k * dt)) / dt
            omega = np.cross(middle, s_dot)
            if with_term:
                omega = omega + testing.roll_holonomy_rate(s_home, middle, s_dot) * middle
            length = float(np.linalg.norm(omega))
            R = surg_core.axis_angle_to_matrix(omega, length * dt) @ R
        return testing.absolute_roll(R, np.eye(3), s_home, direction(0.0))

    solid_angle = 2 * math.pi * (1 - math.cos(tilt))
    assert abs(roll_after_one_turn(False)) == pytest.approx(solid_angle, abs=1e-4)
    assert roll_after_one_turn(True) == pytest.approx(0.0, abs=1e-4)


def test_every_reason_has_a_name_and_a_sentence() -> None:
    members = surg_core.Reason.__members__  # type: ignore[attr-defined]
    reasons = list(members.values())
    assert len(reasons) == len({int(reason) for reason in reasons}) >= 20
    assert len({surg_core.reason_name(reason) for reason in reasons}) == len(reasons)
    for word, reason in members.items():
        if reason != surg_core.Reason.NONE:
            assert len(surg_core.sentence(reason).split()) >= 3, word
    names = {testing.state_name(s) for s in surg_core.State.__members__.values()}  # type: ignore[attr-defined]
    assert names == {"DISABLED", "ENABLED", "PAUSED", "FAULT"}


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
