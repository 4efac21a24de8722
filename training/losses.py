"""What the network is trained for: relative inverse depth, normals, the kind of reflection, and honest variances."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch.nn import functional as F

_FAR = 0.15  # of the mean inverse depth; errors of what is farther away are not relative to it but to this
_NOTHING = 1e-3  # 1/m
_SCALES = 4
_LARGEST_ERROR = 2.5  # relative errors over this are no worse
_WEIGHTS = {"depth": 1.0, "gradient": 0.5, "normal": 0.5, "specular": 0.1, "variance": 0.05, "scale": 0.01}


@dataclass(frozen=True)
class Truth:
    """At the size of the outputs.

    inverse_depth: B×1×H×W, 0 for the sky. normal: B×3×H×W. specular: B×1×H×W, 0 or 1. surface: B×1×H×W, 1 where
    there is one.
    """

    inverse_depth: torch.Tensor
    normal: torch.Tensor
    specular: torch.Tensor
    surface: torch.Tensor


def losses(outputs: tuple[torch.Tensor, ...], truth: Truth) -> dict[str, torch.Tensor]:
    """Each part of the loss, and their weighted sum `total`."""
    depth, normal, specular, variance_depth, variance_normal = outputs
    error, tolerance = aligned_error(depth, truth.inverse_depth)
    relative = relative_error(error, tolerance)
    cosine = (normal * truth.normal).sum(dim=1, keepdim=True)
    surface = truth.surface
    area = surface.sum().clamp(min=1.0)
    parts = {
        "depth": relative.mean(),
        "gradient": gradient_loss(error, tolerance),
        "normal": ((1.0 - cosine) * surface).sum() / area,
        "specular": (F.binary_cross_entropy_with_logits(specular, truth.specular, reduction="none") * surface).sum()
        / area,
        "variance": _laplace(relative.detach(), variance_depth).mean()
        + (_laplace(torch.sqrt((2.0 - 2.0 * cosine).clamp(min=1e-6)).detach(), variance_normal) * surface).sum() / area,
        "scale": depth.mean(dim=(1, 2, 3)).square().mean() + (depth.flatten(1).std(dim=1) - 1.0).square().mean(),
    }
    parts["total"] = sum(_WEIGHTS[name] * part for name, part in parts.items())
    return parts


def aligned_error(depth: torch.Tensor, truth: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Error a·d + b - q of the best affine fit of each picture, and the tolerance that it is relative to.

    As in MiDaS the loss knows no scale or shift; but the fit is of errors relative to the true inverse depth q, as
    errors of depth in percent are.
    """
    d, q = depth.flatten(1), truth.flatten(1)
    tolerance = q + _FAR * q.mean(dim=1, keepdim=True).clamp(min=_NOTHING)  # a picture may show nothing but sky
    w = 1.0 / tolerance.square()
    w = w / w.sum(dim=1, keepdim=True)
    d_mean, q_mean = (w * d).sum(dim=1, keepdim=True), (w * q).sum(dim=1, keepdim=True)
    d0, q0 = d - d_mean, q - q_mean
    a = (w * d0 * q0).sum(dim=1, keepdim=True) / ((w * d0 * d0).sum(dim=1, keepdim=True) + 1e-4)
    error = a.clamp(min=1e-3) * d0 - q0
    return error.view_as(depth), tolerance.view_as(depth)


def relative_error(error: torch.Tensor, tolerance: torch.Tensor) -> torch.Tensor:
    """|error| relative to the tolerance of the farther of truth and what was found, as errors of depth are.

    What is found too near is cut off, for it may be found at no distance at all. What is found too far is not, so that
    a near thing that was taken for the wall behind it is always drawn out of it.
    """
    farther = torch.minimum(tolerance, (tolerance + error.detach()).clamp(min=0.25 * tolerance))
    ratio = error.abs() / farther
    return torch.where(error > 0, ratio.clamp(max=_LARGEST_ERROR), ratio)


def gradient_loss(error: torch.Tensor, tolerance: torch.Tensor) -> torch.Tensor:
    """Mean absolute gradient of the error over scales of 1, 2, 4 and 8 pixels (MiDaS, Ranftl et al. 2022).

    Each is relative to the nearer of its two pixels: so the missed edge of a thing that stands free before a far wall
    costs about 1, not as many as the wall is times farther.
    """
    total = error.new_zeros(())
    for scale in range(_SCALES):
        e, t = error[:, :, :: 2**scale, :: 2**scale], tolerance[:, :, :: 2**scale, :: 2**scale]
        total = total + _relative_steps(e[..., 1:], e[..., :-1], t[..., 1:], t[..., :-1])
        total = total + _relative_steps(e[..., 1:, :], e[..., :-1, :], t[..., 1:, :], t[..., :-1, :])
    return total / 2


def _relative_steps(a: torch.Tensor, b: torch.Tensor, tolerance_a: torch.Tensor, tolerance_b: torch.Tensor):
    return ((a - b).abs() / torch.maximum(tolerance_a, tolerance_b)).clamp(max=_LARGEST_ERROR).mean()


def _laplace(error: torch.Tensor, log_variance: torch.Tensor) -> torch.Tensor:
    """Negative log-likelihood of Laplace's distribution of variance e^log_variance, up to a constant."""
    half = 0.5 * log_variance.clamp(-12.0, 4.0)
    return error * torch.exp(-half) * 2**0.5 + half
