"""Candidates that misreport themselves: each with the reason of the policy and, past the policy, of the probe.

`None` stands for "admitted". All are harmless: they only lie about their size, their mode or their optimiser.
"""

from dataclasses import dataclass

from gate_cases import VALID, candidate

from tacevo.records import MISREPORTING, Reason

NAMES, WEIGHTS, MODE, HIDDEN, BATCH = MISREPORTING
HOOK = Reason.forbidden_name

GOOD = "self.head(F.relu(self.conv(x)).mean((2, 3)))"
RETURN = f"return {GOOD}"


@dataclass(frozen=True)
class Lie:
    """One candidate."""

    source: str
    policy: Reason | None
    probe: Reason | None


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

NAMES_TAKEN = {
    "everything at once": Lie(_FULL, NAMES, NAMES),
    "class attribute": Lie(method("parameters = lambda self, recurse=True: self.conv.parameters()"), NAMES, NAMES),
    "annotated attribute": Lie(method("eval: object = lambda self: self"), NAMES, NAMES),
    "unpacked attribute": Lie(method("eval, (a, *train) = (lambda self: self), (1, 2)"), NAMES, NAMES),
    "walrus": Lie(method("a = (eval := lambda self: self)"), NAMES, NAMES),
    "walrus in a default": Lie(method("def f(self, a=(half := 3)):\n    return a"), NAMES, NAMES),
    "loop target": Lie(method("for eval in [lambda self: self]:\n    pass"), NAMES, NAMES),
    "import as": Lie(method("from functools import partial as train"), NAMES, NAMES),
    "import": Lie(before("", method("import math as cpu")), NAMES, NAMES),
    "with as": Lie(method("with torch.no_grad() as buffers:\n    pass"), NAMES, NAMES),
    "nested class": Lie(method("class modules:\n    pass"), NAMES, NAMES),
    "pattern": Lie(method("match [1, 2]:\n    case [a, *eval]:\n        pass"), NAMES, NAMES),
    "deleted": Lie(method("def train(self):\n    pass\ndel train"), NAMES, None),
    "under a condition": Lie(method("if True:\n    def eval(self):\n        return self"), NAMES, NAMES),
    "property": Lie(method("@property\ndef training(self):\n    return True"), NAMES, Reason.construction_failed),
    "property with a setter": Lie(
        method("training = property(lambda self: True, lambda self, value: None)"), NAMES, NAMES
    ),
    "wrapped": Lie(
        before("from functools import partial", method("eval = partial(nn.Module.train, mode=True)")), NAMES, NAMES
    ),
    "set in the constructor": Lie(candidate(RETURN, "self.eval = lambda: self"), NAMES, NAMES),
    "set by an augmented assignment": Lie(candidate("self.training |= True\n" + RETURN), NAMES, MODE),
    "mode set in forward": Lie(candidate("self.training = True\n" + RETURN), NAMES, MODE),
    "mode of a layer set in forward": Lie(candidate("self.conv.training = True\n" + RETURN), NAMES, MODE),
    "set by a loop": Lie(candidate(RETURN, "for self.eval in [lambda: self]:\n    pass"), NAMES, NAMES),
    "set by setattr": Lie(candidate(RETURN, "setattr(self, 'train', lambda mode=True: self)"), NAMES, NAMES),
    "deleted in forward": Lie(candidate("del self.training\nself.train(True)\n" + RETURN), NAMES, MODE),
    "set on a layer": Lie(candidate(RETURN, "self.conv.parameters = lambda: iter([])"), NAMES, NAMES),
    "set on the class": Lie(candidate(RETURN, "type(self).eval = lambda self: self"), NAMES, NAMES),
    "set on the class from outside": Lie(
        before(VALID, "ImageRegressionCNN.train = lambda self, mode: self"), NAMES, NAMES
    ),
    "set by a decorator of the class": Lie(
        before("def quiet(kind):\n    kind.eval = lambda self: self\n    return kind\n\n\n@quiet"), NAMES, NAMES
    ),
    "inherited": Lie(
        _with_base("Quiet", "class Quiet(nn.Module):\n    def eval(self):\n        return self"), NAMES, NAMES
    ),
    "mixed in": Lie(
        _with_base("Quiet, nn.Module", "class Quiet:\n    def eval(self):\n        return self"), NAMES, NAMES
    ),
    "kept dropout": Lie(before(_KEPT_ON, candidate(f"return self.drop({GOOD})", "self.drop = Kept()")), NAMES, NAMES),
    "list that hides its layers": Lie(
        before(
            "class Few(nn.ModuleList):\n    def parameters(self, recurse=True):\n        return iter([])",
            candidate(
                "for layer in self.layers:\n    x = layer(x)\n" + RETURN, "self.layers = Few([nn.Conv2d(3, 3, 1)])"
            ),
        ),
        NAMES,
        NAMES,
    ),
    "nested helper": Lie(
        method(
            "class Part(nn.Module):\n    def modules(self):\n        return iter([])",
            candidate(RETURN, "self.part = self.Part()"),
        ),
        NAMES,
        NAMES,
    ),
    "call": Lie(method("def __call__(self, x):\n    return self.forward(x)"), NAMES, NAMES),
    "getattr": Lie(method("def __getattr__(self, name):\n    return super().__getattr__(name)"), NAMES, NAMES),
    "private name": Lie(method("def _named_members(self, *a, **k):\n    return iter([])"), NAMES, NAMES),
    "class made by type": Lie(
        before(
            "Quiet = type('Quiet', (nn.Module,), {'eval': lambda self: self})", VALID.replace("(nn.Module)", "(Quiet)")
        ),
        NAMES,
        NAMES,
    ),
    "slot": Lie(method("__slots__ = ('training',)"), Reason.forbidden_construct, NAMES),
    "metaclass that hides its class's names": Lie(
        before(
            "class Meta(type):\n    @property\n    def __dict__(cls):\n        return {}",
            method("def eval(self):\n    return self").replace("(nn.Module)", "(nn.Module, metaclass=Meta)"),
        ),
        Reason.forbidden_construct,
        NAMES,
    ),
    "class that is changed in forward": Lie(
        candidate("self.__class__ = Quiet\n" + RETURN)
        + "\n\nclass Quiet(ImageRegressionCNN):\n    def eval(self):\n        return self\n",
        NAMES,
        NAMES,
    ),
    "name made at run time": Lie(candidate(RETURN, "setattr(self, 'tr' + 'ain', lambda mode=True: self)"), None, NAMES),
    "name made at run time, on the class": Lie(
        candidate(RETURN, "setattr(self.__class__, 'para' + 'meters', lambda self: iter([]))"), None, NAMES
    ),
    "name made in forward": Lie(candidate("setattr(self, 'ev' + 'al', lambda: self)\n" + RETURN), None, NAMES),
    "class made by its metaclass, as torch's own": Lie(
        before(
            "Meta = type(nn.Linear(1, 1)).__class__\n"
            "Kept = Meta('Kept', (nn.Dropout,), {'__module__': 'torch.nn', 'train': lambda self, mode=True: self,\n"
            "    'training': property(lambda self: True, lambda self, value: None)})",
            candidate(f"return self.drop({GOOD})", "self.drop = Kept(0.3)"),
        ),
        None,
        NAMES,
    ),
    "class that names another module as its own": Lie(
        before(
            "class Kept(nn.Dropout):\n    pass\n\n\n"
            "setattr(Kept, 'train' + 'ing', property(lambda self: True, lambda self, value: None))\n"
            "setattr(Kept, '__mod' + 'ule__', 'torch.nn')",
            candidate(f"return self.drop({GOOD})", "self.drop = Kept(0.3)"),
        ),
        None,
        NAMES,
    ),
    "every attribute at once": Lie(
        before(
            "class Kept(nn.Dropout):\n    pass\n\n\n"
            "def answer(self, name):\n"
            "    return True if name == 'training' else nn.Dropout.__base__.__base__.__getattribute__(self, name)\n\n\n"
            "setattr(Kept, '__getattri' + 'bute__', answer)",
            candidate(f"return self.drop({GOOD})", "self.drop = Kept(0.3)"),
        ),
        Reason.forbidden_name,
        NAMES,
    ),
}

