"""Candidates that misreport themselves: each with the reason of the policy and, past the policy, of the probe.

`None` stands for "admitted". All are harmless: they only lie about their size, their mode or their optimiser.
"""

from dataclasses import dataclass

from gate_cases import VALID, candidate

from tacevo.evolution.lines import MISREPORTING
from tacevo.records import Reason

NAMES, WEIGHTS, MODE, HIDDEN, BATCH, LEARNS = MISREPORTING
HOOK = Reason.forbidden_name

GOOD = "self.head(F.relu(self.conv(x)).mean((2, 3)))"
RETURN = f"return {GOOD}"


@dataclass(frozen=True)
class Lie:
    """One candidate."""

    source: str
    policy: Reason | None
    probe: Reason | None


def does(code: str) -> str:
    """Begin the forward pass of a candidate with other lines."""
    return candidate(f"{code}\n{RETURN}")


def builds(code: str) -> str:
    """End the constructor of a candidate with other lines."""
    return candidate(RETURN, code)


def before(code: str, rest: str = VALID) -> str:
    """Put lines before a candidate."""
    return f"{code}\n\n\n{rest}"


def method(code: str, source: str = VALID) -> str:
    """Add lines to the body of the class, before its constructor."""
    lines = "\n".join(f"    {line}" for line in code.split("\n"))
    return source.replace("    def __init__", f"{lines}\n\n    def __init__", 1)


def _with_base(base: str, code: str) -> str:
    return before(code, VALID.replace("(nn.Module)", f"({base})"))


#: Methods of its own, a wide head that they do not count, and an optimiser of its own.
_FULL = """class ImageRegressionCNN(nn.Module):
    def __init__(self, in_channels=3, num_outputs=3):
        super().__init__()
        self.conv = nn.Conv2d(in_channels, 16, 3)
        self.wide = nn.Linear(16, 1000)
        self.last = nn.Linear(1000, num_outputs)

    def parameters(self, recurse=True):
        return self.conv.parameters()

    def named_parameters(self, prefix="", recurse=True, remove_duplicate=True):
        return self.conv.named_parameters()

    def train(self, mode=True):
        return self

    def eval(self):
        return self

    def state_dict(self, *args, **kwargs):
        return self.conv.state_dict()

    def load_state_dict(self, *args, **kwargs):
        return None

    def forward(self, x):
        for layer in (self.wide, self.last):
            for p in (layer.weight, layer.bias):
                if p.grad is not None:
                    p.data.add_(p.grad, alpha=-1e-3)
                    p.grad = None
        return self.last(F.relu(self.wide(F.relu(self.conv(x)).mean((2, 3)))))
"""

_KEPT_ON = "class Kept(nn.Dropout):\n    def train(self, mode=True):\n        return self"

