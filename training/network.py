"""The network: an encoder-decoder with a global look at the coarsest level, its outputs at half the input's size.

Dense 3×3 convolutions where there are few channels, inverted residuals (MobileNetV2) where there are many: on a CPU
dense ones run several times as fast per multiplication, and inverted ones save parameters.
"""

from __future__ import annotations

import torch
from torch import nn
from torch.nn import functional as F

from polarmap.prior.polarization_input import CHANNELS

OUTPUTS = ("inverse_depth", "normal", "specular", "log_variance_depth", "log_variance_normal")
"""Relative inverse depth (1 channel), unit normal (3), logit of specular (1), log-variances (1 each)."""

_CHANNELS = (24, 48, 80, 128, 192)  # at 1/2, 1/4, ... 1/32
_DECODED = (32, 48, 80, 96, 128)


def conv(inputs: int, outputs: int, size: int = 3, stride: int = 1) -> nn.Sequential:
    """Convolution, batch normalization, ReLU."""
    return nn.Sequential(
        nn.Conv2d(inputs, outputs, size, stride, size // 2, bias=False),
        nn.BatchNorm2d(outputs),
        nn.ReLU(inplace=True),
    )


class Residual(nn.Module):
    """Two dense 3×3 convolutions about an identity."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.first = conv(channels, channels)
        self.second = nn.Sequential(nn.Conv2d(channels, channels, 3, padding=1, bias=False), nn.BatchNorm2d(channels))

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        return F.relu(x + self.second(self.first(x)))


class Depthwise(nn.Conv2d):
    """A 5×5 filter for each channel, in float32: bfloat16 takes a CPU three times as long on the way back."""

    def __init__(self, channels: int) -> None:
        super().__init__(channels, channels, 5, padding=2, groups=channels, bias=False)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        with torch.autocast(x.device.type, enabled=False):
            return super().forward(x.float())


class InvertedResidual(nn.Module):
    """Expand, 5×5 depthwise, project, about an identity."""

    def __init__(self, channels: int, expansion: int) -> None:
        super().__init__()
        wide = expansion * channels
        self.body = nn.Sequential(
            conv(channels, wide, 1),
            nn.Sequential(Depthwise(wide), nn.BatchNorm2d(wide), nn.ReLU(inplace=True)),
            nn.Conv2d(wide, channels, 1, bias=False),
            nn.BatchNorm2d(channels),
        )

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        return x + self.body(x)


class Attention(nn.Module):
    """Self-attention over all cells, so that each knows the whole scene. Places are known by the ray channels."""

    def __init__(self, channels: int, heads: int = 4) -> None:
        super().__init__()
        self.heads = heads
        self.norm = nn.BatchNorm2d(channels)
        self.mix = nn.Conv2d(channels, 3 * channels, 1)
        self.out = nn.Conv2d(channels, channels, 1)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        batch, channels, height, width = x.shape
        mixed = self.mix(self.norm(x)).reshape(batch, 3, self.heads, channels // self.heads, height * width)
        query, key, value = mixed[:, 0], mixed[:, 1], mixed[:, 2]
        weights = torch.softmax(query.transpose(2, 3) @ key * (channels // self.heads) ** -0.5, dim=-1)
        seen = (value @ weights.transpose(2, 3)).reshape(batch, channels, height, width)
        return x + self.out(seen)


class Up(nn.Module):
    """The coarser level enlarged, beside the encoder's features of this one."""

    def __init__(self, coarse: int, skip: int, outputs: int, mix: nn.Module) -> None:
        super().__init__()
        self.coarse, self.skip = nn.Conv2d(coarse, outputs, 1), nn.Conv2d(skip, outputs, 1)
        self.mix = mix

    def forward(self, coarse: torch.Tensor, skip: torch.Tensor) -> torch.Tensor:
        up = F.interpolate(self.coarse(coarse), size=skip.shape[2:], mode="bilinear", align_corners=False)
        return self.mix(F.relu(up + self.skip(skip)))


class PolarNet(nn.Module):
    """`network(x)`: B×6×H×W (see `network_input`), sides multiples of 32, to the OUTPUTS, B×C×H/2×W/2."""

    def __init__(self) -> None:
        super().__init__()
        c, d = _CHANNELS, _DECODED
        self.stem = nn.Sequential(conv(CHANNELS, c[0], 3, 2), conv(c[0], c[0]))
        self.quarter = nn.Sequential(conv(c[0], c[1], 3, 2), Residual(c[1]))
        self.eighth = nn.Sequential(conv(c[1], c[2], 3, 2), Residual(c[2]), Residual(c[2]))
        self.sixteenth = nn.Sequential(conv(c[2], c[3], 3, 2), *(InvertedResidual(c[3], 3) for _ in range(4)))
        self.coarsest = nn.Sequential(
            conv(c[3], c[4], 3, 2),
            InvertedResidual(c[4], 2),
            Attention(c[4]),
            InvertedResidual(c[4], 2),
            conv(c[4], d[4], 1),
        )
        self.up = nn.ModuleList(Up(d[i + 1], c[i], d[i], Residual(d[i]) if i else conv(d[i], d[i])) for i in range(4))
        self.head = nn.Sequential(conv(d[0], 32), nn.Conv2d(32, 7, 1))

    def forward(self, x: torch.Tensor) -> tuple[torch.Tensor, ...]:
        features = [self.stem(x)]
        for stage in (self.quarter, self.eighth, self.sixteenth):
            features.append(stage(features[-1]))
        decoded = self.coarsest(features[-1])
        for up, skip in zip(reversed(self.up), reversed(features), strict=True):
            decoded = up(decoded, skip)
        out = self.head(decoded).float()
        normal = F.normalize(out[:, 1:4], dim=1)
        return out[:, :1], normal, out[:, 4:5], out[:, 5:6], out[:, 6:7]


def parameter_count(network: nn.Module) -> int:
    """Number of weights."""
    return sum(p.numel() for p in network.parameters())
