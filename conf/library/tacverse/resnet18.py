"""ResNet-18 (He et al. 2016, arXiv:1512.03385), which the authors of TacVerse train; here from scratch."""

import torch
from torch import nn


class Block(nn.Module):
    """Two 3x3 convolutions beside a shortcut."""

    def __init__(self, before, channels, stride):
        super().__init__()
        self.conv1 = nn.Conv2d(before, channels, 3, stride, 1, bias=False)
        self.norm1 = nn.BatchNorm2d(channels)
        self.conv2 = nn.Conv2d(channels, channels, 3, 1, 1, bias=False)
        self.norm2 = nn.BatchNorm2d(channels)
        self.shortcut = nn.Identity()
        if stride > 1:
            self.shortcut = nn.Sequential(nn.Conv2d(before, channels, 1, stride, bias=False), nn.BatchNorm2d(channels))

    def forward(self, x):
        """Keep the shape, but for the stride and the channels."""
        y = torch.relu(self.norm1(self.conv1(x)))
        return torch.relu(self.norm2(self.conv2(y)) + self.shortcut(x))


class SingleLabelClassCNN(nn.Module):
    """Maps a tactile image to one logit for each class."""

    def __init__(self, in_channels=3, num_classes=9):
        super().__init__()
        self.conv1 = nn.Sequential(
            nn.Conv2d(in_channels, 64, 7, 2, 3, bias=False), nn.BatchNorm2d(64), nn.ReLU(), nn.MaxPool2d(3, 2, 1)
        )
        stages = []
        for before, channels, stride in ((64, 64, 1), (64, 128, 2), (128, 256, 2), (256, 512, 2)):
            stages += [Block(before, channels, stride), Block(channels, channels, 1)]
        self.stages = nn.Sequential(*stages)
        self.adaptive_pool = nn.AdaptiveAvgPool2d(1)
        self.classifier = nn.Linear(512, num_classes)

    def forward(self, x):
        """Turn standardised images of shape (N, in_channels, height, width) into (N, num_classes) logits."""
        return self.classifier(self.adaptive_pool(self.stages(self.conv1(x))).flatten(1))
