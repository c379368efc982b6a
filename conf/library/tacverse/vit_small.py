"""ViT-S/16 (Dosovitskiy et al. 2021, arXiv:2010.11929), which the authors of TacVerse train; here from scratch.

Positions are learnt for images of 224 pixels and are interpolated for others.
"""

import torch
from torch import nn


class Block(nn.Module):
    """Attention over all places and two layers at each, each after a layer norm and beside a shortcut."""

    def __init__(self, width, heads):
        super().__init__()
        self.heads = heads
        self.norm1 = nn.LayerNorm(width, eps=1e-6)
        self.all = nn.Linear(width, 3 * width)
        self.join = nn.Linear(width, width)
        self.norm2 = nn.LayerNorm(width, eps=1e-6)
        self.layers = nn.Sequential(nn.Linear(width, 4 * width), nn.GELU(), nn.Linear(4 * width, width))

    def forward(self, x):
        """Keep the shape (N, places, width)."""
        n, places, width = x.shape
        parts = self.all(self.norm1(x)).reshape(n, places, 3, self.heads, width // self.heads)
        query, key, value = parts.permute(2, 0, 3, 1, 4).unbind(0)
        weights = torch.softmax(query @ key.transpose(-2, -1) * (width // self.heads) ** -0.5, dim=-1)
        x = x + self.join((weights @ value).transpose(1, 2).reshape(n, places, width))
        return x + self.layers(self.norm2(x))


class SingleLabelClassCNN(nn.Module):
    """Maps a tactile image to one logit for each class."""

    def __init__(self, in_channels=3, num_classes=9, width=384, depth=12, heads=6):
        super().__init__()
        self.patches = nn.Conv2d(in_channels, width, 16, 16)
        self.token = nn.Parameter(torch.zeros(1, 1, width))
        self.own_place = nn.Parameter(torch.zeros(1, 1, width))
        self.places = nn.Parameter(0.02 * torch.randn(1, width, 14, 14))
        self.blocks = nn.Sequential(*[Block(width, heads) for _ in range(depth)])
        self.norm = nn.LayerNorm(width, eps=1e-6)
        self.classifier = nn.Linear(width, num_classes)

    def forward(self, x):
        """Turn standardised images of shape (N, in_channels, height, width) into (N, num_classes) logits."""
        x = self.patches(x)
        places = nn.functional.interpolate(self.places, size=x.shape[2:], mode="bilinear", align_corners=False)
        token = (self.token + self.own_place).expand(len(x), -1, -1)
        x = torch.cat([token, (x + places).flatten(2).transpose(1, 2)], dim=1)
        return self.classifier(self.norm(self.blocks(x))[:, 0])
