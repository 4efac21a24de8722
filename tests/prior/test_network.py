"""Networks behind the adapter: fed as declared, read as declared, and refused with one clear line."""

from __future__ import annotations

import threading
from pathlib import Path

import cv2
import numpy as np
import pytest
from onnx_files import (
    DOUBLE,
    INT64,
    UINT8,
    answer,
    endless,
    huge,
    identity,
    mean_over,
    message,
    node,
    onnx_file,
    tensor,
    with_data_at,
)

from polarmap.errors import InputError
from polarmap.prior.network import DepthNetwork
from polarmap.prior.network_spec import NetworkSpec, OutputSpace, network_spec

INVERSE = NetworkSpec(output_space="inverse depth")


def ramp(height: int = 96, width: int = 128) -> np.ndarray:
    """Linear intensities whose encoding falls from 1 at the left to 0.2 at the right."""
    return np.tile(np.linspace(1.0, 0.2, width, dtype=np.float32) ** (1 / 0.45), (height, 1))


INNER = (slice(12, -12), slice(12, -12))
ENCODED = ramp() ** 0.45


# --- feeding and reading ---


def test_the_network_sees_encoded_grey(tmp_path):
    network = DepthNetwork(identity(tmp_path / "n.onnx", (1, 1, 48, 64)), INVERSE)
    found = network(ramp())
    assert (found.shape, found.dtype, network.name) == ((96, 128), np.float32, "n")
    np.testing.assert_allclose(found[INNER], ENCODED[INNER], atol=0.02)


def test_exposure_does_not_matter(tmp_path):
    network = DepthNetwork(identity(tmp_path / "n.onnx", (1, 1, 48, 64)), INVERSE)
    np.testing.assert_allclose(network(0.01 * ramp()), network(ramp()), atol=1e-5)


def test_mean_std_and_full_scale_apply_per_channel(tmp_path):
    spec = NetworkSpec(output_space="inverse depth", mean=(0.1, 0.2, 0.6), std=(0.5, 1.0, 2.0), full_scale=255)
    network = DepthNetwork(mean_over(tmp_path / "n.onnx", 1, (1, 3, 48, 64), (1, 1, 48, 64)), spec)
    expected = 255 * np.mean([(ENCODED - m) / s for m, s in zip(spec.mean, spec.std, strict=True)], axis=0)
    np.testing.assert_allclose(network(ramp())[INNER], expected[INNER], atol=255 * 0.02)


def test_channels_may_come_last(tmp_path):
    network = DepthNetwork(mean_over(tmp_path / "n.onnx", 3, (1, 48, 64, 3), (1, 48, 64, 1)), INVERSE)
    np.testing.assert_allclose(network(ramp())[INNER], ENCODED[INNER], atol=0.02)


@pytest.mark.parametrize("shape", [(96, 128), (128, 96), (90, 250)])
def test_an_open_size_fits_the_image(tmp_path, shape):
    path = identity(tmp_path / "n.onnx", ("batch", 1, "height", "width"))
    spec = NetworkSpec(output_space="inverse depth", input_size=(56, 56), multiple_of=14)
    image = ramp(*shape)
    found = DepthNetwork(path, spec)(image)
    assert found.shape == shape
    np.testing.assert_allclose(found[INNER], image[INNER] ** 0.45, atol=0.03)


def test_depth_and_log_depth_become_inverse_depth(tmp_path):
    path = identity(tmp_path / "n.onnx", (1, 1, 48, 64))
    depth = DepthNetwork(path, NetworkSpec(output_space=OutputSpace.DEPTH))(ramp())
    np.testing.assert_allclose(depth[INNER], 1 / ENCODED[INNER], rtol=0.06)
    log_depth = DepthNetwork(path, NetworkSpec(output_space=OutputSpace.LOG_DEPTH))(ramp())
    np.testing.assert_allclose(log_depth[INNER], np.exp(-ENCODED[INNER]), rtol=0.03)


def test_the_output_is_chosen_by_index_or_name(tmp_path):
    nodes = [node("Identity", "x", "first"), node("Neg", "x", "second")]
    shape = (1, 1, 48, 64)
    outputs = [tensor("first", shape), tensor("second", shape)]
    path = onnx_file(tmp_path / "n.onnx", nodes, [tensor("x", shape)], outputs)
    for output in (1, "second"):
        found = DepthNetwork(path, NetworkSpec(output_space="inverse depth", output=output))(ramp())
        np.testing.assert_allclose(found[INNER], -ENCODED[INNER], atol=0.02)
    for output in (2, "third"):
        with pytest.raises(InputError, match=r"n\.onnx: has no output .*first, second"):
            DepthNetwork(path, NetworkSpec(output_space="inverse depth", output=output))


