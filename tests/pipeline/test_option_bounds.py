"""Every numeric option has bounds on both sides, and a map comes of every value within them, or one line."""

from __future__ import annotations

import math
import random

import pytest
from option_walk import all_options, ends, extremes, is_numeric, walk

from polarmap.errors import InputError
from polarmap.pipeline.config import Config

ALL = {str(extreme): extreme for extreme in extremes()}
NUMERIC = [(kind, name) for kind in all_options() for name, field in kind.model_fields.items() if is_numeric(field)]
ONCE_WRONG = (
    "patchmatch.colour_sigma", "stereo.depth_min", "stereo.depth_max", "consistency.min_region", "cues.vote_radius",
    "fusion.min_weight", "patchmatch.seed", "patchmatch.trials",
)  # fmt: skip


def sample() -> list[str]:
    """Both ends of the options that once failed, and some of the others."""
    known = [name for name in ALL if name.split("=")[0] in ONCE_WRONG]
    others = [name for name in ALL if name not in known and not name.startswith("odometry.")]
    return [*known, "odometry.huber=20", *random.Random(5).sample(others, 4)]


@pytest.mark.parametrize(("kind", "name"), NUMERIC, ids=[f"{kind.__name__}.{name}" for kind, name in NUMERIC])
def test_a_numeric_option_has_finite_bounds_on_both_sides(kind, name):
    field = kind.model_fields[name]
    low, high = ends(field)
    values = [*low, *high] if isinstance(low, tuple) else [low, high]
    assert all(math.isfinite(value) for value in values)
    assert all(abs(value) <= 2**31 and (value == 0 or abs(value) >= 1e-6) for value in values)
    if field.annotation in (int, float) and not field.is_required():
        assert low <= field.default <= high and low < high


@pytest.mark.parametrize("value", [1e-300, 1e308, 2**63 - 1, -1e308, -(2**63)])
def test_extreme_values_are_refused_in_one_line(value):
    for section, part in Config.model_fields.items():
        for name, field in part.annotation.model_fields.items():
            low, high = ends(field) if is_numeric(field) else (None, None)
            if isinstance(low, int | float) and not low <= value <= high:
                with pytest.raises(InputError) as caught:
                    Config.from_mapping({section: {name: value}}, "config.yaml")
                assert f"{section}.{name}" in str(caught.value) and "\n" not in str(caught.value)


@pytest.mark.slow
@pytest.mark.parametrize("name", sample())
def test_a_value_at_the_end_of_its_range_maps_a_tiny_scene(name):
    outcome = walk(ALL[name])
    assert outcome.startswith("refused") or "keyframes" in outcome or "posed" in outcome
