"""The report page, its plots, and the pictures of the map."""

from __future__ import annotations

import json
import re
import zlib
from html.parser import HTMLParser

import cv2
import numpy as np
import pytest
from run_samples import CAMERA, pose_at, sample_keyframe, sample_map, true_depth, write_run, write_sequence

from polarmap.data.mesh import Mesh
from polarmap.errors import InputError
from polarmap.evaluation.evaluate_run import evaluate_run
from polarmap.evaluation.records import write_evaluation
from polarmap.evaluation.truth import truth_of
from polarmap.geometry.pose import look_at
from polarmap.io.run_folder.folder import read_results
from polarmap.pipeline.config import Config
from polarmap.report import html, plots
from polarmap.report.html import write_report
from polarmap.report.preview import PATH_COLOUR, render_map, render_view
from polarmap.report.run_writer import RunWriter


class Page(HTMLParser):
    """Collects what a page refers to, and its text."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.links: list[str] = []
        self.tags: list[str] = []
        self.text = ""
        self.feed(page)

    def handle_starttag(self, tag, attributes):
        self.tags.append(tag)
        self.links += [value for name, value in attributes if name in ("src", "href", "xlink:href")]

    def handle_data(self, data):
        self.text += data


def read_page(out):
    return Page((out / "report.html").read_text())


def write_keyframes(out, count, **options):
    return write_run(out, [sample_keyframe(i, true_depth(i)) for i in range(count)], **options)


def test_the_page_needs_no_other_file(tmp_path):
    page = read_page(write_keyframes(tmp_path, 3))
    assert len([link for link in page.links if link.startswith("data:image/jpeg;base64,")]) == 3 * 9 + 2 + 1
    assert all(link.startswith(("data:", "#")) for link in page.links)
    assert "link" not in page.tags
    assert page.tags.count("svg") == 2
    for expected in (
        "complete",
        "keyframes of 3 frames",
        "96.9 %",
        "0.15 s",
        "mesh triangles",
        "densify:",
        "onnxruntime",
    ):
        assert expected in page.text


def test_foreign_text_is_escaped(tmp_path):
    hostile = "<script>alert(1)</script>"
    page = read_page(write_keyframes(tmp_path, 1, sequence=hostile, command=hostile, pose_source=hostile))
    assert page.tags.count("script") == 1  # the page's own
    assert page.text.count(hostile) >= 3
    assert "sparse: <b>interpolated</b> & good" in page.text


def test_many_keyframes_are_sampled_evenly(tmp_path):
    out = write_keyframes(tmp_path, 7)
    write_report(out, max_pictured=4)
    page = read_page(out)
    assert "4 of 7 keyframes, evenly sampled" in page.text
    assert re.findall(r"frame(\d)\s*density", page.text) == ["0", "2", "4", "6"]


def test_the_page_stays_small(tmp_path, monkeypatch):
    out = write_keyframes(tmp_path, 6)
    whole = (out / "report.html").stat().st_size
    assert "evenly sampled" not in read_page(out).text
    monkeypatch.setattr(html, "_PICTURE_BYTES", 30_000)
    write_report(out)
    assert "of 6 keyframes, evenly sampled" in read_page(out).text
    assert (out / "report.html").stat().st_size < whole - 30_000


def test_an_evaluation_in_the_folder_is_shown(tmp_path):
    sequence = write_sequence(tmp_path / "seq")
    out = write_run(tmp_path / "out", [sample_keyframe(1, np.float32(1.01) * true_depth(1))], stages=True)
    write_evaluation(out / "evaluation.json", evaluate_run(out, truth_of(sequence)))
    write_report(out)
    text = " ".join(read_page(out).text.split())
    for expected in (
        "Against the truth",
        "0.0100",
        "first step of densification",
        "Accuracy of the most confident",
        "Scale: none",
    ):
        assert expected in text


def test_a_run_without_keyframes_has_a_report(tmp_path):
    with pytest.raises(KeyboardInterrupt), RunWriter(tmp_path, Config(), CAMERA):
        raise KeyboardInterrupt
    text = read_page(tmp_path).text
    assert "Ended by: KeyboardInterrupt" in text
    assert "keyframes of 0 frames" in text


def test_a_missing_or_broken_picture_is_left_out(tmp_path):
    out = write_keyframes(tmp_path, 1)
    (out / "pictures" / "000000_dolp.jpg").unlink()
    (out / "pictures" / "000000_aolp.jpg").write_bytes(b"no picture")
    write_report(out)
    assert len([link for link in read_page(out).links if link.startswith("data:")]) == 7 + 2 + 1
    assert "kind of reflection" in read_page(out).text


def test_a_report_needs_a_run(tmp_path):
    with pytest.raises(InputError, match=r"no results\.json"):
        write_report(tmp_path)


@pytest.mark.parametrize("count", [1, 2, 300])
def test_plots_are_the_same_for_the_same_run(tmp_path, count):
    summary = read_results(write_keyframes(tmp_path, 1)).keyframes[0]
    summaries = [summary.model_copy(update={"index": 4 * i}) for i in range(count)]
    for plot in (plots.density_plot, plots.time_plot):
        svg = plot(summaries)
        assert svg.startswith("<svg")
        assert svg == plot(summaries)
        assert len(svg) < 200_000


FRONT = np.eye(3)  # looks along +z, right x, down y


def square(z, grey, flipped=False):
    """A square of side 2 that faces -z, or +z if flipped."""
    vertices = np.float32([[-1, -1, z], [1, -1, z], [1, 1, z], [-1, 1, z]])
    faces = np.int32([[0, 3, 2], [0, 2, 1]])
    normals = np.tile(np.float32([0, 0, 1 if flipped else -1]), (4, 1))
    return Mesh(vertices, faces[:, ::-1].copy() if flipped else faces, normals, np.full(4, grey, np.float32))


def joined(*meshes):
    faces = [m.faces + 4 * i for i, m in enumerate(meshes)]
    arrays = [np.concatenate([getattr(m, name) for m in meshes]) for name in ("vertices", "normals", "grey")]
    return Mesh(arrays[0], np.concatenate(faces), *arrays[1:])


def centre_of(mesh, R=FRONT):
    """Grey level in the picture's middle; the path lies in a corner."""
    picture = render_view(mesh, R, np.array([[-0.95, -0.95, 0.0]]), (80, 60))
    assert picture.shape == (60, 80, 3)
    assert (picture[-1] == 255).all()  # the margin
    return int(picture[30, 40, 0])


