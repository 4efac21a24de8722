"""The gate on the rendered living room: density and accuracy of every stage, and the number of keyframes."""

from __future__ import annotations

import numpy as np
import pytest

from polarmap.evaluation.metrics import depth_metrics, mean_metrics
from polarmap.io.recording.sequence import open_sequence
from polarmap.pipeline.mapper import Mapper

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def evaluated(shared_data):
    """Metrics of the stages over the first 24 frames, and the keyframes' indices."""
    sequence = open_sequence(shared_data / "livingroom")
    stages: dict[str, list] = {"stereo": [], "inliers": [], "final": [], "half": []}
    indices = []

    def judge(keyframe):
        truth = sequence.truth_depth(keyframe.index)
        surest = np.argsort(-keyframe.confidence.ravel(), kind="stable")[: int(0.535 * truth.size)]
        half = np.full(truth.size, np.nan, np.float32)
        half[surest] = keyframe.depth.ravel()[surest]
        depths = (keyframe.stages.stereo, keyframe.stages.inliers, keyframe.depth, half.reshape(truth.shape))
        for name, depth in zip(stages, depths, strict=True):
            stages[name].append(depth_metrics(depth, truth))
        indices.append(keyframe.index)

    mapper = Mapper(sequence.camera_file, sequence.truth_trajectory(), on_keyframe=judge)
    for frame in sequence[:24]:
        mapper.process(frame)
    mapper.finish()
    return {name: mean_metrics(metrics) for name, metrics in stages.items()}, indices


def test_keyframes(evaluated):
    assert 5 <= len(evaluated[1]) <= 9


def test_stereo_alone(evaluated):
    stereo = evaluated[0]["stereo"]
    assert stereo.density > 0.45 and stereo.abs_rel < 0.035 and stereo.within > 0.38


def test_inliers_are_more_accurate(evaluated):
    stages = evaluated[0]
    assert stages["inliers"].abs_rel < 0.022 < 0.05
    assert stages["inliers"].abs_rel < stages["stereo"].abs_rel


def test_the_paper_is_beaten_on_both_counts(evaluated):
    final = evaluated[0]["final"]
    assert final.density > 0.95  # the paper: 0.53
    assert final.abs_rel < 0.042  # the paper: 0.060
    assert final.within > 0.68


def test_the_surest_half_is_as_accurate_as_offline_stereo(evaluated):
    half = evaluated[0]["half"]
    assert half.abs_rel < 0.022 and half.within > 0.43
