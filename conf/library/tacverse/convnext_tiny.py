"""ConvNeXt-T (Liu et al. 2022, arXiv:2201.03545), which the authors of TacVerse train; here from scratch."""

import torch
from torch import nn


class ChannelNorm(nn.Module):
    """A layer norm over the channels of each place."""

    def __init__(self, channels):
        super().__init__()
        self.norm = nn.LayerNorm(channels, eps=1e-6)

    def forward(self, x):
        """Keep the shape (N, channels, height, width)."""
        return self.norm(x.permute(0, 2, 3, 1)).permute(0, 3, 1, 2)


class Block(nn.Module):
    """A depthwise 7x7 convolution and two layers at each place, scaled, beside a shortcut."""

    def __init__(self, channels):
        super().__init__()
        self.depthwise = nn.Conv2d(channels, channels, 7, padding=3, groups=channels)
        self.norm = nn.LayerNorm(channels, eps=1e-6)
        self.wide = nn.Linear(channels, 4 * channels)
        self.activation = nn.GELU()
        self.narrow = nn.Linear(4 * channels, channels)
        self.scale = nn.Parameter(torch.full((channels,), 1e-6))

    def forward(self, x):
        """Keep the shape."""
        y = self.norm(self.depthwise(x).permute(0, 2, 3, 1))
        return x + (self.scale * self.narrow(self.activation(self.wide(y)))).permute(0, 3, 1, 2)


class SingleLabelClassCNN(nn.Module):
    """Maps a tactile image to one logit for each class."""

    def __init__(self, in_channels=3, num_classes=9):
        super().__init__()
        stages = [nn.Conv2d(in_channels, 96, 4, 4), ChannelNorm(96)]
        before = 96
        for channels, depth in ((96, 3), (192, 3), (384, 9), (768, 3)):
            if channels > before:
                stages += [ChannelNorm(before), nn.Conv2d(before, channels, 2, 2)]
            stages += [Block(channels) for _ in range(depth)]
            before = channels
        self.stages = nn.Sequential(*stages)
        self.adaptive_pool = nn.AdaptiveAvgPool2d(1)
        self.norm = nn.LayerNorm(768, eps=1e-6)
        self.classifier = nn.Linear(768, num_classes)

    def forward(self, x):
        """Turn standardised images of shape (N, in_channels, height, width) into (N, num_classes) logits."""
        return self.classifier(self.norm(self.adaptive_pool(self.stages(x)).flatten(1)))
