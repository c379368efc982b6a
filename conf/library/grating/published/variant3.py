"""The paper's grating variant 3, rebuilt from its list of changes.

Wider convolutions in residual blocks, batch and layer normalisation, GELU, and a head of four layers without dropout.
conf/library/README.md says what we had to choose.
"""

from torch import nn


class Residual(nn.Module):
    """A convolution with batch normalisation, around which a 1x1 convolution carries its input."""

    def __init__(self, inputs, outputs, activation):
        super().__init__()
        self.conv = nn.Conv2d(inputs, outputs, kernel_size=3, padding=1)
        self.norm = nn.BatchNorm2d(outputs)
        self.shortcut = nn.Conv2d(inputs, outputs, kernel_size=1)
        self.activation = activation

    def forward(self, x):
        """Return the sum of both ways, activated."""
        return self.activation(self.norm(self.conv(x)) + self.shortcut(x))


class SingleLabelClassCNN(nn.Module):
    """Maps a tactile image to one logit for each grating."""

    def __init__(self, in_channels=3, num_classes=7):
        super().__init__()
        self.conv1 = nn.Sequential(
            Residual(in_channels, 40, nn.GELU()),
            nn.MaxPool2d(2),
        )
        self.conv2 = nn.Sequential(
            Residual(40, 80, nn.GELU()),
            nn.MaxPool2d(2),
        )
        self.conv3 = nn.Sequential(
            Residual(80, 160, nn.GELU()),
            nn.MaxPool2d(2),
        )
        self.adaptive_pool = nn.AdaptiveAvgPool2d((4, 4))
        self.classifier = nn.Sequential(
            nn.Flatten(),
            nn.Linear(160 * 4 * 4, 512),
            nn.LayerNorm(512),
            nn.GELU(),
            nn.Linear(512, 256),
            nn.LayerNorm(256),
            nn.GELU(),
            nn.Linear(256, 128),
            nn.LayerNorm(128),
            nn.GELU(),
            nn.Linear(128, num_classes),
        )

    def forward(self, x):
        """Turn standardised images of shape (N, in_channels, height, width) into (N, num_classes) logits."""
        x = self.conv1(x)
        x = self.conv2(x)
        x = self.conv3(x)
        x = self.adaptive_pool(x)
        return self.classifier(x)