def test_surfaces_are_drawn_where_they_are():
    picture = render_view(square(2.0, 0.5), FRONT, np.array([[-0.95, -0.95, 0.0]]), (80, 60))
    drawn = (picture != 255).any(axis=-1)
    assert drawn[30].sum() == pytest.approx(0.92 * 60, abs=2)  # fitted to the height, square
    assert drawn[:, 40].sum() == pytest.approx(0.92 * 60, abs=2)


def test_the_nearer_surface_hides_the_other():
    bright, dark = square(3.0, 0.9), square(2.0, 0.1)
    assert centre_of(joined(bright, dark)) == centre_of(joined(dark, bright))
    swapped = joined(square(2.0, 0.9), square(3.0, 0.1))
    assert centre_of(joined(bright, dark)) < centre_of(swapped) - 50


def test_surfaces_are_not_seen_from_behind():
    assert centre_of(square(2.0, 0.5)) < 255
    assert centre_of(square(2.0, 0.5, flipped=True)) == 255


def test_the_top_view_shows_the_path_ahead_upward():
    ahead = np.array([look_at([x, 0.0, 0.0], [9.0, 0.0, 0.0]) for x in (0.0, 1.0, 2.0)])
    floor = Mesh(
        vertices=np.float32([[0, -1, -1], [4, -1, -1], [4, 1, -1], [0, 1, -1]]),
        faces=np.int32([[0, 1, 2], [0, 2, 3]]),
        normals=np.tile(np.float32([0, 0, 1]), (4, 1)),
        grey=np.full(4, 0.5, np.float32),
    )
    views = render_map(floor, ahead, (80, 120))
    rows, columns = np.nonzero((views["top"] == PATH_COLOUR).all(axis=-1))
    assert rows.max() > 105  # starts at the floor's near edge, at the bottom
    assert rows.min() == pytest.approx(60, abs=4)  # and ends in its middle
    assert columns.mean() == pytest.approx(39.5, abs=2)
    assert (views["outside"] != 255).any()