@pytest.mark.parametrize("shape", [(1, 1, 1, 48, 64), ("batch", "views", 1, 48, 64)])
def test_an_image_may_have_a_view_axis(tmp_path, shape):
    found = DepthNetwork(identity(tmp_path / "n.onnx", shape), INVERSE)(ramp())
    np.testing.assert_allclose(found[INNER], ENCODED[INNER], atol=0.02)


@pytest.mark.parametrize(("element", "white"), [(UINT8, 255), (DOUBLE, 1)])
def test_other_types_of_input_are_fed(tmp_path, element, white):
    cast = node("Cast", "x", "y", message((1, "to"), (3, 1), (20, 2)))
    shape = (1, 1, 48, 64)
    path = onnx_file(tmp_path / "n.onnx", [cast], [tensor("x", shape, element)], [tensor("y", shape)])
    np.testing.assert_allclose(DepthNetwork(path, INVERSE)(ramp())[INNER], white * ENCODED[INNER], atol=0.02 * white)


@pytest.mark.parametrize("nothing", [0.0, np.inf, -np.inf, np.nan, -1.0])
def test_pixels_without_depth_are_masked(tmp_path, nothing):
    depth = np.full((48, 64), 2.0, np.float32)
    depth[:5, :20] = nothing
    path = answer(tmp_path / "n.onnx", depth, (1, 3, 48, 64))
    found = DepthNetwork(path, NetworkSpec(output_space="depth"))(ramp())
    expected = np.full((96, 128), 0.5, np.float32)
    expected[:10, :40] = np.nan
    np.testing.assert_allclose(found, expected, rtol=1e-5)


def test_infinite_disparity_is_masked_and_zero_is_far(tmp_path):
    disparity = np.full((48, 64), 2.0, np.float32)
    disparity[:5, :20] = np.inf
    disparity[20:30, 20:30] = 0.0
    found = DepthNetwork(answer(tmp_path / "n.onnx", disparity, (1, 3, 48, 64)), INVERSE)(ramp())
    assert np.isnan(found[:10, :40]).all() and np.isfinite(found[10:]).all()
    assert abs(found[50, 50]) < 0.01


def test_an_output_may_have_the_pictures_proportions(tmp_path):
    depth = np.full((48, 64), 2.0, np.float32)
    path = answer(tmp_path / "n.onnx", depth, (1, 1, 3, 64, 64))
    np.testing.assert_allclose(DepthNetwork(path, INVERSE)(ramp(480, 640)), 2.0, rtol=1e-5)


# --- specifications ---


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("tcmonodepth_small_192x320", {"full_scale": 255, "mean": (0, 0, 0)}),
        ("model-small", {"full_scale": 1, "mean": (0, 0, 0), "std": (1, 1, 1), "input_size": (256, 256)}),
        ("midas_v21_small_256", {"mean": (0, 0, 0), "std": (1, 1, 1)}),
        ("MiDaS_small_256x256", {"mean": (0.485, 0.456, 0.406), "std": (0.229, 0.224, 0.225)}),
        ("dpt_hybrid-midas-501f0c75", {"mean": (0.5, 0.5, 0.5), "std": (0.5, 0.5, 0.5), "input_size": (384, 384)}),
        ("depth_anything_v2_vits", {"mean": (0.485, 0.456, 0.406), "multiple_of": 14, "input_size": (518, 518)}),
        ("Depth-Anything-V2-Small", {"output_space": OutputSpace.INVERSE_DEPTH, "multiple_of": 14}),
        ("depth_anything_v2_metric_hypersim_vits", {"output_space": OutputSpace.DEPTH, "multiple_of": 14}),
        ("depth_anything_v2_vits_indoor_dynamic", {"output_space": OutputSpace.DEPTH, "multiple_of": 14}),
        ("depth_anything_v2_vitb_outdoor_518x518", {"output_space": OutputSpace.DEPTH}),
        ("Depth-Anything-V2-Metric-Indoor-Small-hf", {"output_space": OutputSpace.DEPTH}),
        ("depth_anything_vits14", {"output_space": OutputSpace.INVERSE_DEPTH}),
        ("depth_anything_v3_da3_vits", {"output_space": OutputSpace.DEPTH, "input_size": (504, 504)}),
        ("Depth-Anything-3-small", {"output_space": OutputSpace.DEPTH}),
        ("da3metric-large", {"output_space": OutputSpace.DEPTH, "mean": (0.485, 0.456, 0.406)}),
        ("distill_any_depth_large", {"output_space": OutputSpace.INVERSE_DEPTH, "multiple_of": 14}),
        ("metric3d-vit-small", {"output_space": OutputSpace.DEPTH, "full_scale": 255}),
        ("zoedepth-nyu-kitti", {"output_space": OutputSpace.DEPTH, "mean": (0.5, 0.5, 0.5)}),
        ("ZoeD_N", {"output_space": OutputSpace.DEPTH}),
        ("unidepth_v2_vits14", {"output_space": OutputSpace.DEPTH}),
        ("depth_pro", {"output_space": OutputSpace.DEPTH, "input_size": (1536, 1536)}),
        ("marigold-depth-v1-0", {"output_space": OutputSpace.DEPTH}),
        ("res101_leres", {"output_space": OutputSpace.DEPTH}),
    ],
)
def test_common_networks_are_known_by_name(name, values):
    spec = network_spec(Path("models") / f"{name}.onnx")
    assert {key: getattr(spec, key) for key in values} == values


