"""When frames were taken and in what order: the lists of public recordings, names of all kinds, lost frames."""

from __future__ import annotations

import math

import numpy as np
import pytest

from polarmap.data.camera_file import CameraFile
from polarmap.data.odometry import OdometryResult, SparsePoints
from polarmap.data.times import Timestamp, nanoseconds_of
from polarmap.data.trajectory import PosedFrame
from polarmap.errors import InputError
from polarmap.geometry.camera import PinholeCamera
from polarmap.io.formats.images import write_image
from polarmap.io.formats.times import parse_date, seconds_text
from polarmap.io.formats.trajectory import read_trajectory
from polarmap.io.recording.sequence import Sequence, open_sequence
from polarmap.io.run_folder.folder import tum_line
from polarmap.io.run_folder.odometry_files import write_segments

FRAMES = 12
LOST = (4, 5, 9)
SEEN = [i for i in range(FRAMES) if i not in LOST]
FIRST = 1520530308199447626


def ns(i: int) -> int:
    return FIRST + 33333333 * i


@pytest.fixture
def record(tmp_path):
    """Writes 2×2 pictures under these names and text files, and opens the sequence."""

    def record(names, files=None, frame_rate=None, images=None) -> Sequence:
        for name in names:
            (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
            write_image(tmp_path / name, np.zeros((2, 2), np.uint8))
        for name, text in (files or {}).items():
            (tmp_path / name).write_bytes(text.encode())
        camera = PinholeCamera(2, 2, 2.0, 2.0, 0.5, 0.5)
        return open_sequence(tmp_path, CameraFile(camera, None, None, 8, frame_rate=frame_rate, images=images))

    return record


def each(line, frames=range(FRAMES)) -> str:
    return "".join(line(i) + "\n" for i in frames)


def seconds(i: int) -> str:
    return f"{ns(i) // 10**9}.{ns(i) % 10**9:09d}"


DATED = each(lambda i: f"2018-03-08 17:31:48.{ns(i) % 10**9:09d}")
PADDED = [f"images/{i:05d}.png" for i in range(FRAMES)]
BY_NANOSECONDS = [f"cam0/data/{ns(i)}.png" for i in range(FRAMES)]
PLAIN_NANOSECONDS = [f"images/{ns(i)}.png" for i in range(FRAMES)]
LISTS = {
    "KITTI raw, dates": (PADDED, {"timestamps.txt": DATED}),
    "dates with names": (PADDED, {"times.txt": each(lambda i: f"{i:05d} {DATED.splitlines()[i]}")}),
    "EuRoC, Windows": (
        BY_NANOSECONDS,
        {"cam0/data.csv": "#timestamp [ns],filename\r\n" + each(lambda i: f"{ns(i)},{ns(i)}.png\r")},
    ),
    "ORB-SLAM": (BY_NANOSECONDS, {"timestamps.txt": each(lambda i: f"{ns(i)} {ns(i)}.png")}),
    "nanoseconds": (PADDED, {"timestamps.txt": each(lambda i: f"{ns(i)}")}),
    "seconds to the nanosecond": (PADDED, {"timestamps.txt": each(seconds)}),
    "names alone": (PLAIN_NANOSECONDS, {}),
    "names of seconds and nanoseconds": ([f"images/l_{seconds(i).replace('.', '_')}.png" for i in range(FRAMES)], {}),
    "TUM-VI": (
        PLAIN_NANOSECONDS,
        {"times.txt": "# name seconds ms\n" + each(lambda i: f"{ns(i)} {seconds(i)} 0.62")},
    ),
    "names with suffix": (PADDED, {"times.txt": each(lambda i: f"images/{i:05d}.jpg {ns(i)}")}),
    "time first": (PADDED, {"times.txt": each(lambda i: f"{ns(i)} {i:05d}.png 5.0")}),
    "numbers without zeros": (PADDED, {"times.txt": each(lambda i: f"{i} {ns(i)}")}),
    "header": (
        PADDED,
        {"times.txt": "filename,exposure_us,timestamp_ns\n" + each(lambda i: f"{i:05d}.png,5000,{ns(i)}")},
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", LISTS)
def test_times_to_the_nanosecond(record, name):
    names, files = LISTS[name]
    sequence = record(names, files)
    assert [nanoseconds_of(frame.timestamp) for frame in sequence.files] == [ns(i) for i in range(FRAMES)]
    np.testing.assert_array_equal(sequence.timestamps, [ns(i) / 10**9 for i in range(FRAMES)])


def test_times_beside_the_folder_of_pictures(record):
    sequence = record([f"image_00/data/{i:010d}.png" for i in range(2)], {"image_00/timestamps.txt": DATED[:60]},
                      images="image_00/data")  # fmt: skip
    assert nanoseconds_of(sequence.files[1].timestamp) == ns(1)


def test_other_clocks(record, caplog):
    sequence = record(PADDED, {"timestamps.txt": each(lambda i: str(1520530308199 + 33 * i))})
    assert sequence.timestamps[1] == 1520530308.232 and not caplog.records
    sequence = record(PADDED, {"timestamps.txt": each(lambda i: str(33 * i))})
    assert sequence.timestamps[1] == 0.033 and "its times are taken for milliseconds" in caplog.text
    sequence = record(PADDED, {"timestamps.txt": "# [us]\n" + each(lambda i: str(2000 * i))})
    assert sequence.timestamps[1] == 0.002
    with pytest.raises(InputError, match=r"its times are nanoseconds by header or format, but 0\.1 apart"):
        record(PADDED, {"timestamps.txt": "# [ns]\n" + each(lambda i: f"{0.1 * i:.1f}")})
    with pytest.raises(InputError, match="5000 apart may be milliseconds or microseconds; write seconds"):
        record(PADDED, {"timestamps.txt": each(lambda i: str(5000 * i))})


def test_seconds_in_names(record):
    names = [f"images/{1520530308 + i / 8}.png" for i in range(FRAMES)]
    np.testing.assert_array_equal(record(names).timestamps, 1520530308 + np.arange(FRAMES) / 8)


def test_names_that_are_no_times_give_none(record):
    assert np.isnan(record([f"images/{20231201115012 + i}.png" for i in range(3)]).timestamps).all()


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("times.txt", each(lambda i: f"{i:05d} {i / 30:.6f} 5.0")),
        ("timestamps.txt", each(lambda i: f"{i / 30:.6f}", SEEN)),
        ("timestamps.txt", each(lambda i: f"{i / 30:.6f}")),
    ],
    ids=["by name", "one each", "those of lost frames too"],
)
def test_lost_frames_whose_times_are_known(record, name, text):
    sequence = record([f"images/{i:05d}.png" for i in SEEN], {name: text})
    assert [frame.index for frame in sequence.files] == SEEN
    np.testing.assert_allclose(sequence.timestamps, np.array(SEEN) / 30, atol=1e-6)


def test_exposures_of_lost_frames(record):
    files = {"timestamps.txt": each(lambda i: f"{i / 30:.6f}"), "exposures.txt": each(lambda i: f"{i + 1}")}
    sequence = record([f"images/{i:05d}.png" for i in SEEN], files)
    np.testing.assert_allclose(sequence.exposures, (np.array(SEEN) + 1) / 1e3)


def test_times_that_do_not_know_of_a_lost_frame_are_refused(record, tmp_path):
    with pytest.raises(InputError, match="frame 00004 is missing, but the times go on evenly; take out its line"):
        record([f"images/{i:05d}.png" for i in SEEN], {"timestamps.txt": each(lambda i: f"{i / 30:.6f}")[: 9 * 9]})
    with pytest.raises(InputError, match=r"frame 00004 is missing after 00003; .* or list the frames' times"):
        (tmp_path / "timestamps.txt").unlink()
        record([f"images/{i:05d}.png" for i in SEEN], frame_rate=30)


@pytest.mark.parametrize(
    ("column", "header", "seconds"),
    [
        ("5.0", "", 0.005),
        ("0.62", "", 0.00062),
        ("0.005", "", 0.005),
        ("5000", "", 0.005),
        ("0.03", "# name seconds exposure[s]\n", 0.03),
        ("0.03", "# name seconds ms\n", 0.00003),
        ("0", "", math.nan),
    ],
)
def test_units_of_exposures(record, column, header, seconds):
    sequence = record(PADDED, {"times.txt": header + each(lambda i: f"{i:05d} {i / 30:.6f} {column}")})
    np.testing.assert_allclose(sequence.exposures, seconds, rtol=1e-12)


def test_exposures_that_may_be_seconds_are_refused(record):
    with pytest.raises(InputError, match=r"such as 0.03 may be seconds or milliseconds; name the unit in a first line"):
        record(PADDED, {"times.txt": each(lambda i: f"{i:05d} {i / 30:.6f} 0.03")})


def test_a_second_list_of_times_is_named_if_it_says_otherwise(record, caplog):
    same = {"timestamps.txt": each(lambda i: f"{i / 30:.6f}"), "times.txt": each(lambda i: f"{i / 30:.5f}")}
    record(PADDED, same)
    assert not caplog.records
    record(PADDED, {"times.txt": each(lambda i: f"{i / 20:.5f}")})
    assert "timestamps.txt: times are those of this file" in caplog.text and "times.txt says otherwise" in caplog.text


def test_a_second_cameras_pictures_are_named(record, caplog):
    record([*BY_NANOSECONDS, *(name.replace("cam0", "cam1") for name in BY_NANOSECONDS)])
    assert "cam1/data is another camera's and is not" in caplog.text


NAMES = {
    "seconds after the number": lambda i: f"{i + 1}_{i / 30:.3f}",
    "a word after the number": lambda i: f"img{i + 1}_raw",
    "the number last": lambda i: f"img{i + 1}",
    "between words": lambda i: f"left-{i + 1}-8bit",
    "the number before other numbers": lambda i: f"cam2_f{i + 1}_t{(7 * i) % 5}",
    "a constant number after it": lambda i: f"{i + 1} (640x480)",
}


@pytest.mark.parametrize("name", NAMES)
def test_numbers_without_zeros_keep_their_order(record, name):
    call = NAMES[name]
    sequence = record([f"images/{call(i)}.png" for i in range(FRAMES)])
    assert [frame.name for frame in sequence.files] == [call(i) for i in range(FRAMES)]
    assert [frame.index for frame in sequence.files] == list(range(1, FRAMES + 1))


def test_positions_count_where_no_number_does(record):
    names = [f"s{i // 5}_{i % 5}.{5 - i % 5}" for i in range(FRAMES)]
    sequence = record([f"images/{name}.png" for name in names])
    assert [(frame.index, frame.name) for frame in sequence.files] == list(enumerate(names))


@pytest.mark.parametrize(
    ("names", "message"),
    [
        (["5_1", "10_2", "5_3", "10_4"], "give two orders: 5_3 or 10_2 may come first"),
        (["v1.9", "v1.10", "v1.11"], "give two orders: v1.9 or v1.10 may come first"),
        (["a1", "a01"], "two frames have the same number"),
        (
            ["left_1", "left_2", "right_1", "right_2"],
            "left_1 and right_1 have the same number",
        ),
    ],
)
def test_names_in_two_orders_are_refused(record, names, message):
    with pytest.raises(InputError, match=message):
        record([f"images/{name}.png" for name in names])


def test_odometry_writes_the_nanoseconds_of_the_frames(record, tmp_path):
    sequence = record(BY_NANOSECONDS)
    frames = tuple(PosedFrame(f.index, f.timestamp, 0, np.eye(4), False) for f in sequence.files)
    no_points = SparsePoints(np.empty((0, 3)), *(np.empty(0) for _ in range(6)))
    for format in ("euroc", "tum"):
        write_segments(tmp_path / format, OdometryResult(frames, no_points, (), {}), format)
        assert read_trajectory(tmp_path / format).nanoseconds.tolist() == [ns(i) for i in range(FRAMES)]
    assert tum_line(sequence[3].timestamp, np.eye(4)).split()[0] == seconds(3)


def test_times_as_text():
    assert seconds_text(Timestamp(-1.5, -1500000000)) == "-1.5"
    assert seconds_text(Timestamp(-1500000000.1234567, -1500000000123456789)) == "-1500000000.123456789"
    assert nanoseconds_of(1700000000.033333) == 1700000000033333000
    assert parse_date("1970/1/2 00:00:00,5+01:00") == 82800 * 10**9 + 5 * 10**8
    for text in ("2011-13-30 11:50:40", "2011-09-30", "11:50:40", "9" * 100):
        assert parse_date(text) is None
