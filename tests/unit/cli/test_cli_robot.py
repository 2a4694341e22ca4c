"""`./surg robot CELL lag`: what it reads from /diagnostics and what it advises."""

import math
from types import SimpleNamespace

import pytest

from helpers.graph.surg import surg
from surg_cli.commands.arms import robot


def status(name: str, **values: str) -> SimpleNamespace:
    pairs = [SimpleNamespace(key=key, value=value) for key, value in values.items()]
    return SimpleNamespace(name=name, values=pairs)


def test_lags_are_read_by_arm_and_other_statuses_are_ignored() -> None:
    lags = robot.lags_of(
        [
            status(
                "PSM1/controller", link_lag_s="0.014", link_lag_stated_s="0.012", late_share="0.5"
            ),
            status("PSM2/controller", link_lag_s="nan", link_lag_stated_s="0.008"),
            status("PSM3/controller", rate_hz="500"),
            status("recorder", link_lag_s="1"),
        ]
    )
    assert set(lags) == {"PSM1", "PSM2"}
    (each,) = robot.lags_of(
        [
            status(
                "PSM1/controller",
                link_lag_s="0.010",
                link_lag_stated_s="0.012",
                joint_lag_s="0.008 nan 0.0115",
                joint_lag_stated_s="0.008 0.009 0.012",
            )
        ]
    ).values()
    assert each.joints_stated == (0.008, 0.009, 0.012)
    assert each.unmoved == [2]
    assert not each.differs
    assert lags["PSM1"] == robot.Lag(0.012, 0.014, late=0.5)
    assert math.isnan(lags["PSM2"].measured)


@pytest.mark.parametrize(
    ("lag", "word"),
    [
        (robot.Lag(0.012, 0.0149), ""),
        (robot.Lag(0.012, 0.0091), ""),
        (robot.Lag(0.012, 0.0151), "0.0151 s"),
        (robot.Lag(0.012, 0.0), "0.0000 s"),
        (robot.Lag(0.012, math.nan), "moved too little"),
        (robot.Lag(0.01, 0.01, (), (0.0095, 0.01, 0.0109)), ""),
        (robot.Lag(0.01, 0.01, (), (0.008, 0.01, 0.0115)), "[0.0080, 0.0100, 0.0115] s"),
        (robot.Lag(0.01, 0.01, (), (0.008, math.nan, 0.0115)), "too little: 2."),
        (robot.Lag(0.0115, 0.01, (0.008, 0.01, 0.0115), (0.009, 0.01, 0.013)), ""),
        (robot.Lag(0.0115, 0.01, (0.008, 0.01, 0.0115), (0.0081, 0.0131, 0.0115)), "0.0131, "),
        (robot.Lag(0.013, 0.0085, (0.013, 0.008), (0.0085, 0.0084)), "0.0085 s"),
        (robot.Lag(0.012, 0.0039, late=0.02), "2 % of the control cycles were late"),
        (robot.Lag(0.012, 0.0039, late=0.005), "0.0039 s"),
        (robot.Lag(0.012, 0.0121, late=0.5), ""),
        (None, "no diagnostics"),
    ],
)
def test_advice_from_three_milliseconds_of_difference_on(lag: robot.Lag | None, word: str) -> None:
    text = robot.advice("PSM1", lag)
    assert bool(text) == bool(word)
    assert word in text


def test_a_cell_that_does_not_run_is_refused_with_how_to_start_it() -> None:
    done = surg("robot", "sim_panda", "lag")
    assert done.returncode == 1
    assert "./surg up sim_panda" in done.stderr


def test_an_unknown_arm_is_refused_with_the_arms_of_the_cell() -> None:
    done = surg("robot", "sim_panda", "lag", "--arm", "PSM9")
    assert done.returncode == 2
    assert "allowed: PSM1" in done.stderr
