"""Numbers of every size as options of the command line: a result, or one line."""

from __future__ import annotations

import warnings

import pytest
import typer
from command_line import refused

from polarmap.cli import app

VALUES = ("0", "-1", "1e-300", "1e308", "-1e308", "inf", "-inf", "nan", str(2**63 - 1), str(-(2**63)), "9" * 400)
SCENE = ("synth", "scene", "plane", "OUT", "--width", "8", "--height", "8", "--frames", "1")
RGBD = ("synth", "rgbd", "missing", "OUT")
COMMANDS = {"synth scene": SCENE, "synth rgbd": RGBD, "eval": ("eval", "missing", "missing")}


def numeric_options(words: str) -> list[str]:
    """The options of a command that take a number."""
    command = typer.main.get_command(app)
    for word in words.split():
        command = command.commands[word]
    kinds = {
        option.opts[0]: str(option.type_descriptor) for option in command.params if option.opts[0].startswith("--")
    }
    return sorted(name for name, kind in kinds.items() if "int" in kind.lower() or "float" in kind.lower())


CASES = [(words, option) for words in COMMANDS for option in numeric_options(words)]


def test_the_options_that_take_numbers_are_found():
    assert {"--fov", "--step", "--full-well", "--read-noise", "--seed"} <= set(numeric_options("synth scene"))
    assert "--threshold" in numeric_options("eval") and "--ambient" in numeric_options("synth rgbd")


@pytest.mark.parametrize(("words", "option"), CASES, ids=[" ".join(case) for case in CASES])
def test_a_number_of_any_size_ends_in_a_result_or_one_line(polarmap, tmp_path, words, option):
    for count, value in enumerate(VALUES):
        out = tmp_path / str(count)
        arguments = [word.replace("OUT", str(out)) for word in COMMANDS[words]]
        with warnings.catch_warnings():
            warnings.simplefilter("error", RuntimeWarning)
            ended = polarmap(*arguments, f"{option}={value}")
        if "Usage:" not in ended.err:  # which Typer prints about what it refuses itself
            assert len(ended.err.splitlines()) == (ended.status != 0), f"{option}={value}: {ended.err}"


@pytest.mark.parametrize("threshold", ["0", "-1", "nan", "inf", "1e308"])
def test_a_threshold_that_is_no_distance_is_refused(polarmap, threshold):
    refused(polarmap("eval", "missing", "missing", "--threshold", threshold))