WEIGHTS_CHANGED = {
    "data": Lie(candidate("self.conv.weight.data.add_(1)\n" + RETURN), WEIGHTS, WEIGHTS),
    "gradient": Lie(candidate("self.conv.bias.grad = None\n" + RETURN), WEIGHTS, None),
    "data by getattr": Lie(candidate("getattr(self.conv.weight, 'data').add_(1)\n" + RETURN), WEIGHTS, WEIGHTS),
    "step without a gradient": Lie(
        candidate("with torch.no_grad():\n    self.conv.bias.add_(1)\n" + RETURN), WEIGHTS, WEIGHTS
    ),
    "own parameter": Lie(
        candidate(
            f"with torch.no_grad():\n    self.scale.mul_(0.9)\nreturn {GOOD} * self.scale",
            "self.scale = nn.Parameter(torch.ones(3))",
        ),
        WEIGHTS,
        WEIGHTS,
    ),
    "assigned element": Lie(candidate("with torch.no_grad():\n    self.conv.bias[0] = 3\n" + RETURN), WEIGHTS, WEIGHTS),
    "augmented assignment": Lie(
        candidate("with torch.no_grad():\n    self.conv.bias[:] += 1\n" + RETURN), WEIGHTS, WEIGHTS
    ),
    "variable": Lie(
        candidate("w = self.conv.weight\nwith torch.no_grad():\n    w.neg_()\n" + RETURN), WEIGHTS, WEIGHTS
    ),
    "all parameters": Lie(
        candidate("with torch.no_grad():\n    for p in self.parameters():\n        p.neg_()\n" + RETURN),
        WEIGHTS,
        WEIGHTS,
    ),
    "initialised again": Lie(candidate("nn.init.normal_(self.conv.weight)\n" + RETURN), WEIGHTS, WEIGHTS),
    "written to": Lie(
        candidate("with torch.no_grad():\n    torch.neg(self.conv.bias, out=self.conv.bias)\n" + RETURN),
        WEIGHTS,
        WEIGHTS,
    ),
    "in evaluation only": Lie(
        candidate("if not self.training:\n    self.conv.weight.data.zero_()\n" + RETURN), WEIGHTS, WEIGHTS
    ),
    "by a method": Lie(
        method("def _step(self):\n    self.conv.weight.data.zero_()", candidate("self._step()\n" + RETURN)),
        WEIGHTS,
        WEIGHTS,
    ),
    "by a function that the constructor calls, too": Lie(
        before(
            "def start(m):\n    m.weight.data.normal_()", candidate("start(self.conv)\n" + RETURN, "start(self.conv)")
        ),
        WEIGHTS,
        WEIGHTS,
    ),
    "by a lambda": Lie(
        candidate("self.step()\n" + RETURN, "self.step = lambda: self.conv.weight.data.zero_()"), WEIGHTS, WEIGHTS
    ),
    "by another name": Lie(
        method(
            "def _step(self):\n    self.conv.weight.data.neg_()",
            candidate("self.go()\n" + RETURN, "self.go = self._step"),
        ),
        WEIGHTS,
        WEIGHTS,
    ),
    "by a lambda in a list": Lie(
        candidate("self.steps[0]()\n" + RETURN, "self.steps = [lambda: self.conv.weight.data.neg_()]"),
        WEIGHTS,
        WEIGHTS,
    ),
    "by apply": Lie(
        candidate("self.apply(lambda m: hasattr(m, 'weight') and m.weight.data.neg_())\n" + RETURN), WEIGHTS, WEIGHTS
    ),
    "by a hook": Lie(
        before(
            "def change(module, inputs, output):\n    module.weight.data.mul_(2)",
            candidate(RETURN, "self.conv.register_forward_hook(change)"),
        ),
        HOOK,
        WEIGHTS,
    ),
    "by a hook of the backward pass": Lie(
        candidate(RETURN, "self.head.register_full_backward_hook(lambda m, i, o: (m.weight.data.mul_(2), None)[1])"),
        HOOK,
        WEIGHTS,
    ),
    "by a hook of a tensor": Lie(
        candidate(f"y = {GOOD}\ny.register_hook(lambda g: (self.conv.weight.data.mul_(2), None)[1])\nreturn y"),
        HOOK,
        WEIGHTS,
    ),
    "by a hook of a parameter": Lie(
        candidate(RETURN, "self.conv.weight.register_post_accumulate_grad_hook(lambda p: (p.data.neg_(), None)[1])"),
        HOOK,
        WEIGHTS,
    ),
    "by a hook that stands in a dictionary": Lie(
        candidate(RETURN, "self.conv._forward_pre_hooks[0] = lambda m, i: (m.weight.data.neg_(), None)[1]"),
        HOOK,
        WEIGHTS,
    ),
    "by a hook with a computed name": Lie(
        before(
            "def change(module, inputs, output):\n    module.weight.data.mul_(2)",
            candidate(RETURN, "getattr(self.conv, 'register_forward_' + 'hook')(change)"),
        ),
        None,
        WEIGHTS,
    ),
    "by a hook that steps in large batches": Lie(
        candidate(
            f"self.images = x.shape[0]\n{RETURN}",
            "self.images = 0\nkernel = self.conv.weight\n\ndef descend(slope):\n    if self.images > 5:\n"
            "        with torch.no_grad():\n            kernel.sub_(slope, alpha=0.1)\n\nkernel.register_hook(descend)",
        ),
        HOOK,
        None,
    ),
    "by a hook of a wide part that only large batches use": Lie(
        candidate(
            "y = F.relu(self.conv(x)).mean((2, 3))\nif x.shape[0] > 5:\n"
            "    parts = [part.weight for part in self.kept]\n"
            "    for part in parts:\n        def descend(slope, part=part):\n            with torch.no_grad():\n"
            "                part.sub_(slope, alpha=0.01)\n        if self.training:\n"
            "            part.register_hook(descend)\n"
            "    y = y + self.kept[1](F.relu(self.kept[0](y)))\nreturn self.head(y)",
            "self.kept = [nn.Linear(4, 512), nn.Linear(512, 4)]",
        ),
        HOOK,
        None,
    ),
    "by an activation's property": Lie(
        before(
            "class Act:\n    def __init__(self, w):\n        self.w = w\n\n    @property\n    def go(self):\n"
            "        self.w.data.neg_()",
            candidate("Act(self.conv.weight).go\n" + RETURN),
        ),
        WEIGHTS,
        WEIGHTS,
    ),
    "by a finaliser": Lie(
        before(
            "class Last:\n    def __init__(self, w):\n        self.w = w\n\n    def __del__(self):\n"
            "        self.w.data.neg_()",
            candidate("Last(self.conv.weight)\n" + RETURN),
        ),
        Reason.forbidden_construct,
        WEIGHTS,
    ),
    "by an optimiser": Lie(
        candidate(
            "loss = self.conv(x).square().mean()\nloss.backward()\n"
            "torch.optim.SGD(self.conv.parameters(), 0.1).step()\n" + RETURN
        ),
        WEIGHTS,
        WEIGHTS,
    ),
    "detached": Lie(
        candidate("with torch.no_grad():\n    self.conv.bias.detach().neg_()\n" + RETURN), WEIGHTS, WEIGHTS
    ),
    "as statistics of a batch": Lie(
        candidate("F.batch_norm(self.conv(x), *self.kept(), training=True)\n" + RETURN).replace(
            "    def forward",
            "    def kept(self):\n        return self.conv.bias.detach(), torch.ones(4)\n\n    def forward",
        ),
        None,
        WEIGHTS,
    ),
    "new parameters in each pass": Lie(
        candidate("self.conv.weight = nn.Parameter(self.conv.weight * 0.99)\n" + RETURN), None, WEIGHTS
    ),
    "parameter that is taken away": Lie(
        candidate("self.spare = None\n" + RETURN, "self.spare = nn.Parameter(torch.ones(3))"), None, WEIGHTS
    ),
    "layer made in forward": Lie(
        candidate(
            "if self.late is None:\n    self.late = nn.Linear(3, 3)\nreturn self.late(" + GOOD + ")", "self.late = None"
        ),
        None,
        WEIGHTS,
    ),
    "name made at run time": Lie(candidate("getattr(self.conv.weight, 'da' + 'ta').add_(1)\n" + RETURN), None, WEIGHTS),
    "through a view": Lie(
        candidate("with torch.no_grad():\n    self.conv.weight.view(-1).neg_()\n" + RETURN), None, WEIGHTS
    ),
    "through a partial function": Lie(
        "from functools import partial\n"
        + candidate(
            "with torch.no_grad():\n    self.go()\n" + RETURN, "self.go = partial(torch.Tensor.neg_, self.conv.weight)"
        ),
        None,
        WEIGHTS,
    ),
}

