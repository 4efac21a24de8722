"""polarmap synth rgbd as a user meets it: what it writes, that the other commands read it, and what it refuses."""

from __future__ import annotations

import json

import cv2
import numpy as np
import pytest
import rgbd_folders as folders
import yaml
from command_line import refused

from polarmap.io.formats.images import read_image
from polarmap.io.recording.sequence import open_sequence


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    """Twelve frames of the room in Replica's form."""
    return folders.write_replica(tmp_path_factory.mktemp("rgbd") / "room0")


def test_a_recording_becomes_a_sequence_that_run_and_eval_read(polarmap, recording, tmp_path):
    sequence, out = tmp_path / "sequence", tmp_path / "out"
    status, printed, _ = polarmap("synth", "rgbd", recording, sequence, "--model", "fresnel", "--surround", "0.5")
    assert status == 0
    assert "12 frames of replica" in printed and "mm (median)" in printed and "sequence" in printed
    assert {path.name for path in sequence.iterdir()} == {
        "camera.yaml", "raw", "depth", "normal", "timestamps.txt", "groundtruth.txt", "synth.yaml"
    }  # fmt: skip
    status, *_ = polarmap("inspect", sequence)
    assert status == 0
    run = ("--out", out, "--set", "fusion.min_faces=0")
    status, _, error = polarmap("run", sequence, "--poses", sequence / "groundtruth.txt", *run)
    assert status == 0, error
    assert json.loads((out / "results.json").read_text())["frames"] == 12
    status, *_ = polarmap("eval", out, sequence)
    assert status == 0


def test_every_option_reaches_the_files(polarmap, recording, tmp_path):
    out = tmp_path / "out"
    options = {"model": "blinn-phong", "format": "replica", "frames": "1:9:4", "light": "0.1,-0.2,0.3", "ambient": 0.5,
               "specular": 0.6, "shininess": 12, "eta": 1.4, "bits": 10, "full-well": 5000, "read-noise": 4,
               "exposure": 0.5, "extinction": 200, "shutter": 0.5, "seed": 7}  # fmt: skip
    arguments = [text for key, value in options.items() for text in (f"--{key}", value)]
    status, *_ = polarmap("synth", "rgbd", recording, out, *arguments, "--sub-pixel")
    assert status == 0
    values = yaml.safe_load((out / "synth.yaml").read_text())
    assert values["model"] == {"name": "blinn-phong", "light": [0.1, -0.2, 0.3], "ambient": 0.5, "specular": 0.6,
                               "shininess": 12.0, "eta": 1.4}  # fmt: skip
    assert values["sensor"] == {
        "layout": [90, 45, 135, 0], "angle_direction": "clockwise", "bit_depth": 10, "exposure": 0.5,
        "noise": {"full_well": 5000.0, "read_noise": 4.0}, "sub_pixel": True, "extinction_ratio": 200.0,
        "shutter": 0.5, "seed": 7
    }  # fmt: skip
    assert (values["first_picture"], values["last_picture"]) == ("frame000001.jpg", "frame000005.jpg")
    sequence = open_sequence(out)
    assert len(sequence) == 2 and sequence.camera_file.bit_depth == 10 and sequence.camera_file.demosaic == "bilinear"
    assert sequence[0].mosaic.shape == (60, 80) and sequence.camera_file.camera.width == 40


def test_the_same_command_writes_the_same_files_and_a_seed_others(polarmap, recording, tmp_path):
    for name, seed in (("a", 0), ("b", 0), ("c", 1)):
        assert polarmap("synth", "rgbd", recording, tmp_path / name, "--frames", ":2", "--seed", seed)[0] == 0
    files = sorted(path.relative_to(tmp_path / "a") for path in (tmp_path / "a").rglob("*") if path.is_file())
    assert len(files) == 10
    for file in files:
        assert (tmp_path / "a" / file).read_bytes() == (tmp_path / "b" / file).read_bytes()
    raw = "raw/000000.png"
    assert (tmp_path / "a" / raw).read_bytes() != (tmp_path / "c" / raw).read_bytes()


def test_clean_is_without_noise_in_sixteen_bits(polarmap, recording, tmp_path):
    for name, seed in (("a", 0), ("b", 1)):
        arguments = ("--frames", "0:1", "--clean", "--seed", seed)
        assert polarmap("synth", "rgbd", recording, tmp_path / name, *arguments)[0] == 0
    a, b = (read_image(tmp_path / name / "raw" / "000000.png", bits=16) for name in "ab")
    np.testing.assert_array_equal(a, b)
    diagonal = a[0::2, 1::2].astype(int) + a[1::2, 0::2]  # 45 and 135 degrees
    straight = a[0::2, 0::2].astype(int) + a[1::2, 1::2]
    unclipped = a.reshape(60, 2, 80, 2).max(axis=(1, 3)) < 65535
    assert np.abs(diagonal - straight)[unclipped].max() <= 2