#: Sources by name, under their kind and the reasons of policy and probe.
_SOURCES: dict[tuple[str, Reason | None, Reason | None], dict[str, str]] = {
    ("name", NAMES, NAMES): {
        "everything at once": _FULL,
        "class attribute": method("parameters = lambda self, recurse=True: self.conv.parameters()"),
        "annotated attribute": method("eval: object = lambda self: self"),
        "unpacked attribute": method("eval, (a, *train) = (lambda self: self), (1, 2)"),
        "walrus": method("a = (eval := lambda self: self)"),
        "walrus in a default": method("def f(self, a=(eval := 3)):\n    return a"),
        "loop target": method("for eval in [lambda self: self]:\n    pass"),
        "import as": method("from functools import partial as train"),
        "import": before("", method("import math as train")),
        "with as": method("with torch.no_grad() as buffers:\n    pass"),
        "nested class": method("class modules:\n    pass"),
        "pattern": method("match [1, 2]:\n    case [a, *eval]:\n        pass"),
        "under a condition": method("if True:\n    def eval(self):\n        return self"),
        "property with a setter": method("training = property(lambda self: True, lambda self, value: None)"),
        "wrapped": before("from functools import partial", method("eval = partial(nn.Module.train, mode=True)")),
        "set in the constructor": builds("self.eval = lambda: self"),
        "set by a loop": builds("for self.eval in [lambda: self]:\n    pass"),
        "set by setattr": builds("setattr(self, 'train', lambda mode=True: self)"),
        "set on a layer": builds("self.conv.parameters = lambda: iter([])"),
        "set on the class": builds("type(self).eval = lambda self: self"),
        "set on the class from outside": before(VALID, "ImageRegressionCNN.train = lambda self, mode: self"),
        "set by a decorator of the class": before(
            "def quiet(kind):\n    kind.eval = lambda self: self\n    return kind\n\n\n@quiet"
        ),
        "inherited": _with_base("Quiet", "class Quiet(nn.Module):\n    def eval(self):\n        return self"),
        "mixed in": _with_base("Quiet, nn.Module", "class Quiet:\n    def eval(self):\n        return self"),
        "kept dropout": before(_KEPT_ON, candidate(f"return self.drop({GOOD})", "self.drop = Kept()")),
        "list that hides its layers": before(
            "class Few(nn.ModuleList):\n    def parameters(self, recurse=True):\n        return iter([])",
            candidate(
                "for layer in self.layers:\n    x = layer(x)\n" + RETURN, "self.layers = Few([nn.Conv2d(3, 3, 1)])"
            ),
        ),
        "nested helper": method(
            "class Part(nn.Module):\n    def modules(self):\n        return iter([])", builds("self.part = self.Part()")
        ),
        "call": method("def __call__(self, x):\n    return self.forward(x)"),
        "getattr": method("def __getattr__(self, name):\n    return super().__getattr__(name)"),
        "private name": method("def _named_members(self, *a, **k):\n    return iter([])"),
        "class made by type": before(
            "Quiet = type('Quiet', (nn.Module,), {'eval': lambda self: self})", VALID.replace("(nn.Module)", "(Quiet)")
        ),
        "class that is changed in forward": does("self.__class__ = Quiet")
        + "\n\nclass Quiet(ImageRegressionCNN):\n    def eval(self):\n        return self\n",
    },
    ("name", NAMES, None): {"deleted": method("def train(self):\n    pass\ndel train")},
    ("name", NAMES, Reason.construction_failed): {
        "property": method("@property\ndef training(self):\n    return True")
    },
    ("name", NAMES, MODE): {
        "set by an augmented assignment": does("self.training |= True"),
        "mode set in forward": does("self.training = True"),
        "mode of a layer set in forward": does("self.conv.training = True"),
        "deleted in forward": does("del self.training\nself.train(True)"),
    },
    ("name", Reason.forbidden_construct, NAMES): {
        "slot": method("__slots__ = ('training',)"),
        "metaclass that hides its class's names": before(
            "class Meta(type):\n    @property\n    def __dict__(cls):\n        return {}",
            method("def eval(self):\n    return self").replace("(nn.Module)", "(nn.Module, metaclass=Meta)"),
        ),
    },
    ("name", None, NAMES): {
        "name made at run time": builds("setattr(self, 'tr' + 'ain', lambda mode=True: self)"),
        "name made at run time, on the class": builds(
            "setattr(self.__class__, 'para' + 'meters', lambda self: iter([]))"
        ),
        "name made in forward": does("setattr(self, 'ev' + 'al', lambda: self)"),
        "class that names another module as its own": before(
            "class Kept(nn.Dropout):\n    pass\n\n\n"
            "setattr(Kept, 'train' + 'ing', property(lambda self: True, lambda self, value: None))\n"
            "setattr(Kept, '__mod' + 'ule__', 'torch.nn')",
            candidate(f"return self.drop({GOOD})", "self.drop = Kept(0.3)"),
        ),
    },
    ("name", Reason.forbidden_name, NAMES): {
        "class made by its metaclass, as torch's own": before(
            "Meta = type(nn.Linear(1, 1)).__class__\n"
            "Kept = Meta('Kept', (nn.Dropout,), {'__module__': 'torch.nn', 'train': lambda self, mode=True: self,\n"
            "    'training': property(lambda self: True, lambda self, value: None)})",
            candidate(f"return self.drop({GOOD})", "self.drop = Kept(0.3)"),
        ),
        "every attribute at once": before(
            "class Kept(nn.Dropout):\n    pass\n\n\n"
            "def answer(self, name):\n"
            "    return True if name == 'training' else nn.Dropout.__base__.__base__.__getattribute__(self, name)\n\n\n"
            "setattr(Kept, '__getattri' + 'bute__', answer)",
            candidate(f"return self.drop({GOOD})", "self.drop = Kept(0.3)"),
        ),
    },
    ("weights", WEIGHTS, WEIGHTS): {
        "data": does("self.conv.weight.data.add_(1)"),
        "data by getattr": does("getattr(self.conv.weight, 'data').add_(1)"),
        "step without a gradient": does("with torch.no_grad():\n    self.conv.bias.add_(1)"),
        "own parameter": candidate(
            f"with torch.no_grad():\n    self.scale.mul_(0.9)\nreturn {GOOD} * self.scale",
            "self.scale = nn.Parameter(torch.ones(3))",
        ),
        "assigned element": does("with torch.no_grad():\n    self.conv.bias[0] = 3"),
        "augmented assignment": does("with torch.no_grad():\n    self.conv.bias[:] += 1"),
        "variable": does("w = self.conv.weight\nwith torch.no_grad():\n    w.neg_()"),
        "all parameters": does("with torch.no_grad():\n    for p in self.parameters():\n        p.neg_()"),
        "initialised again": does("nn.init.normal_(self.conv.weight)"),
        "written to": does("with torch.no_grad():\n    torch.neg(self.conv.bias, out=self.conv.bias)"),
        "in evaluation only": does("if not self.training:\n    self.conv.weight.data.zero_()"),
        "by a method": method("def _step(self):\n    self.conv.weight.data.zero_()", does("self._step()")),
        "by a function that the constructor calls, too": before(
            "def start(m):\n    m.weight.data.normal_()", candidate("start(self.conv)\n" + RETURN, "start(self.conv)")
        ),
        "by a lambda": candidate("self.step()\n" + RETURN, "self.step = lambda: self.conv.weight.data.zero_()"),
        "by another name": method(
            "def _step(self):\n    self.conv.weight.data.neg_()",
            candidate("self.go()\n" + RETURN, "self.go = self._step"),
        ),
        "by a lambda in a list": candidate(
            "self.steps[0]()\n" + RETURN, "self.steps = [lambda: self.conv.weight.data.neg_()]"
        ),
        "by apply": does("self.apply(lambda m: hasattr(m, 'weight') and m.weight.data.neg_())"),
        "by an activation's property": before(
            "class Act:\n    def __init__(self, w):\n        self.w = w\n\n    @property\n    def go(self):\n"
            "        self.w.data.neg_()",
            does("Act(self.conv.weight).go"),
        ),
        "detached": does("with torch.no_grad():\n    self.conv.bias.detach().neg_()"),
    },
    ("weights", WEIGHTS, LEARNS): {
        "by an optimiser": candidate(
            "loss = self.conv(x).square().mean()\nloss.backward()\n"
            "torch.optim.SGD(self.conv.parameters(), 0.1).step()\n" + RETURN
        ),
    },
    ("weights", WEIGHTS, None): {"gradient": does("self.conv.bias.grad = None")},
    ("weights", HOOK, WEIGHTS): {
        "by a hook": before(
            "def change(module, inputs, output):\n    module.weight.data.mul_(2)",
            builds("self.conv.register_forward_hook(change)"),
        ),
        "by a hook of the backward pass": builds(
            "self.head.register_full_backward_hook(lambda m, i, o: (m.weight.data.mul_(2), None)[1])"
        ),
        "by a hook of a tensor": candidate(
            f"y = {GOOD}\ny.register_hook(lambda g: (self.conv.weight.data.mul_(2), None)[1])\nreturn y"
        ),
        "by a hook of a parameter": builds(
            "self.conv.weight.register_post_accumulate_grad_hook(lambda p: (p.data.neg_(), None)[1])"
        ),
        "by a hook that stands in a dictionary": builds(
            "self.conv._forward_pre_hooks[0] = lambda m, i: (m.weight.data.neg_(), None)[1]"
        ),
    },
    ("weights", None, WEIGHTS): {
        "by a hook with a computed name": before(
            "def change(module, inputs, output):\n    module.weight.data.mul_(2)",
            builds("getattr(self.conv, 'register_forward_' + 'hook')(change)"),
        ),
        "as statistics of a batch": does("F.batch_norm(self.conv(x), *self.kept(), training=True)").replace(
            "    def forward",
            "    def kept(self):\n        return self.conv.bias.detach(), torch.ones(4)\n\n    def forward",
        ),
        "new parameters in each pass": does("self.conv.weight = nn.Parameter(self.conv.weight * 0.99)"),
        "parameter that is taken away": candidate(
            "self.spare = None\n" + RETURN, "self.spare = nn.Parameter(torch.ones(3))"
        ),
        "layer made in forward": candidate(
            "if self.late is None:\n    self.late = nn.Linear(3, 3)\nreturn self.late(" + GOOD + ")", "self.late = None"
        ),
        "name made at run time": does("getattr(self.conv.weight, 'da' + 'ta').add_(1)"),
        "through a view": does("with torch.no_grad():\n    self.conv.weight.view(-1).neg_()"),
        "through a partial function": "from functools import partial\n"
        + candidate(
            "with torch.no_grad():\n    self.go()\n" + RETURN, "self.go = partial(torch.Tensor.neg_, self.conv.weight)"
        ),
    },
    ("weights", HOOK, None): {
        "by a hook that steps in large batches": candidate(
            f"self.images = x.shape[0]\n{RETURN}",
            "self.images = 0\nkernel = self.conv.weight\n\ndef descend(slope):\n    if self.images > 16:\n"
            "        with torch.no_grad():\n            kernel.sub_(slope, alpha=0.1)\n\nkernel.register_hook(descend)",
        ),
        "by a hook of a wide part that only large batches use": candidate(
            "y = F.relu(self.conv(x)).mean((2, 3))\nif x.shape[0] > 16:\n"
            "    parts = [part.weight for part in self.kept]\n"
            "    for part in parts:\n        def descend(slope, part=part):\n            with torch.no_grad():\n"
            "                part.sub_(slope, alpha=0.01)\n        if self.training:\n"
            "            part.register_hook(descend)\n"
            "    y = y + self.kept[1](F.relu(self.kept[0](y)))\nreturn self.head(y)",
            "self.kept = [nn.Linear(4, 512), nn.Linear(512, 4)]",
        ),
    },
    ("weights", Reason.forbidden_construct, WEIGHTS): {
        "by a finaliser": before(
            "class Last:\n    def __init__(self, w):\n        self.w = w\n\n    def __del__(self):\n"
            "        self.w.data.neg_()",
            does("Last(self.conv.weight)"),
        ),
    },
    ("mode", MODE, MODE): {
        "trains for ever": does("self.train()"),
        "layer trains for ever": does("self.conv.train()"),
        "through the class": does("nn.Module.train(self, True)"),
        "statistics stay": does("self.conv.eval()"),
    },
    ("mode", HOOK, MODE): {
        "by a hook": builds("self.conv.register_forward_pre_hook(lambda m, i: (m.train(), None)[1])")
    },
    ("mode", None, MODE): {"name made at run time": does("getattr(self, 'tr' + 'ain')()")},
    ("hidden", None, HIDDEN): {
        "wide layer in a list": candidate(
            "return self.last(self.wide[0](self.conv(x).mean((2, 3))))",
            "self.wide = [nn.Linear(4, 5000)]\nself.last = nn.Linear(5000, 3)",
        ),
        "layer in a closure": candidate(
            "return self.last(x) + " + GOOD, "wide = nn.Linear(3, 3)\nself.last = lambda x: wide(x.mean((2, 3)))"
        ),
        "global layer": before("WIDE = nn.Linear(3, 3)", candidate(f"return {GOOD} + WIDE(x.mean((2, 3)))")),
        "copy of the network": "from copy import deepcopy\n"
        + candidate(f"return {GOOD} + self.twin[0](self.conv(x).mean((2, 3)))", "self.twin = [deepcopy(self.head)]"),
        "tensor that learns": candidate(f"return {GOOD} + self.free", "self.free = torch.zeros(3, requires_grad=True)"),
        "tensor that learns alone": candidate(
            "return x.mean((2, 3)) + self.free", "self.free = torch.zeros(3, requires_grad=True)"
        ),
        "buffer that learns": candidate(
            f"return {GOOD} + self.free", "self.register_buffer('free', torch.zeros(3, requires_grad=True))"
        ),
        "output of its own": candidate("return torch.zeros(len(x), 3, requires_grad=True)"),
        "parameter taken off the list": candidate(
            "return self.head(F.relu(F.conv2d(x, self.kept[0])).mean((2, 3)))",
            "self.kept = [self.conv._parameters.pop('weight')]",
        ),
    },
    ("batch", None, BATCH): {
        "wide for more than one image": candidate(
            f"if x.shape[0] == 1:\n    {RETURN}\nreturn self.wide(x)",
            "self.wide = nn.Sequential(nn.Conv2d(in_channels, 64, 3, padding=1), nn.ReLU(), nn.Conv2d(64, 64, 3),\n"
            "    nn.GELU(), nn.AdaptiveAvgPool2d(1), nn.Flatten(), nn.Linear(64, num_outputs))",
        ),
        "the same operations, at a lower resolution for one image": candidate(
            f"x = F.interpolate(x, size=8 if len(x) == 1 else 32)\n{RETURN}"
        ),
        "the same operations, at a higher resolution for one image": candidate(
            f"x = F.interpolate(x, size=32 if len(x) == 1 else 8)\n{RETURN}"
        ),
    },
}

LIES = {
    f"{kind}: {name}": Lie(source, policy, probe)
    for (kind, policy, probe), sources in _SOURCES.items()
    for name, source in sources.items()
}
