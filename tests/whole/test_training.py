"""The training's parts: scenes and views that a seed decides, consistent examples, a loss that is fair."""

from __future__ import annotations

import numpy as np
import pytest

from polarmap.data.codes import Reflection
from training import augmentation
from training.materials import Materials
from training.rooms import corridor, is_inside, islands, room
from training.streets import street
from training.views import HEIGHT, SAMPLE, WIDTH, random_camera

IMAGES = np.random.default_rng(0).uniform(-1, 1, (3, 16, 16)).astype(np.float32)
TILT = np.array([0.3, -0.2, -0.9]) / np.linalg.norm([0.3, -0.2, -0.9])  # normal of the plane n·P = -2


def plane_sample() -> np.ndarray:
    """A record of one tilted plane whose light is polarized along the plane of incidence, by a tenth."""
    sample = np.zeros((), SAMPLE)
    sample["camera"] = (200.0, 200.0, 120.0, 90.0)
    x, y = (np.arange(WIDTH) - 120.0) / 200.0, (np.arange(HEIGHT)[:, None] - 90.0) / 200.0
    sample["depth"] = -2.0 / (TILT[0] * x + TILT[1] * y + TILT[2])
    sample["normal"] = np.rint(127 * TILT)[:, None, None]
    sample["reflection"] = Reflection.DIFFUSE
    angle = np.arctan2(TILT[1] - TILT[2] * y, TILT[0] - TILT[2] * x)
    sample["stokes"] = np.stack([np.ones_like(angle), 0.1 * np.cos(2 * angle), 0.1 * np.sin(2 * angle)])
    return sample


@pytest.mark.parametrize("make", [room, islands, corridor, street])
def test_a_seed_decides_a_scene(make):
    def scene(seed: int):
        return make(Materials(np.random.default_rng(seed), len(IMAGES)), IMAGES)

    first, again, other = scene(4), scene(4), scene(5)
    assert len(first.scene.primitives) == len(again.scene.primitives)
    for a, b in zip(first.scene.primitives, again.scene.primitives, strict=True):
        np.testing.assert_array_equal(a.T_world_object, b.T_world_object)
        assert a.material == b.material
    assert first.scene.lights == again.scene.lights
    assert not np.array_equal(first.focuses, other.focuses)


def test_a_point_is_inside_a_plan_or_not():
    corner = np.array([(0, 0), (4, 0), (4, 2), (2, 2), (2, 4), (0, 4)], float)  # an L
    assert is_inside(corner, np.array([1.0, 3.0]), 0.5)
    assert not is_inside(corner, np.array([3.0, 3.0]), 0.0)
    assert not is_inside(corner, np.array([1.0, 3.0]), 1.1)


def test_cameras_are_45_to_95_degrees_wide():
    rng = np.random.default_rng(0)
    widths = [2 * np.degrees(np.arctan(WIDTH / 2 / random_camera(rng).fx)) for _ in range(300)]
    assert 45 <= min(widths) < 47
    assert 93 < max(widths) <= 95


