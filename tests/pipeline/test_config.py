"""Every parameter from YAML and from settings; what is wrong is said in one line."""

from __future__ import annotations

import numpy as np
import pytest
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from polarmap.errors import InputError
from polarmap.options import Options, parameter
from polarmap.pipeline.config import Config, read_config

SECTIONS = (
    "odometry",
    "keyframes",
    "stereo",
    "patchmatch",
    "consistency",
    "inliers",
    "prior",
    "cues",
    "densify",
    "surfaces",
    "paper",
    "fusion",
)


def problem(call, *arguments) -> str:
    """The one line that InputError says."""
    with pytest.raises(InputError) as caught:
        call(*arguments)
    message = str(caught.value)
    assert message and "\n" not in message and len(message) < 500
    return message


def test_the_sections_are_the_steps():
    assert tuple(Config.model_fields) == SECTIONS


def test_the_papers_parameters_are_the_defaults():
    config = Config()
    assert config.paper.max_turn == pytest.approx(np.pi / 6)
    assert (config.paper.smoothing, config.paper.edge_decay, config.paper.min_growth) == (0.3, 3.0, 0.1)
    assert config.cues.refractive_index == 1.5 and not config.cues.orthographic
    keyframes = config.keyframes
    assert (keyframes.flow_weight, keyframes.translation_weight, keyframes.brightness_weight) == (0.02, 0.04, 2.0)


def test_a_written_config_reads_back(tmp_path):
    config = Config().with_settings(
        ["paper.max_steps=48", "cues.orthographic=true", "patchmatch.sweeps=[2, 1]", "patchmatch.trials=[2, 2]",
         "stereo.depth_max=1e-05", "fusion.voxel_size=0.02"]
    )  # fmt: skip
    path = tmp_path / "config.yaml"
    path.write_text(config.to_yaml(), encoding="utf-8")
    assert read_config(path) == config != Config()
    assert config.stereo.depth_max == 1e-5 and config.patchmatch.sweeps == (2, 1)


def test_the_written_config_explains_every_parameter():
    lines = Config().to_yaml().splitlines()
    for entry in Config().parameters():
        assert entry.meaning and any(f"  {entry.name}: " in line and f"# {entry.meaning}" in line for line in lines)
    assert any("[pixels]" in line for line in lines)


def test_parameters_tell_value_and_default():
    changed = Config().with_settings(["paper.edge=0.1"])
    entries = {(entry.section, entry.name): entry for entry in changed.parameters()}
    assert len(entries) == sum(len(field.annotation.model_fields) for field in Config.model_fields.values())
    assert entries["paper", "edge"].value == 0.1 and entries["paper", "edge"].default == Config().paper.edge
    assert entries["paper", "max_turn"].source == "III-D" and entries["paper", "max_turn"].unit == "rad"


def test_what_a_file_leaves_out_keeps_its_default(tmp_path):
    path = tmp_path / "config.yaml"
    for text in ("", "# nothing\n", "paper: {max_steps: 48}\n"):
        path.write_text(text)
        config = read_config(path)
        assert config.paper.edge == Config().paper.edge
        assert config.keyframes == Config().keyframes
    assert config.paper.max_steps == 48


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("densify: [1", ["not valid YAML"]),
        ("just words", ["must map sections"]),
        ("- densify", ["must map sections"]),
        ("densfy: {max_steps: 1}", ["no section 'densfy'", "densify"]),
        ("7: {max_steps: 1}", ["no section '7'"]),
        ("densify: 3", ["section 'densify' must map"]),
        ("paper: {max_step: 1}", ["paper.max_step", "no such parameter", "max_steps"]),
        ("densify: {3: 1}", ["densify.3", "no such parameter"]),
        ("paper: {max_steps: many}", ["paper.max_steps", "integer", "'many'"]),
        ("paper: {max_steps: 0}", ["paper.max_steps", "greater than or equal to 1", "got 0"]),
        ("paper: {max_turn: 2.0}", ["paper.max_turn", "less than"]),
        ("paper: {edge: .nan}", ["paper.edge", "finite"]),
        ("paper: {edge: .inf}", ["paper.edge", "finite"]),
        ("paper: {edge: null}", ["paper.edge", "number"]),
        ("cues: {orthographic: perhaps}", ["cues.orthographic", "boolean"]),
        ("patchmatch: {sweeps: [1, x]}", ["patchmatch.sweeps.1", "integer"]),
        ("patchmatch: {sweeps: 3}", ["patchmatch.sweeps", "tuple"]),
        ("patchmatch: {seed: -1}", ["patchmatch.seed"]),
        ("patchmatch: {trials: [4]}", ["patchmatch", "one number for each level"]),
        ("stereo: {depth_min: 5, depth_max: 1}", ["stereo", "depth_min must be below depth_max"]),
        ("!!python/object/apply:os.system [echo]", ["not valid YAML"]),
    ],
)
def test_what_is_wrong_in_a_file_is_said_in_one_line(tmp_path, text, words):
    path = tmp_path / "config.yaml"
    path.write_text(text)
    message = problem(read_config, path)
    assert message.startswith(str(path))
    for word in words:
        assert word in message