MODE_CHANGED = {
    "trains for ever": Lie(candidate("self.train()\n" + RETURN), MODE, MODE),
    "layer trains for ever": Lie(candidate("self.conv.train()\n" + RETURN), MODE, MODE),
    "through the class": Lie(candidate("nn.Module.train(self, True)\n" + RETURN), MODE, MODE),
    "statistics stay": Lie(candidate("self.conv.eval()\n" + RETURN), MODE, MODE),
    "by a hook": Lie(
        candidate(RETURN, "self.conv.register_forward_pre_hook(lambda m, i: (m.train(), None)[1])"), HOOK, MODE
    ),
    "name made at run time": Lie(candidate("getattr(self, 'tr' + 'ain')()\n" + RETURN), None, MODE),
}

#: What only the probe can see.
PARAMETERS_HIDDEN = {
    "wide layer in a list": Lie(
        candidate(
            "return self.last(self.wide[0](self.conv(x).mean((2, 3))))",
            "self.wide = [nn.Linear(4, 5000)]\nself.last = nn.Linear(5000, 3)",
        ),
        None,
        HIDDEN,
    ),
    "layer in a closure": Lie(
        candidate(
            "return self.last(x) + " + GOOD, "wide = nn.Linear(3, 3)\nself.last = lambda x: wide(x.mean((2, 3)))"
        ),
        None,
        HIDDEN,
    ),
    "global layer": Lie(
        before("WIDE = nn.Linear(3, 3)", candidate(f"return {GOOD} + WIDE(x.mean((2, 3)))")), None, HIDDEN
    ),
    "copy of the network": Lie(
        "from copy import deepcopy\n"
        + candidate(f"return {GOOD} + self.twin[0](self.conv(x).mean((2, 3)))", "self.twin = [deepcopy(self.head)]"),
        None,
        HIDDEN,
    ),
    "tensor that learns": Lie(
        candidate(f"return {GOOD} + self.free", "self.free = torch.zeros(3, requires_grad=True)"), None, HIDDEN
    ),
    "tensor that learns alone": Lie(
        candidate("return x.mean((2, 3)) + self.free", "self.free = torch.zeros(3, requires_grad=True)"), None, HIDDEN
    ),
    "buffer that learns": Lie(
        candidate(f"return {GOOD} + self.free", "self.register_buffer('free', torch.zeros(3, requires_grad=True))"),
        None,
        HIDDEN,
    ),
    "output of its own": Lie(candidate("return torch.zeros(len(x), 3, requires_grad=True)"), None, HIDDEN),
    "parameter taken off the list": Lie(
        candidate(
            "return self.head(F.relu(F.conv2d(x, self.kept[0])).mean((2, 3)))",
            "self.kept = [self.conv._parameters.pop('weight')]",
        ),
        None,
        HIDDEN,
    ),
}