def test_an_unknown_network_needs_a_sidecar(tmp_path):
    path = identity(tmp_path / "model.onnx", (1, 1, 48, 64))
    with pytest.raises(InputError, match=r"not a network known by name; describe it in .*model\.yaml.*output_space"):
        DepthNetwork(path)
    path.with_suffix(".yaml").write_text("output_space: depth\nfull_scale: 255\n")
    assert DepthNetwork(path).spec == NetworkSpec(output_space="depth", full_scale=255)


def test_a_sidecar_overrides_what_the_name_says(tmp_path):
    (tmp_path / "midas_v21_small.yaml").write_text("output_space: log depth\nmean: [0.1, 0.2, 0.3]\n")
    spec = network_spec(tmp_path / "midas_v21_small.onnx")
    assert (spec.output_space, spec.mean) == (OutputSpace.LOG_DEPTH, (0.1, 0.2, 0.3))


def test_what_a_sidecar_leaves_out_is_as_the_name_has_it(tmp_path):
    sidecar = tmp_path / "depth_anything_v2_vits_indoor.yaml"
    sidecar.write_text("output_space: inverse depth\ninput_size: [266, 266]\n")
    spec = network_spec(sidecar.with_suffix(".onnx"))
    assert (spec.output_space, spec.input_size) == (OutputSpace.INVERSE_DEPTH, (266, 266))
    assert (spec.mean, spec.multiple_of) == ((0.485, 0.456, 0.406), 14)
    sidecar.write_text("multiple_of: 28\n")
    with pytest.raises(InputError, match="output_space: field required"):
        network_spec(sidecar.with_suffix(".onnx"))


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("mean: [0, 0, 0]", "output_space: field required"),
        ("output_space: disparity", "output_space: input should be 'inverse depth'"),
        ("output_space: depth\nstdev: 1", "stdev: there is no such parameter"),
        ("output_space: depth\nstd: [1, 0, 1]", "std.1: input should be greater than or equal to"),
        ("output_space: depth\nmean: [1, 2]", "mean"),
        ("output_space: depth\ninput_size: [4, 100000]", "input_size"),
        ("output_space: depth\nfull_scale: .nan", "full_scale"),
        ("- depth", "must map names to values"),
        ("1: depth", "must map names to values"),
        ("output_space: [", "not valid YAML"),
        ("output_space: !!python/object/apply:os.getcwd []", "not valid YAML"),
        ("", "must map names to values"),
        ("#" * 200_000, "more than the 100000"),
        (b"\xff\xfe\x00", "not valid YAML"),
    ],
)
def test_a_bad_sidecar_is_named(tmp_path, text, complaint):
    sidecar = tmp_path / "model.yaml"
    sidecar.write_bytes(text if isinstance(text, bytes) else text.encode())
    with pytest.raises(InputError) as error:
        network_spec(tmp_path / "model.onnx")
    assert str(error.value).startswith(str(sidecar))
    assert complaint in str(error.value)
    assert "\n" not in str(error.value)


