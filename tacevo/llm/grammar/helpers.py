"""The helper classes that a rendered network may bring along, as source text."""

SPATIAL_ATTENTION = '''\
class SpatialAttention(nn.Module):
    """Weights the positions of a feature map by the mean and the maximum over its channels."""

    def __init__(self, kernel_size=7):
        super().__init__()
        self.conv = nn.Conv2d(2, 1, kernel_size=kernel_size, padding=kernel_size // 2)

    def forward(self, x):
        summary = torch.cat([x.mean(dim=1, keepdim=True), x.amax(dim=1, keepdim=True)], dim=1)
        return x * torch.sigmoid(self.conv(summary))'''

CHANNEL_ATTENTION = '''\
class ChannelAttention(nn.Module):
    """Weights the channels of a feature map by their means over all positions."""

    def __init__(self, channels, reduction=8):
        super().__init__()
        squeezed = max(channels // reduction, 4)
        self.gate = nn.Sequential(
            nn.Linear(channels, squeezed),
            nn.ReLU(),
            nn.Linear(squeezed, channels),
            nn.Sigmoid(),
        )

    def forward(self, x):
        weights = self.gate(x.mean(dim=(2, 3)))
        return x * weights[:, :, None, None]'''

CONV_BLOCK = '''\
class ConvBlock(nn.Module):
    """A convolution, depthwise separable if asked, and the layers that follow it."""

    def __init__(self, in_channels, out_channels, kernel_size, layers, stride=1, separable=False):
        super().__init__()
        padding = kernel_size // 2
        if separable:
            self.conv = nn.Sequential(
                nn.Conv2d(in_channels, in_channels, kernel_size, stride, padding, groups=in_channels),
                nn.Conv2d(in_channels, out_channels, kernel_size=1),
            )
        else:
            self.conv = nn.Conv2d(in_channels, out_channels, kernel_size, stride, padding)
        self.layers = nn.Sequential(*layers)

    def forward(self, x):
        return self.layers(self.conv(x))'''