@pytest.mark.parametrize("size", [(96, 128), (192, 256)])
def test_crops_and_flips_keep_geometry_and_polarization_together(size, monkeypatch):
    """Of a plane with n·P = -2, every pixel's depth, ray and normal must still say so, and AoLP lie along d."""
    monkeypatch.setattr(augmentation, "_WITHHELD", 0.0)
    monkeypatch.setattr(augmentation, "_PURE", 0.0)
    sample, flipped = plane_sample(), set()
    for seed in range(12):
        found = augmentation.example(sample, size, np.random.default_rng(seed))
        rays = found.input[4:].reshape(2, size[0] // 2, 2, size[1] // 2, 2).mean(axis=(2, 4))
        n = found.normal / np.linalg.norm(found.normal, axis=0)
        distance = (n[0] * rays[0] + n[1] * rays[1] + n[2]) / found.inverse_depth
        np.testing.assert_allclose(distance, -2.0, rtol=0.025)
        x, y = found.input[4:]
        normal = n[:, 0, 0]
        angle = 2 * np.arctan2(normal[1] - normal[2] * y, normal[0] - normal[2] * x)
        agreement = found.input[2] * np.cos(angle) + found.input[3] * np.sin(angle)
        seen = np.hypot(found.input[2], found.input[3])
        assert agreement.sum() >= 0.35 * seen.sum()  # the rest is noise
        flipped.add(bool(normal[0] < 0))
    assert flipped == {True, False}  # both kinds were seen


def test_examples_depend_on_their_seed_alone():
    a, b, c = (augmentation.example(plane_sample(), (96, 128), np.random.default_rng(s)) for s in (3, 3, 4))
    np.testing.assert_array_equal(a.input, b.input)
    assert np.abs(a.input - c.input).max() > 0.01


def test_polarization_is_withheld_at_times():
    rng = np.random.default_rng(0)
    inputs = [augmentation.example(plane_sample(), (32, 64), rng).input for _ in range(80)]
    assert 0.15 < np.mean([not x[2:4].any() for x in inputs]) < 0.45


# --- what needs PyTorch ---


def test_the_loss_knows_no_scale_and_no_shift():
    torch = pytest.importorskip("torch", reason="the extra 'training' is not installed")
    from training.losses import aligned_error

    q = torch.rand(2, 1, 12, 16) + 0.2
    error, tolerance = aligned_error(7.0 * q - 3.0, q)
    assert error.abs().max() < 1e-3
    assert (tolerance > q).all()
    nothing, tolerance = aligned_error(q, torch.zeros_like(q))  # all sky
    assert torch.isfinite(nothing / tolerance).all()
    inverted, _ = aligned_error(-q, q)
    assert inverted.abs().mean() > 0.1


def test_the_network_is_small_and_its_outputs_are_half_the_size():
    torch = pytest.importorskip("torch", reason="the extra 'training' is not installed")
    from training.network import PolarNet, parameter_count

    network = PolarNet().eval()
    assert parameter_count(network) <= 2_000_000
    with torch.no_grad():
        depth, normal, *rest = network(torch.zeros(1, 6, 64, 96))
    assert depth.shape == (1, 1, 32, 48)
    assert normal.shape == (1, 3, 32, 48)
    assert all(output.shape == (1, 1, 32, 48) for output in rest)


def test_a_missed_edge_costs_the_same_however_far_the_wall_behind_is():
    torch = pytest.importorskip("torch", reason="the extra 'training' is not installed")
    from training.losses import aligned_error, gradient_loss

    def cost(wall: float) -> float:
        q = torch.full((1, 1, 16, 16), wall)
        q[..., :4] = 1.0
        found = torch.full_like(q, wall).requires_grad_()  # the thing in front is not seen
        _, tolerance = aligned_error(found, q)
        loss = gradient_loss(found - q, tolerance)
        (slope,) = torch.autograd.grad(loss, found)
        assert slope[..., 3].sum() < 0  # to bring it nearer helps
        return float(loss.detach())

    assert cost(0.02) == pytest.approx(cost(0.2), rel=0.3)


@pytest.mark.parametrize("wall", [0.02, 0.2, 0.6])
def test_a_near_thing_that_is_missed_is_drawn_out_of_the_wall(wall):
    torch = pytest.importorskip("torch", reason="the extra 'training' is not installed")
    from training.losses import relative_error

    error = torch.full((1,), wall - 1.0, requires_grad=True)
    (slope,) = torch.autograd.grad(relative_error(error, torch.tensor([1.1])).sum(), error)
    assert slope < -0.5
    far_too_near = torch.tensor([50.0], requires_grad=True)
    (slope,) = torch.autograd.grad(relative_error(far_too_near, torch.tensor([1.1])).sum(), far_too_near)
    assert slope == 0.0


def test_things_before_a_wall_are_steps_and_a_wall_is_none():
    pytest.importorskip("torch", reason="the extra 'training' is not installed")
    from training.train import has_steps

    depth = plane_sample()["depth"].copy()
    assert not has_steps(depth)
    depth[60:140, 60:180] = 0.5
    assert has_steps(depth)


def test_an_exported_network_can_be_trained_on(tmp_path):
    torch = pytest.importorskip("torch", reason="the extra 'training' is not installed")
    from training.export import export
    from training.network import PolarNet
    from training.warm_start import warm_start

    torch.manual_seed(0)
    trained, x = PolarNet(), torch.rand(8, 6, 64, 64)
    with torch.no_grad():
        for _ in range(3):
            trained(x)  # statistics of its own
        for module in trained.modules():
            if isinstance(module, torch.nn.BatchNorm2d):
                module.weight.uniform_(0.5, 1.5)
                module.bias.normal_(0.0, 0.3)
    export(trained, (64, 64), tmp_path / "network.onnx")
    again = PolarNet()
    warm_start(again, tmp_path / "network.onnx", x)
    with torch.no_grad():
        for a, b, c in zip(trained.eval()(x), again.eval()(x), again.train()(x), strict=True):
            torch.testing.assert_close(a, b, atol=2e-3, rtol=2e-2)  # weights are stored as half
            assert (a - c).abs().mean() < 0.1 * a.std()


def test_the_average_of_two_networks_lies_between_them(tmp_path):
    torch = pytest.importorskip("torch", reason="the extra 'training' is not installed")
    import onnx
    from onnx import numpy_helper

    from training.average import average
    from training.export import export
    from training.network import PolarNet

    files = [tmp_path / f"{name}.onnx" for name in ("a", "b", "mean")]
    for seed, size in enumerate([(64, 96), (32, 32)]):
        torch.manual_seed(seed)
        export(PolarNet(), size, files[seed])
    average(*files, share=0.75)
    a, b, mean = ({t.name: numpy_helper.to_array(t) for t in onnx.load(str(f)).graph.initializer} for f in files)
    for name in mean:
        if mean[name].dtype.kind == "f":
            expected = 0.75 * a[name].astype(np.float32) + 0.25 * b[name].astype(np.float32)
            np.testing.assert_allclose(mean[name], expected, rtol=1e-3, atol=1e-6)
    assert onnx.load(str(files[2])).metadata_props == onnx.load(str(files[0])).metadata_props
    other = onnx.load(str(files[1]))
    other.graph.initializer[0].CopyFrom(numpy_helper.from_array(np.zeros(3, np.float32), "unknown"))
    onnx.save(other, str(files[1]))
    with pytest.raises(ValueError, match=r"b\.onnx: has no weights"):
        average(*files, share=0.75)


def test_the_shipped_network_can_be_trained_on():
    torch = pytest.importorskip("torch", reason="the extra 'training' is not installed")
    import onnxruntime

    from polarmap.prior.polarization_network import WEIGHTS
    from training.network import PolarNet
    from training.warm_start import warm_start

    network, x = PolarNet(), torch.rand(4, 6, 64, 96)
    warm_start(network, WEIGHTS, x)
    expected = onnxruntime.InferenceSession(str(WEIGHTS)).run(None, {"input": x.numpy()})
    with torch.no_grad():
        for a, b in zip(expected, network.eval()(x), strict=True):
            np.testing.assert_allclose(b.numpy(), a, atol=1e-3)


# --- evaluation ---


def test_networks_are_judged_by_the_affine_fit_of_least_absolute_error():
    from polarmap.data.polarization_image import PolarizationImage
    from polarmap.geometry.camera import PinholeCamera
    from polarmap.prior.prediction import Prediction
    from training.evaluate import View, judge

    class Relative:
        name = "relative"

        def __init__(self, inverse_depth: np.ndarray) -> None:
            self.inverse_depth = inverse_depth

        def predict(self, image: PolarizationImage, camera: PinholeCamera) -> Prediction:
            return Prediction(self.inverse_depth)

    q = np.random.default_rng(0).uniform(0.2, 1.0, (24, 32)).astype(np.float32)
    image = PolarizationImage.unpolarized(np.full(q.shape, 0.5, np.float32))
    view = View(image, 1.0 / q, PinholeCamera(32, 24, 30.0, 30.0, 15.5, 11.5))
    right = judge(Relative(5.0 * q - 2.0), view, grey=False)
    assert right.error < 1e-4 and right.rises and np.isnan(right.within_sigma)
    np.testing.assert_allclose(right.inverse_depth, q, rtol=1e-3)
    inverted = judge(Relative(-q), view, grey=False)
    assert inverted.error > 0.2 and not inverted.rises