BATCH_CHOOSES = {
    "wide for more than one image": Lie(
        candidate(
            f"if x.shape[0] == 1:\n    {RETURN}\nreturn self.wide(x)",
            "self.wide = nn.Sequential(nn.Conv2d(in_channels, 64, 3, padding=1), nn.ReLU(), nn.Conv2d(64, 64, 3),\n"
            "    nn.GELU(), nn.AdaptiveAvgPool2d(1), nn.Flatten(), nn.Linear(64, num_outputs))",
        ),
        None,
        BATCH,
    ),
    "the same operations, at a lower resolution for one image": Lie(
        candidate(f"x = F.interpolate(x, size=8 if len(x) == 1 else 32)\n{RETURN}"), None, BATCH
    ),
    "the same operations, at a higher resolution for one image": Lie(
        candidate(f"x = F.interpolate(x, size=32 if len(x) == 1 else 8)\n{RETURN}"), None, BATCH
    ),
}

LIES = {
    f"{kind}: {name}": lie
    for kind, lies in {
        "name": NAMES_TAKEN,
        "weights": WEIGHTS_CHANGED,
        "mode": MODE_CHANGED,
        "hidden": PARAMETERS_HIDDEN,
        "batch": BATCH_CHOOSES,
    }.items()
    for name, lie in lies.items()
}