def test_a_missing_or_binary_file_is_named(tmp_path):
    assert "config.yaml" in problem(read_config, tmp_path / "config.yaml")
    (tmp_path / "binary.yaml").write_bytes(b"\xff\xfe\x00")
    assert "binary.yaml" in problem(read_config, tmp_path / "binary.yaml")


@pytest.mark.parametrize(
    ("setting", "words"),
    [
        ("paper.max_steps", ["section.name=value"]),
        ("max_steps=3", ["section.name=value"]),
        ("=3", ["section.name=value"]),
        (".max_steps=3", ["section.name=value"]),
        ("densify.=3", ["section.name=value"]),
        ("paper.max_step=3", ["no parameter paper.max_step"]),
        ("densfy.max_steps=3", ["no parameter densfy.max_steps"]),
        ("paper.max_steps=[", ["not valid YAML"]),
        ("paper.max_steps=", ["paper.max_steps", "None"]),
        ("paper.max_steps=-2", ["paper.max_steps", "-2"]),
    ],
)
def test_what_is_wrong_in_a_setting_is_said_in_one_line(setting, words):
    message = problem(Config().with_settings, [setting])
    assert message.startswith("--set")
    for word in words:
        assert word in message


def test_settings_are_yaml_and_the_last_one_counts():
    config = Config().with_settings(
        ["paper.max_steps=3", " paper.max_steps = 5", "stereo.depth_min=0.4", "stereo.depth_min=null"]
    )
    assert config.paper.max_steps == 5 and config.stereo.depth_min is None
    assert Config().with_settings([]) == Config()


@settings(deadline=None, max_examples=200, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(text=st.text(max_size=60))
def test_any_text_gives_a_config_or_one_line(text, tmp_path):
    path = tmp_path / "config.yaml"
    path.write_text(text, encoding="utf-8")
    try:
        assert isinstance(read_config(path), Config)
    except InputError as error:
        assert "\n" not in str(error)


@pytest.mark.parametrize("text", ["2001-99-99", "[" * 5000])
def test_yaml_that_yaml_itself_trips_over_is_bad_input(text):
    problem(Config().with_settings, [f"paper.max_steps={text}"])


def test_a_value_is_not_repeated_at_any_length():
    rows = ["&a0 [1, 1, 1, 1, 1, 1, 1, 1]"]
    rows += [f"&a{i} [{', '.join([f'*a{i - 1}'] * 8)}]" for i in range(1, 4)]
    problem(Config.from_mapping, yaml.safe_load("paper: {max_steps: [" + ", ".join(rows) + "]}"), "config.yaml")


def test_a_config_cannot_be_changed():
    with pytest.raises(ValueError, match="frozen"):
        Config().paper.max_steps = 3


class _Example(Options):
    share: float = parameter(0.5, "a share", "1", "II", ge=0, le=1)


def test_options_tell_what_is_wrong_with_a_value():
    assert _Example(share=1).share == 1.0
    assert problem(lambda: _Example(share=2)) == "share: input should be less than or equal to 1, got 2"
    assert problem(lambda: _Example(chare=1)) == "chare: there is no such parameter; known are share"
    field = _Example.model_fields["share"]
    assert field.description == "a share" and field.json_schema_extra == {"unit": "1", "source": "II"}


@pytest.mark.parametrize(
    ("old", "today"),
    [
        ("densify.max_steps", "paper.max_steps"),
        ("consistency.max_cost", "consistency.min_score, which is 1 - max_cost"),
        ("inliers.max_cost_unseen", "inliers.min_score_unseen, which is 1 - max_cost_unseen"),
    ],
)
def test_a_parameter_of_an_earlier_version_says_what_it_is_called_now(old, today):
    section, name = old.split(".")
    for read in (lambda: Config().with_settings([f"{old}=1"]), lambda: Config.from_mapping({section: {name: 1}}, "c")):
        with pytest.raises(InputError, match=f"{old} is now {today}$"):
            read()