def test_cameras_that_look_all_around_are_no_problem():
    around = np.array([look_at([0, 0, 0], [np.cos(a), np.sin(a), 0]) for a in np.arange(4) * np.pi / 2])
    for picture in render_map(sample_map().mesh, around, (40, 30)).values():
        assert picture.shape == (30, 40, 3)
    assert render_map(sample_map().mesh, pose_at(0)[None], (40, 30))


def broken_pictures(kind):
    if kind == "empty":
        return b""
    if kind == "enormous":  # of what it claims to be, nothing is there
        header = b"IHDR" + (60_000).to_bytes(4, "big") * 2 + b"\x08\0\0\0\0"
        chunks = (len(header) - 4).to_bytes(4, "big") + header + zlib.crc32(header).to_bytes(4, "big")
        return b"\x89PNG\r\n\x1a\n" + chunks + b"\0\0\0\0IEND\xaeB`\x82"
    return cv2.imencode(".png", np.zeros((4000, 1000), np.uint8))[1].tobytes()


@pytest.mark.parametrize("kind", ["empty", "enormous", "larger than the camera's"])
def test_a_picture_that_cannot_be_shown_is_left_out_and_named(tmp_path, caplog, kind):
    out = write_keyframes(tmp_path, 1)
    pictures = len([link for link in read_page(out).links if link.startswith("data:")])
    (out / "pictures" / "000000_depth.jpg").write_bytes(broken_pictures(kind))
    write_report(out)
    assert len([link for link in read_page(out).links if link.startswith("data:")]) == pictures - 1
    assert "left out of the report" in caplog.text and "000000_depth.jpg" in caplog.text


def change_json(path, change):
    values = json.loads(path.read_text())
    change(values)
    path.write_text(json.dumps(values))


@pytest.mark.parametrize(
    ("name", "change"),
    [
        ("evaluation.json", lambda v: v["curve"]["abs_rel"].append(0.1)),
        ("evaluation.json", lambda v: v["curve"].update(density=[])),
        ("evaluation.json", lambda v: v["curve"].update(confidence=[0.5] * 1000)),
        ("evaluation.json", lambda v: v["curve"].update(density=[1e308] * len(v["curve"]["density"]))),
        ("results.json", lambda v: v["keyframes"][0].update(milliseconds={"$\\x$": 1.0})),
        ("results.json", lambda v: v["keyframes"][0].update(milliseconds={str(i): 1.0 for i in range(500)})),
        ("results.json", lambda v: v["keyframes"][0].update(milliseconds={"stereo": 1e308, "densify": 1e308})),
        ("results.json", lambda v: v["keyframes"][0].update(density=1e308)),
        ("results.json", lambda v: v["keyframes"][0].update(index=10**30)),
        ("results.json", lambda v: v["camera"].update(fx=-1.0)),
        ("results.json", lambda v: v["keyframes"][0].update(surfaces_weight="inf")),
        ("evaluation.json", lambda v: v["depth"].update(rmse="inf")),
        ("results.json", lambda v: v["camera"].update(width=0)),
    ],
)
def test_a_report_of_changed_figures_is_refused(tmp_path, name, change):
    out = write_keyframes(tmp_path / "run", 2)
    write_evaluation(out / "evaluation.json", evaluate_run(out, truth_of(write_sequence(tmp_path / "sequence"))))
    change_json(out / name, change)
    with pytest.raises(InputError, match=re.escape(name)) as raised:
        write_report(out)
    assert len(str(raised.value)) < 500


def test_broken_keyframes_are_not_listed_one_by_one(tmp_path):
    out = write_keyframes(tmp_path, 1)
    change_json(out / "results.json", lambda values: values.update(keyframes=[{}] * 100_000))
    with pytest.raises(InputError, match=r"results\.json: not the results of a run \(keyframes\.0\.index"):
        read_results(out)