# --- files that are no depth network ---

IMAGE = (1, 1, 48, 64)


def two_inputs(path):
    nodes = [message((1, "a"), (1, "b"), (2, "y"), (4, "Add"))]
    return onnx_file(path, nodes, [tensor("a", IMAGE), tensor("b", IMAGE)], [tensor("y", IMAGE)])


def integer_input(path):
    return onnx_file(path, [node("Identity", "x", "y")], [tensor("x", IMAGE, INT64)], [tensor("y", IMAGE, INT64)])


def not_a_number(path):
    nodes = [node("Sub", "xx", "z"), node("Div", "zz", "y")]
    return onnx_file(path, nodes, [tensor("x", IMAGE)], [tensor("y", IMAGE)])


def garbage(path):
    path.write_bytes(b"not an ONNX file" * 100)


def cut_short(path):
    identity(path, IMAGE)
    path.write_bytes(path.read_bytes()[:-20])


@pytest.mark.parametrize(
    ("make", "complaint"),
    [
        (garbage, "is not an ONNX network"),
        (cut_short, "is not an ONNX network"),
        (lambda path: path.write_bytes(b""), "ONNX network"),
        (lambda path: path.mkdir(), "there is no such file"),
        (lambda path: None, "there is no such file"),
        (two_inputs, "takes 2 inputs"),
        (integer_input, "its input is a tensor(int64)"),
        (not_a_number, "gives NaN"),
        (lambda path: huge(path, IMAGE), "fails on an input of [1, 1, 48, 64]"),
        (lambda path: with_data_at(path, "../outside.bin", IMAGE), "is not an ONNX network that can be run"),
        (lambda path: with_data_at(path, "/etc/hostname", IMAGE), "is not an ONNX network that can be run"),
        (lambda path: identity(path, (1, 48, 64)), "is not that of one image"),
        (lambda path: identity(path, (2, 1, 48, 64)), "takes 2 at once"),
        (lambda path: identity(path, (1, 4, 1, 48, 64)), "takes 4 at once"),
        (lambda path: identity(path, (1, 4, 48, 64)), "has 4 channels"),
        (lambda path: identity(path, (1, 1, 100_000, 100_000)), "too large"),
        (lambda path: identity(path, (1, 3, 48, 64)), "is no depth map"),
        (lambda path: mean_over(path, 3, (1, 1, 48, 64), (1, 1, 48, 1)), "is no depth map"),
    ],
)
def test_an_unfit_file_is_refused_in_one_line(tmp_path, make, complaint):
    path = tmp_path / "n.onnx"
    make(path)
    with pytest.raises(InputError) as error:
        DepthNetwork(path, INVERSE)
    assert str(error.value).startswith(str(path))
    assert complaint in str(error.value)
    assert "\n" not in str(error.value)


def test_a_network_that_does_not_end_is_given_up(tmp_path):
    path = endless(tmp_path / "n.onnx", IMAGE)
    threads = threading.active_count()
    with pytest.raises(InputError, match=r"n\.onnx: did not end within 0\.2 s for one picture; .*prior\.time_limit"):
        DepthNetwork(path, INVERSE, time_limit=0.2)
    assert threading.active_count() == threads


def test_depth_that_is_nowhere_positive_is_refused(tmp_path):
    path = answer(tmp_path / "n.onnx", np.full((48, 64), -1.0), (1, 3, 48, 64))
    with pytest.raises(InputError, match=r"no positive depth .*output_space in .*n\.yaml"):
        DepthNetwork(path, NetworkSpec(output_space="depth"))


# --- a real one ---


def test_tcmonodepth_orders_the_living_room(shared_models, shared_data):
    network = DepthNetwork(shared_models / "tcmonodepth_small_192x320.onnx")
    mosaic = cv2.imread(str(shared_data / "livingroom" / "raw" / "000000.png"), cv2.IMREAD_UNCHANGED)
    intensity = cv2.resize(mosaic, (640, 480), interpolation=cv2.INTER_AREA).astype(np.float32) / 255
    depth = cv2.imread(str(shared_data / "livingroom" / "depth" / "000000.png"), cv2.IMREAD_UNCHANGED)
    found = network(intensity)
    known = depth > 0
    assert found.shape == (480, 640)
    assert np.corrcoef(found[known], 1.0 / depth[known])[0, 1] > 0.75
