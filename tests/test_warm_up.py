"""Compiling ahead goes the ways that runs go."""

from __future__ import annotations

from polarmap.warm_up import warm_up


def test_keyframes_come_of_given_poses_and_of_odometry():
    given, found = warm_up()
    assert given >= 2 and found >= 2


def test_the_command_says_that_it_is_done(polarmap):
    status, out, _ = polarmap("warmup")
    assert status == 0 and "all is compiled" in out
