"""The pictures of a keyframe show its arrays."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from run_samples import sample_image, sample_keyframe, write_run
from scenes import TYPICAL, WIDE, polarization_of, view_of

from polarmap.data.keyframe import Keyframe
from polarmap.geometry.surface import zenith_of
from polarmap.io.formats.images import read_colours
from polarmap.io.run_folder.folder import read_keyframes
from polarmap.polarization.alone import clearly_polarized
from polarmap.polarization.cues import disambiguate
from polarmap.report import pictures
from polarmap.report.keyframe_pictures import PICTURES, keyframe_pictures, picture_ranges


def keyframe_of_a_sphere() -> Keyframe:
    """A noisy matte sphere, cues made unambiguous by the true normals; the map's own normals all face the camera."""
    truth = view_of("sphere", "matte")
    image = polarization_of(truth, TYPICAL, seed=1)
    cues = disambiguate(image, truth.normal, WIDE)
    shape = truth.depth.shape
    flat = np.broadcast_to(np.float32([0, 0, -1]), (*shape, 3))
    arrays = {"origin": np.zeros(shape, np.uint8), "confidence": np.ones(shape, np.float32), "sigma": truth.depth}
    stated = {"azimuth": cues.azimuth, "zenith": cues.zenith, "label": cues.label}
    return replace(
        sample_keyframe(0, np.ones((48, 64), np.float32)),
        camera=WIDE, image=image, depth=truth.depth, normal=flat, **arrays, **stated,
    )  # fmt: skip


def test_every_picture_has_the_size_of_the_camera():
    keyframe = keyframe_of_a_sphere()
    drawn = keyframe_pictures(keyframe, picture_ranges(keyframe))
    assert drawn.keys() == PICTURES.keys()
    assert {picture.shape for picture in drawn.values()} == {(*WIDE.shape, 3)}


def test_normals_of_polarization_are_pictured_beside_those_of_the_map():
    keyframe = keyframe_of_a_sphere()
    drawn = keyframe_pictures(keyframe, picture_ranges(keyframe))
    truth = view_of("sphere", "matte").normal
    known = np.isfinite(keyframe.azimuth) & clearly_polarized(keyframe.image)
    assert (drawn["polarnormal"][~known] == pictures.MISSING).all()
    tilted = known & (zenith_of(truth, WIDE) > 0.5)
    off = np.abs(drawn["polarnormal"].astype(int) - pictures.normals(truth)).max(axis=-1)
    assert tilted.sum() > 400 and np.median(off[tilted]) < 15
    assert np.median(np.abs(drawn["normal"].astype(int) - pictures.normals(truth)).max(axis=-1)[tilted]) > 40
    turned = replace(keyframe, azimuth=keyframe.azimuth + np.float32(np.pi / 2))
    other = keyframe_pictures(turned, picture_ranges(turned))
    assert np.abs(other["polarnormal"].astype(int) - drawn["polarnormal"])[tilted].max(axis=-1).mean() > 40
    np.testing.assert_array_equal(other["normal"], drawn["normal"])


def test_an_orthographic_run_has_orthographic_normals():
    keyframe = keyframe_of_a_sphere()
    perspective, orthographic = (
        keyframe_pictures(keyframe, picture_ranges(keyframe), flag)["polarnormal"].astype(int) for flag in (False, True)
    )
    assert np.abs(perspective - orthographic).max() > 20


def test_a_run_writes_the_picture_and_replaces_it(tmp_path):
    shape = (48, 64)
    clear = replace(sample_image(), dolp=np.full(shape, 0.5, np.float32), sigma_dolp=np.full(shape, 0.01, np.float32))
    zenith = np.repeat(np.linspace(0.0, 1.5, 48, dtype=np.float32)[:, None], 64, axis=1)
    keyframe = sample_keyframe(3, np.ones(shape, np.float32), image=clear, zenith=zenith)
    for _ in range(2):
        out = write_run(tmp_path, [keyframe], force=True)
    read = next(iter(read_keyframes(out)))
    assert read.index == 3
    path = out / "pictures" / "000003_polarnormal.jpg"
    written = read_colours(path, 48 * 64)[..., ::-1].astype(int)
    expected = keyframe_pictures(keyframe, picture_ranges(keyframe))["polarnormal"]
    assert np.abs(written - expected).mean() < 4
    assert "made unambiguous by the map" in (out / "report.html").read_text()