def test_frames_without_a_pose_are_counted(polarmap, tmp_path):
    folder = folders.write_icl(tmp_path / "icl")
    camera = folders.write_intrinsics(folder)
    status, printed, _ = polarmap("synth", "rgbd", folder, tmp_path / "out", "--camera", camera, "--clean")
    assert status == 0 and "11 frames of icl; 1 without a pose left out" in printed


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--format", "tum"], ["groundtruth.txt", "no such file"]),
        (["--frames", "5"], ["--frames", "A:B"]),
        (["--frames", "0:5:0"], ["--frames"]),
        (["--frames", "90:99"], ["no frames"]),
        (["--light", "1,2"], ["--light", "X,Y,Z"]),
        (["--light", "1,2,nan"], ["light"]),
        (["--gloss", "0.5"], ["--gloss", "blinn-phong"]),
        (["--model", "fresnel", "--specular", "1"], ["--specular", "fresnel"]),
        (["--eta", "0.9"], ["eta"]),
        (["--bits", "9"], ["--bits", "8, 10, 12 and 16"]),
        (["--full-well", "0"], ["full_well"]),
        (["--read-noise", "-1"], ["read_noise"]),
        (["--exposure", "0"], ["exposure"]),
        (["--extinction", "1"], ["extinction"]),
        (["--shutter", "2"], ["shutter"]),
        (["--seed", "-1"], ["seed"]),
        (["--clean", "--shutter", "0.5"], ["--clean", "--shutter"]),
        (["--camera", "nothing.json"], ["nothing.json", "no such file"]),
    ],
)
def test_bad_options_are_one_clear_line_and_nothing_is_written(polarmap, recording, tmp_path, arguments, words):
    refused(polarmap("synth", "rgbd", recording, tmp_path / "out", *arguments), *words)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("option", ["--format", "--model"])
def test_a_word_that_is_no_choice_is_refused_with_the_option(polarmap, recording, tmp_path, option):
    ended = polarmap("synth", "rgbd", recording, tmp_path / "out", option, "kitti")
    assert ended.status == 2 and option in ended.err
    assert not (tmp_path / "out").exists()


def test_a_folder_in_use_is_kept(polarmap, recording, tmp_path):
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "notes.txt").write_text("mine")
    refused(polarmap("synth", "rgbd", recording, tmp_path / "out", "--force"), "not empty, and not made by")
    refused(polarmap("synth", "rgbd", recording, tmp_path / "out" / "notes.txt"), "is a file")
    assert (tmp_path / "out" / "notes.txt").read_text() == "mine"


def test_a_recording_is_never_written_into(polarmap, recording):
    before = sorted(recording.rglob("*"))
    refused(polarmap("synth", "rgbd", recording, recording, "--force"), "not empty, and not made by")
    assert sorted(recording.rglob("*")) == before


def test_a_source_that_breaks_off_is_named(polarmap, tmp_path):
    refused(polarmap("synth", "rgbd", tmp_path / "none", tmp_path / "out"), "none", "no such folder")
    folder = folders.write_replica(tmp_path / "room")
    depth = folder / "results" / "depth000007.png"
    depth.write_bytes(depth.read_bytes()[:-30])
    refused(polarmap("synth", "rgbd", folder, tmp_path / "out"), "depth000007.png", "truncated")


def test_twelve_bit_pictures_of_the_real_office_have_clean_polarization(polarmap, shared_data, tmp_path):
    """On walls the angle of polarization varies smoothly: rounded depth leaves no mark."""
    out = tmp_path / "out"
    arguments = ("--frames", "100:102", "--clean")
    assert polarmap("synth", "rgbd", shared_data / "icl_office_kt0", out, *arguments)[0] == 0
    mosaic = cv2.imread(str(out / "raw" / "000000.png"), cv2.IMREAD_UNCHANGED).astype(float)
    s1 = mosaic[1::2, 1::2] - mosaic[::2, ::2]
    s2 = mosaic[::2, 1::2] - mosaic[1::2, ::2]
    wall = np.s_[260:330, 420:600]  # right of the coat rack, above the picture
    turn = np.unwrap(np.arctan2(s2, s1)[wall], axis=1) / 2
    assert np.degrees(np.abs(np.diff(turn, axis=1))).mean() < 0.5
