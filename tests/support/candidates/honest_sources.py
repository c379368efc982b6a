"""Candidates that look like those of lying_sources.py and are honest."""

from gate_cases import VALID, candidate
from lying_sources import GOOD, RETURN, before, builds, method

HONEST = {
    "data in the constructor": builds("self.conv.weight.data.normal_()"),
    "no_grad in the constructor": builds("with torch.no_grad():\n    self.conv.bias.zero_()"),
    "loop in the constructor": builds(
        "for m in self.modules():\n    if isinstance(m, nn.Conv2d):\n        nn.init.kaiming_normal_(m.weight)"
    ),
    "method that the constructor calls": method(
        "def _start(self):\n    for p in self.parameters():\n        p.data.neg_()", builds("self._start()")
    ),
    "apply with a method": method(
        "def _start(self, m):\n    if hasattr(m, 'bias'):\n        m.bias.data.zero_()",
        builds("self.apply(self._start)"),
    ),
    "apply with a function": before(
        "def start(m):\n    if hasattr(m, 'weight'):\n        nn.init.zeros_(m.weight)", builds("self.apply(start)")
    ),
    "apply with a lambda": builds("self.apply(lambda m: hasattr(m, 'bias') and m.bias.data.zero_())"),
    "apply with a lambda that has a name": builds(
        "start = lambda m: hasattr(m, 'bias') and nn.init.zeros_(m.bias)\nself.apply(start)"
    ),
    "function that makes a layer": before(
        "def made(i, o):\n    layer = nn.Linear(i, o)\n    nn.init.zeros_(layer.weight)\n    return layer",
        candidate(f"return self.last({GOOD}) + {GOOD}", "self.last = made(3, 3)"),
    ),
    "moving average beside the weights": candidate(
        f"y = {GOOD}\nif self.training:\n    with torch.no_grad():\n        self.weight_seen += y.mean()\nreturn y",
        "self.register_buffer('weight_seen', torch.zeros(1))",
    ),
    "rows that an index selects, which are a copy": candidate(
        f"rows = self.table[self.index]\nrows += 1.0\nreturn {GOOD} + rows.mean(0)",
        "self.table = nn.Parameter(torch.zeros(16, 3))\nself.register_buffer('index', torch.arange(16))",
    ),
    "reading the mode": candidate(f"return F.dropout({GOOD}, 0.2, self.training)"),
    "running statistics": candidate(
        "y = self.norm(self.conv(x))\nreturn self.head(y.mean((2, 3)))", "self.norm = nn.BatchNorm2d(4)"
    ),
    "own statistics": candidate(
        "if self.training:\n    with torch.no_grad():\n        self.seen.mul_(0.9).add_(0.1 * x.mean())\n"
        f"return {GOOD} - self.seen",
        "self.register_buffer('seen', torch.zeros(3))",
    ),
    "in-place activation": candidate(
        "y = self.head(F.relu_(self.conv(x)).mean((2, 3)))\ny.add_(self.head.bias)\ny += 1\nreturn y"
    ),
    "extra_repr": method("def extra_repr(self):\n    return 'small'"),
    "repr": method("def __repr__(self):\n    return 'small'"),
    "own names of local variables": candidate(f"half, float, type = 1, 2, 3\nreturn {GOOD} * half"),
    "tied weights": candidate(
        f"return self.twin({GOOD}) + {GOOD}",
        "self.twin = nn.Linear(3, 3)\nself.other = nn.Linear(3, 3)\nself.twin.weight = self.other.weight",
    ),
    "weights that are computed once for a batch": candidate(
        f"return self.last({GOOD})", "self.last = nn.utils.parametrizations.orthogonal(nn.Linear(3, 3))"
    ),
    "spectral norm": builds("self.conv = nn.utils.parametrizations.spectral_norm(nn.Conv2d(in_channels, 4, 3))"),
    "weight norm": builds("self.conv = nn.utils.parametrizations.weight_norm(nn.Conv2d(in_channels, 4, 3))"),
    "spectral norm of the old kind": builds("self.conv = nn.utils.spectral_norm(nn.Conv2d(in_channels, 4, 3))"),
    "frozen layer": builds("self.conv.requires_grad_(False)"),
    "layers by computed names": candidate(
        f"return getattr(self, f'last{{0}}')({GOOD})",
        "for i in (0, 1):\n    setattr(self, f'last{i}', nn.Linear(3, 3))",
    ),
    "module list": candidate(
        f"y = {GOOD}\nfor layer in self.more:\n    y = layer(y)\nreturn y",
        "self.more = nn.ModuleList([nn.Linear(3, 3) for _ in range(2)])",
    ),
    "parameter list": candidate(
        f"return {GOOD} + sum(self.more)", "self.more = nn.ParameterList([torch.zeros(3) for _ in range(2)])"
    ),
    "device of its weights": candidate(f"x = x.to(next(self.parameters()).device)\n{RETURN}"),
    "usage below the class": VALID
    + '\n\nif __name__ == "__main__":\n    model = ImageRegressionCNN()\n    model.eval()\n'
    "    model(torch.randn(2, 3, 64, 64)).mean().backward()\n    print(model.conv.weight.grad.norm())\n",
}
