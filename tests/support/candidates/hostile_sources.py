"""Hostile candidates of our own, for the tiny task of training_jobs.py; all of them have got past policy and probe."""

from training_jobs import SOURCE


def _first(code: str) -> str:
    """Put lines before the class."""
    return f"{code}\n{SOURCE}"


def _constructor(line: str) -> str:
    """Put a line into the constructor."""
    return SOURCE.replace("super().__init__()", f"super().__init__()\n        {line}")


def _output(expression: str) -> str:
    """Let the network return another expression of its output `y`."""
    return SOURCE.replace("return self.head(self.body(x))", f"y = self.head(self.body(x))\n        return {expression}")


_TRAINER = "import sys\ntrainer = sys.modules['tacevo.training.trainer']\n"

#: Each never comes to an end at another place.
ENDLESS = {
    "import": _first("while True: pass"),
    "class body": SOURCE.replace("    def __init__", "    while True: pass\n    def __init__"),
    "constructor": _constructor("while True: pass"),
    "forward": _output("any(False for _ in iter(int, 1))"),
    "validation": _output("y if self.training else any(False for _ in iter(int, 1))"),
    "backward hook": _output("(y.register_hook(lambda grad: any(False for _ in iter(int, 1))), y)[1]"),
    "finaliser": _first("class Trap:\n    def __del__(self):\n        while True: pass\nTrap()"),
    "sleep": _first("import time\nwhile True: time.sleep(1000)"),
    "native code": _first("import re\nre.match('(a*)*b', 'a' * 60)"),
    "exception": _first("class Trap(Exception):\n    def __str__(self):\n        while True: pass\nraise Trap()"),
    "deaf": _first(
        "import signal\nfor n in {*range(1, 32)} - {9, 19}: signal.signal(n, signal.SIG_IGN)\nwhile True: pass"
    ),
}

#: Each would go on for ever after its answer, which is complete by then.
ENDLESS_AFTERWARDS = {
    "at exit": _first("import atexit, time\natexit.register(time.sleep, 10**6)"),
    "finaliser of the model": SOURCE + "\n    def __del__(self):\n        while True: pass\n",
    "finaliser of the module": _first("class Trap:\n    def __del__(self):\n        while True: pass\ntrap = Trap()"),
}

#: Each returns something that is not a prediction.
NO_PREDICTIONS = {
    "one column": _output("y[:, :1]"),
    "one row": _output("y[:1]"),
    "more rows": _output("torch.cat([y, y])"),
    "no dimension": _output("y.sum()"),
    "double": _output("y.double()"),
    "half": _output("y.half()"),
    "complex": _output("torch.complex(y, y)"),
    "list": _output("list(y)"),
    "subclass": _output("nn.Parameter(y)"),
    "nothing": _output("None"),
    "too many rows, after the check": _first("cat = torch.cat\ntorch.cat = lambda parts: cat([*parts, *parts])"),
    "more epochs": _first(_TRAINER + "trainer._predict = lambda job, model: bytes(2**16)"),
    "text for a loss": _first(_TRAINER + "trainer._epoch = lambda *job: 'low'"),
    "infinite": _output("y if self.training else y / 0"),
    "no number": _output("y if self.training else y * float('nan')"),
}

#: Each changes the code around it so that it would look good; what is measured outside does not change.
PATCHES = {
    "loss": _first(_TRAINER + "trainer.mse_loss = lambda output, target: (output * 0).sum()"),
    "optimiser": _first("torch.optim.Adam.step = lambda self: None"),
    "numbers": _first("torch.Tensor.__float__ = lambda self: 0.0\ntorch.Tensor.item = lambda self: 0.0"),
    "formats": _first("torch.Tensor.__format__ = torch.Tensor.__repr__ = lambda self, *how: '0.0'"),
    "comparison": _first(
        "torch.Tensor.__eq__ = lambda self, other: True\ntorch.Tensor.__sub__ = lambda self, other: 0"
    ),
    "digest": _first(_TRAINER + "trainer.digest = lambda model: '0' * 64"),
    "batches": _first(_TRAINER + "trainer.batches = lambda *job: []\ntrainer._epoch = lambda *job: 0.0"),
    "pickle": _first("import pickle\npickle.dumps = pickle.loads = lambda *data: exit()"),
    "hooks": _first(
        "nn.modules.module.register_module_forward_hook(lambda module, inputs, output: output * 0 + output)"
    ),
    "claims": _first(
        _TRAINER
        + "import json\ndumps = json.dumps\n"
        + "json.dumps = lambda value, **how: dumps({**value, 'validation_losses': [0.0], 'fitness': 0.0}\n"
        + "                         if isinstance(value, dict) else value, **how)"
    ),
}

#: Begins with weights of its own choice: another draw, which may be a lucky one.
SEEDS = _first("torch.manual_seed = lambda seed: None\nimport random; random.seed(1)\ntorch.initial_seed()")

#: Takes twenty times the steps that it was asked for, before each epoch's predictions: a known limit.
MORE_STEPS = _first(
    _TRAINER
    + """
epoch_of, step_of = vars(trainer).setdefault('real', (trainer._epoch, trainer._step))  # a source may run twice
steps = []
def count(*job):
    steps.append(1)
    return step_of(*job)
def longer(*job):
    for _ in range(20):
        loss = epoch_of(*job)
    return loss
trainer._step, trainer._epoch = count, longer
trainer.digest = lambda model: f'{len(steps):064x}'
"""
)

#: The end of an epoch of `MORE_STEPS` that hides how many steps there were.
COUNT_RESET = """for kept in job[2].optimiser.state.values():
        kept['step'].fill_(8 * (1 + job[3]))
    return loss"""

#: Each is too large in one way.
GREEDY = {
    "tensor": _constructor("self.kept = torch.ones(2**28)"),
    "layer": _constructor("self.kept = nn.Linear(10**6, 10**6)"),
    "objects": _constructor("self.kept = [bytes(1000) for _ in range(10**7)]"),
    "activations": _output("torch.stack([y.repeat(2**12, 2**12)]).sum() + y"),
}

#: Writes a whole answer by itself, predicting 0.5 everywhere, and leaves.
FORGED_ANSWER = _first("""
import os, json, struct
def frame(sort, header, payload=b''):
    text = json.dumps(header).encode()
    return struct.pack('!BIQ', sort, len(text), len(payload)) + text + payload
def pipe():
    for number in range(3, 1024):
        try:
            os.write(number, b'')
        except OSError:
            continue
        return number
place = pipe()
for epoch in range(4):
    counts = {'steps': 8 * (epoch + 1)}
    os.write(place, frame(5, {'epoch': epoch, 'train_loss': 0.0, **counts}, struct.pack('<16f', *[0.5] * 16)))
os.write(place, frame(5, {'weights_sha256': '0' * 64}))
os.write(place, frame(6, None))
os._exit(0)
""")
