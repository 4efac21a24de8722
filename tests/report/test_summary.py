"""What a run says of itself in the end: few lines, the worst first, and silence about what is well."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from run_samples import CAMERA

from polarmap.io.run_folder.results import (
    Intrinsics,
    KeyframeSummary,
    MapSummary,
    RunResults,
    SearchSummary,
    SegmentSummary,
    Weights,
)
from polarmap.pipeline.poses.fit import PoseFit
from polarmap.report.summary import MOST_LINES, Evidence, summarize

PIXELS = CAMERA.width * CAMERA.height
OUT = Path("out")


def keyframe(index=0, stereo=PIXELS // 5, verdict="polarnet accepted (rank correlation 0.9)", depth=2.5):
    return KeyframeSummary(
        index=index,
        timestamp=index / 30,
        points=PIXELS,
        density=1.0,
        stereo=stereo,
        propagated=0,
        estimated=0,
        diffuse=0,
        specular=0,
        beyond_png=0,
        prior_verdict=verdict,
        diffuse_weights=Weights(azimuth=0, zenith=0),
        specular_weights=Weights(azimuth=0, zenith=0),
        milliseconds={},
        median_depth=depth,
    )


def mapped(faces=1200):
    return MapSummary(voxel_size=0.01, blocks=3, vertices=faces, faces=faces, points=faces)


def results(**changes) -> RunResults:
    """Of a good run of 36 frames at 30 Hz in six seconds."""
    camera = Intrinsics(width=CAMERA.width, height=CAMERA.height, fx=60, fy=60, cx=31.5, cy=23.5)
    values = {
        "status": "complete",
        "poses": "given",
        "started": "2024-01-01T00:00:00+00:00",
        "seconds": 6.0,
        "camera": camera,
        "frames": 36,
        "posed": 36,
        "recorded_seconds": 1.2,
        "path_length": 0.6,
        "milliseconds": {},
        "map": mapped(),
        "versions": {},
        "machine": "",
        "cpu_count": 2,
        "keyframes": [keyframe(i) for i in range(6)],
    }
    return RunResults(**(values | changes))


NOTHING = Evidence()


def lines(evidence=NOTHING, **changes):
    found = summarize(results(**changes), OUT, evidence)
    assert 0 < len(found) <= MOST_LINES
    order = [("error", "warning", "note").index(line.level) for line in found]
    assert order == sorted(order)
    return found


def warnings(*arguments, **changes):
    return [line.text for line in lines(*arguments, **changes) if line.level != "note"]


RIGHT = PoseFit(0.1, 0.75)


def test_a_good_run_says_how_fast_and_where():
    pace, places = (line.text for line in lines(Evidence(RIGHT)))
    assert re.match(r"6 keyframes of 36 frames, stereo defends \d+ % of their pixels, 1200 triangles;", pace)
    assert "0.2 of real time" in pace
    assert places == "report: out/report.html; mesh: out/mesh.ply"


def test_frames_without_a_pose_are_counted_by_reason():
    (text,) = warnings(posed=12, without_pose={"no pose is given at its time": 20, "a gap": 4})
    assert text == "24 of 36 frames are not used: no pose is given at its time (20), a gap (4)"


def test_frames_that_were_kept_from_being_keyframes_are_counted():
    (text,) = warnings(unfit={"the picture is black": 2, "it is torn": 1})
    assert text == (
        "3 of 36 frames with a pose were kept from being keyframes: the picture is black (2), it is torn (1)"
    )


def test_many_reasons_are_cut_short():
    (text,) = warnings(posed=0, without_pose={f"reason {i}": 9 - i for i in range(6)}, frames=39)
    assert text.endswith("reason 0 (9), reason 1 (8), reason 2 (7), other reasons (15)")


def test_odometry_may_need_some_frames_to_start():
    changes = {"poses": "odometry", "posed": 30, "without_pose": {"waiting for parallax": 6}}
    assert not warnings(**changes)
    assert any("6 of 36 frames have no pose" in line.text for line in lines(**changes))
    assert warnings(**changes | {"posed": 20, "without_pose": {"lost": 16}})
    two = [SegmentSummary(segment=i, posed=15, keyframes=3, map=mapped()) for i in range(2)]
    assert warnings(**changes, segments=two)


@pytest.mark.parametrize(
    ("verdict", "why"),
    [
        (
            "midas rejected: inverted (rank correlation -0.90, 210 anchors); interpolated from 210 sparse points",
            "inverted",
        ),
        ("midas rejected: not finite (12 anchors); no prior: 2 sparse points, 3 are needed", "not finite"),
        ("no prior: 2 sparse points, 3 are needed", "too few stereo points"),
    ],
)
def test_a_rejected_prior_is_told_with_the_reason(verdict, why):
    (text,) = warnings(keyframes=[keyframe(i, verdict=verdict) for i in range(6)])
    assert "rejected in 6 of 6 keyframes" in text and f"{why} (6)" in text
    assert ("midas" in text) == verdict.startswith("midas")


def test_one_rejection_among_many_is_a_note():
    bad = keyframe(0, verdict="midas rejected: poor fit (rank correlation 0.1, 30 anchors)")
    changes = {"keyframes": [bad, *(keyframe(i) for i in range(1, 9))]}
    assert not warnings(**changes)
    assert any("rejected in 1 of 9 keyframes" in line.text for line in lines(**changes))


def piled(count, of=10, **ends):
    """Keyframes, of which the first few have depths at an end of the range."""
    usual = {"near": 0.31, "far": 70.0, "at_near": 0.0001, "at_far": 0.0}
    searches = [SearchSummary(**(usual | (ends if i < count else {}))) for i in range(of)]
    return [keyframe(i).model_copy(update={"search": search}) for i, search in enumerate(searches)]


def test_depths_that_pile_up_at_the_near_end_are_told():
    (text,) = warnings(keyframes=piled(7, at_near=0.2))
    assert text.startswith("in 7 of 10 keyframes stereo's depths pile up at the near end of the range (0.31 m)")
    assert "nearer" in text and "--set stereo.depth_min=0.155" in text


def test_depths_that_pile_up_at_the_far_end_are_told():
    (text,) = warnings(keyframes=piled(7, at_far=0.2), poses="odometry")
    assert text.startswith("in 7 of 10 keyframes stereo's depths pile up at the far end of the range (70)")
    assert "farther" in text and "--set stereo.depth_max=140" in text


def test_ends_that_differ_are_told_from_which_to_which():
    keyframes = [*piled(3, 5, at_near=0.2, near=0.5), *piled(3, 5, at_near=0.2, near=0.8)]
    (text,) = warnings(keyframes=keyframes)
    assert "in 6 of 10" in text and "(0.5 to 0.8 m)" in text and "depth_min=0.25" in text


def test_few_keyframes_and_small_shares_at_an_end_are_no_reason():
    assert not warnings(keyframes=piled(1, at_near=0.2, at_far=0.2))
    assert not warnings(keyframes=piled(10, at_near=0.006, at_far=0.006))
    assert not warnings(keyframes=results().keyframes)  # of which it is not known where stereo searched


def poor(count=6):
    return [keyframe(i, stereo=PIXELS // 300) for i in range(count)]


def test_a_reading_that_fits_is_named_however_much_stereo_finds():
    fit = PoseFit(3.0, 0.75, "when taken as 0.18 s earlier than their times say", 0.1)
    for keyframes in (poor(), results().keyframes):
        (text,) = warnings(Evidence(fit), keyframes=keyframes)
        assert text.startswith("stereo and poses disagree") and "0.18 s earlier" in text and "clock" in text


def test_poses_that_fit_in_no_way_are_suspected():
    (text,) = warnings(Evidence(PoseFit(float("inf"), 0.75)), keyframes=poor())
    for word in ("stereo and poses disagree", "0.33 %", "behind the camera", "world-to-camera", "clock", "intrinsics"):
        assert word in text
    assert not warnings(Evidence(PoseFit(1.0, 0.75))), "inexact poses with which stereo works are not"


def test_little_stereo_with_right_poses_points_at_the_pictures():
    (text,) = warnings(Evidence(RIGHT), keyframes=poor())
    for word in ("stereo finds next to nothing", "depth_min", "blur", "colour", "the poses fit"):
        assert word in text
    (text,) = warnings(keyframes=poor(), poses="odometry")
    assert "intrinsics" in text and "world-to-camera" not in text
    (text,) = warnings(keyframes=poor())
    assert "world-to-camera" in text and "blur" in text


@pytest.mark.parametrize(
    ("changes", "sign"),
    [
        (
            {"path_length": 600.0, "keyframes": [keyframe(depth=2500.0)]},
            "median depth is 2.5e+03 m and the camera moves",
        ),
        ({"keyframes": [keyframe(depth=0.0025)]}, "median depth is 0.0025 m"),
        ({"path_length": 600.0}, "moves at 500 m/s"),
    ],
)
def test_a_unit_that_is_hardly_the_metre(changes, sign):
    (text,) = warnings(**changes)
    assert "unit of the poses" in text and sign in text and "millimetres" in text
    assert not warnings(**changes, poses="odometry")


def test_no_surface_is_the_first_line():
    found = lines(
        Evidence(mosaic="looks like a colour sensor's; set colour"), status="failed", map=mapped(0), keyframes=poor()
    )
    assert (found[0].level, found[0].text.split(":")[0]) == ("error", "nothing was mapped")
    assert found[1].text.startswith("looks like a colour")
    for changes, why in (({"posed": 0}, "no frame has a pose"), ({"keyframes": []}, "no keyframe")):
        assert why in lines(**changes, status="failed", map=None)[0].text
    blind = [keyframe().model_copy(update={"points": 0, "median_depth": None, "stereo": 0})]
    assert "none of the 1 keyframes got any depth" in lines(keyframes=blind, map=mapped(0))[0].text


def test_surfaces_of_other_segments_count():
    segments = [SegmentSummary(segment=i, posed=18, keyframes=3, map=mapped(9 * i)) for i in range(2)]
    assert not [line for line in lines(map=mapped(0), segments=segments, poses="odometry") if line.level == "error"]


def test_an_interrupted_run_is_not_blamed_for_its_map():
    assert not warnings(status="interrupted", map=None)


def test_never_more_than_six_lines():
    bad = keyframe(stereo=0, verdict="midas rejected: inverted (1)", depth=4000.0)
    evidence = Evidence(PoseFit(9.0, 0.75), "the mosaic looks like a colour sensor's")
    found = lines(evidence, status="failed", posed=9, map=mapped(0), keyframes=[bad], without_pose={"a gap": 27})
    assert len(found) == MOST_LINES
    assert "report: out/report.html" in found[-1].text and "keyframes of 36 frames" in found[-1].text


def test_without_times_there_is_no_pace():
    assert "real time" not in " ".join(line.text for line in lines(recorded_seconds=None))


def test_places_that_are_no_text_are_shown_all_the_same():
    found = summarize(results(), Path("out-\udcff"))
    assert found[-1].text.encode() and "out-\\xff/report.html" in found[-1].text
