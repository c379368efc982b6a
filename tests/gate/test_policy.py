"""The static policy admits networks and names the line of what breaks a rule; each rule has its breach here."""

import sys
from types import ModuleType

import pytest
import torch  # noqa: F401 - loads the modules that the allow-list names
from gate_cases import VALID, candidate, contract
from hypothesis import given
from hypothesis import strategies as st

from tacevo.gate.policy import allowed
from tacevo.gate.policy.check import DEEPEST, rejection_of
from tacevo.records import Reason, Rejection, Stage

CONTRACT = contract()


def rejected(source: str) -> Rejection:
    """Check and insist on a rejection at this stage."""
    rejection = rejection_of(source, CONTRACT)
    assert rejection is not None
    assert rejection.stage is Stage.policy
    return rejection


#: Lines before a class with which it passes.
PREAMBLES = [
    "",
    "# -*- coding: utf-8 -*-\nfrom __future__ import annotations",
    "import torch\nimport torch.nn as nn\nimport torch.nn.functional as F\nfrom torch import Tensor, nn",
    "import math, typing as t, itertools\nfrom collections import OrderedDict\nfrom collections.abc import Sized",
    "from torch.nn.init import xavier_uniform_\nfrom torch.nn.utils import spectral_norm\nimport torch.nn",
    "from torch.nn import functional as fn\n\n\ndef act(x):\n    return fn.gelu(x)",
    "from functools import partial\nfrom dataclasses import dataclass\nNorm = partial(nn.GroupNorm, 4)",
    "import functools\ndef twice(f):\n    @functools.wraps(f)\n    def g(x):\n        return f(f(x))\n    return g",
    "from typing import Callable, Dict, List, Optional, Tuple, Union, cast",
    "def pick(kind, input):\n    match kind:\n        case 'a' | 'b':\n            return getattr(input, 'shape')",
    "class Block(nn.Module):\n    def __init__(self):\n        nn.Module.__init__(self)\n        self.__hidden = 1",
    "class Net(nn.Module):\n    def __repr__(self):\n        return self.__class__.__name__",
    "def init(m):\n    if isinstance(m, nn.Conv2d) and hasattr(m, 'bias'):\n        nn.init.zeros_(m.bias)",
    "DEVICE = torch.device('cuda' if torch.cuda.is_available() else 'cpu')",
    "def weigh(x):\n    return torch.fft.rfft2(x).abs() + torch.linalg.norm(x) + torch.special.expit(x)",
    "def f(id):\n    return id",
    "set = [1]\nx = set[0]",
    "A = {'a': nn.ReLU}",
    "A = {i: i for i in range(3)}",
    "A = hash('name') % 2",
    "class A(nn.Module):\n    def id(self):\n        return self.set",
    '# torch.load, naïve\n"""import os; é"""',
]

#: Lines of a constructor with which a class passes: looking up in a set needs no order, conversions are not called, and
#: private names of its own are a text's.
CONSTRUCTORS = [
    "kind = 'relu'\nif kind not in {'relu', 'gelu'}:\n    raise ValueError(kind)",
    "kinds = {'relu', 'gelu'}\nassert 'relu' in kinds and 'tanh' not in kinds",
    "self.kinds = {1, 2}\nassert 1 in self.kinds",
    "wide = [c for c in (8, 16) if c in {16, 32}]",
    "self.half = 8\nself.double, self.type = 2, 'same'",
    "self._width = 8\nself.width = self._width",
    "for i in range(2):\n    setattr(self, f'_conv{i}', nn.Conv2d(3, 3, 1))\nself._conv0(torch.zeros(1, 3, 4, 4))",
    "self._modules['head'].bias.requires_grad",
    "self.conv._conv_forward(torch.zeros(1, 3, 4, 4), self.conv.weight, self.conv.bias)",
    "self.register_buffer(name='_mask', tensor=torch.ones(3))\nself._mask.sum()",
    "self.norm = nn.BatchNorm2d(3)\nself.norm._check_input_dim(torch.zeros(1, 3, 4, 4))",
]

#: Lines of a forward pass with which a class passes: a name that was set to something else is that.
FORWARDS = [
    "w = self.conv.weight\nw = w - w.mean()\nw /= 2",
    "w = self.conv.weight\nfor _ in range(2):\n    w = w - w.mean()\n    w /= 2",
    "for layer in [self.conv]:\n    w = layer.weight\n    w = w - w.mean()\n    w.mul_(2)",
    "w = self.conv.weight\nwith torch.no_grad():\n    w = w * 1\nw += 1",
    "w = self.conv.weight\nw = w.clone()\nif self.training:\n    w += 1",
]


@pytest.mark.parametrize(
    "source",
    [
        *(f"{preamble}\n\n\n{VALID}" for preamble in PREAMBLES),
        *(candidate("return self.head(self.conv(x).mean((2, 3)))", lines) for lines in CONSTRUCTORS),
        *(candidate(f"{forward}\nreturn x") for forward in FORWARDS),
        f'{VALID}\n\nif __name__ == "__main__":\n    print(ImageRegressionCNN()(torch.randn(2, 3, 64, 64)).shape)\n',
    ],
)
def test_network_passes(source: str) -> None:
    """What networks are made of is allowed, with an example of use below it; only code is judged."""
    assert rejection_of(source, CONTRACT) is None


#: What is refused before a class, by its reason. Anything not listed is refused, also inside a function, in decorators,
#: defaults, annotations, bases, comprehensions, patterns and statements; every form that stores or deletes is seen.
BEFORE = {
    Reason.forbidden_import: [
        "import os",
        "import numpy as np",
        "import torch.utils.cpp_extension",
        "import torch.multiprocessing as mp",
        "from os import environ",
        "from torch import load",
        "from torch import hub",
        "from torch.nn import LazyLinear",
        "from torch.nn.modules.module import register_module_full_backward_hook",
        "from torch.nn import *",
        "from . import secrets",
        "from typing import contextlib",
        "def f():\n    import subprocess",
        "from typing import ForwardRef",
        "from typing import get_type_hints",
        "from typing import _eval_type",
    ],
    Reason.forbidden_name: [
        "@torch.jit.script\ndef f(x):\n    return x",
        "def f(x=torch.load):\n    return x",
        "def f(x: torch.hub):\n    return x",
        "class A(torch.utils.data.Dataset):\n    pass",
        "A = [torch.load for _ in range(3)]",
        "A = lambda: torch.load",
        "match 1:\n    case torch.load:\n        pass",
        "with torch.profiler.profile():\n    pass",
        "assert torch.load",
        "A: torch.load = 1",
    ],
    Reason.forbidden_construct: [
        # changes of what was imported
        "torch.Tensor.item = None",
        "F.mse_loss: object = None",
        "del torch.load",
        "F.relu += 1",
        "for F.mse_loss in [1]:\n    pass",
        "[0 for F.mse_loss in [1]]",
        "with a as nn.Module.forward:\n    pass",
        "(nn.MSELoss.forward, b) = 1, 2",
        "from torch import Tensor\nTensor.item = None",
        "from collections import deque\ndeque.x = 1",
        "setattr(nn.MSELoss, 'forward', None)",
        "delattr(F.relu, 'x')",
        # a name that means two things
        "torch = nn.Module",
        "def f(nn):\n    return nn",
        "class F:\n    pass",
        "match 1:\n    case math:\n        pass",
        "match [1]:\n    case [*math]:\n        pass",
        "match {}:\n    case {**math}:\n        pass",
        "import math as torch",
        "import torch.nn as torch",
        "from math import pi as nn",
        # what Python calls or reads by itself
        "class A:\n    def __del__(self):\n        pass",
        "class A:\n    def __set_name__(self, owner, name):\n        pass",
        "class A(torch.Tensor):\n    def __torch_function__(self):\n        pass",
        "class A(metaclass=type):\n    pass",
        "match 1:\n    case object(real=x):\n        pass",
        "async def f():\n    pass",
        # wraps reads and writes attributes that are named in strings
        "from functools import wraps\nwraps(F.relu)(nn.Linear)",
        "from functools import wraps as w\n@w(F.relu, assigned=('__code__',))\ndef f():\n    pass",
        "import functools\n@functools.wraps(F.relu, ('a',))\ndef f():\n    pass",
        "import functools\nmark = functools.wraps",
        "from functools import wraps\n@wraps(*(F.relu, ('__globals__',), ()))\ndef f():\n    pass",
        "from functools import wraps\n@(lambda f: wraps(F.relu, updated=())(f))\ndef f():\n    pass",
        # tools that read the file would see other code than the gate
        "# -*- coding: utf-7 -*-",
        "\n# vim: set fileencoding=latin-1 :",
    ],
}


@pytest.mark.parametrize(("reason", "code"), [(reason, code) for reason, codes in BEFORE.items() for code in codes])
def test_breach_before_a_class_is_refused(reason: Reason, code: str) -> None:
    """Wherever it stands, and its line is named."""
    rejection = rejected(f"{code}\n\n\n{VALID}")
    assert rejection.reason is reason
    assert int(rejection.detail.removeprefix("line ").partition(":")[0]) <= code.count("\n") + 1


#: What is not on the list, by each way to reach it.
NAMES = """
    torch.load torch.save torch.hub.load torch.ops.load_library torch.compile torch.jit.script
    torch.multiprocessing torch._C._set_num_threads torch.classes.load_library torch.utils.data
    torch.futures.Future torch.distributed.init_process_group torch.autograd.graph
    torch.use_deterministic_algorithms torch.set_num_threads torch.manual_seed torch.backends.cudnn.benchmark
    torch.storage.io torch.os.system torch.from_file nn.parallel.distributed
    nn.modules.module.register_module_forward_hook nn.LazyLinear F.importlib math.__loader__
    nn.Module.__init__.__globals__ torch.linalg.sys torch.fft.torch torch.set_grad_enabled
"""


#: What is refused in a forward pass, by its reason.
WITHIN = {
    Reason.forbidden_name: [
        *NAMES.split(),
        "F.torch.load('x')",
        "().__class__.__bases__",
        "self.__dict__",
        "x.numpy()",
        "x.untyped_storage()",
        "x.data_ptr()",
        "(lambda: 0).f_globals",
        "getattr(x, '__reduce__')",
        "hasattr(x, 'numpy')",
        "x._typed_storage()",
        "x.grad_fn._saved_self",
        "self.conv(x).grad_fn._raw_saved_weight",
        "_grad = 0; x._grad",
        "_f = 0; x._fix_weakref()",
        "self.head._apply(lambda w: w)",
        "self.head._call_impl(x)",
        "getattr(x, '_grad')",
        "ref._evaluate(0, 0, 0)",
        "self._evaluate = 1; x._evaluate()",
        "exec('1')",
        "eval('1')",
        "compile('1', 'f', 'exec')",
        "open('x')",
        "globals()",
        "vars(self)",
        "__import__('os')",
        "__builtins__",
        "input()",
        "breakpoint()",
        "[open][0]",
        "map(getattr, [x], ['a'])",
        "getattr(nn, 'ReLU')",
        "[torch]",
        "dict(m=torch.nn)",
        "f'{torch.seed()}'",
        "'{0.__init__.__globals__}'.format(x)",
    ],
    Reason.forbidden_construct: [
        # the order of a set of classes follows memory addresses, so an equal source would build another network
        "[kind() for kind in {nn.ReLU, nn.GELU}]",
        "list({layer for layer in self.children()})",
        "tuple(set(self.children()))",
        "[*frozenset([nn.ReLU, nn.GELU])]",
        "list(map(set, [[nn.ReLU, nn.GELU]]))",
        "'{}'.format({nn.ReLU, *[nn.GELU]})",
        "(make := set)([nn.ReLU])",
        "kinds = {nn.ReLU, nn.GELU}\n(1 in kinds, [*kinds])",
        "self.kinds = {1, 2}\n[kind for kind in self.kinds]",
        "{1, 2} in [{1, 2}]",
        "x if x in {1} | {2} else x",
        "id(x) % 2",
        "sorted([nn.ReLU, nn.GELU], key=id)",
        # Python folds an italic letter to a plain one, so the text would not say what it does
        "\N{MATHEMATICAL ITALIC SMALL P}rint(x)",
    ],
    Reason.changes_its_weights: [
        # behind a branch, in a loop that comes around, under a second name
        "w = self.conv.weight\nif self.training:\n    w = w * 1\nw += 1",
        "w = x\nfor _ in range(2):\n    w += 1\n    w = self.conv.weight",
        "w = x\nwhile True:\n    w += 1\n    if self.training:\n        w = self.conv.weight",
        "w = x * 1\nw = self.conv.weight\nw += 1",
        "w = self.conv.weight\nv = w\nv += 1",
        "try:\n    w = self.conv.weight\nexcept ValueError:\n    w = x\nw += 1",
    ],
}


@pytest.mark.parametrize(("reason", "line"), [(reason, line) for reason, lines in WITHIN.items() for line in lines])
def test_breach_within_a_forward_pass_is_refused(reason: Reason, line: str) -> None:
    """Its line is named."""
    rejection = rejected(candidate(f"{line}\nreturn x"))
    assert rejection.reason is reason
    assert 10 <= int(rejection.detail.removeprefix("line ").partition(":")[0]) <= 10 + line.count("\n")


def test_no_allowed_name_is_another_module() -> None:
    """An allowed name that held a module would open everything that this module imports."""
    for path in [path for path in sys.modules if allowed.is_module(path)]:
        for name, value in vars(sys.modules[path]).items():
            if allowed.is_allowed(path, name):
                assert not isinstance(value, ModuleType), f"{path}.{name}"


def test_deep_expression_is_too_complex() -> None:
    """A long sum is refused before anything walks it by recursion; a short one passes."""
    assert rejection_of(candidate("return " + " + ".join(["x"] * (DEEPEST - 10))), CONTRACT) is None
    for terms in (DEEPEST, 2_500):
        assert rejected(candidate("return " + " + ".join(["x"] * terms))).reason is Reason.too_complex


def test_first_breach_is_named() -> None:
    """Of several, the reader hears of the one that comes first in the text."""
    assert rejected(candidate("torch.save(x)\nopen(x)", "eval(x)")).detail.startswith("line 8: eval ")


def test_class_must_be_there() -> None:
    """A task's own baseline with a wrong name is refused without a sandbox."""
    assert rejected(VALID.replace("ImageRegressionCNN", "Net")).reason is Reason.no_class


MADE = "self.w = nn.Parameter(torch.ones(4, 4))"


@pytest.mark.parametrize(
    ("init", "forward"),
    [
        ("self.w: nn.Parameter = nn.Parameter(torch.ones(4, 4))", "self.w.add_(1)"),
        ('self.register_parameter("w", nn.Parameter(torch.ones(4, 4)))', "self.w.add_(1)"),
        (MADE, "x = [(same := self.w), same.add_(1)]"),
        (MADE, "self.w[0, :].add_(1)"),
    ],
)
def test_weight_is_known_however_it_was_made_and_is_called(init: str, forward: str) -> None:
    """With a type, by registration, under another name, and a part of it at fixed places."""
    assert rejected(candidate(f"{forward}\nreturn x", init)).reason is Reason.changes_its_weights


@pytest.mark.parametrize(
    "binding",
    [
        "try: pass\n    except ValueError as train: pass",
        "match 1:\n        case train: pass",
        "match {}:\n        case {**train}: pass",
    ],
)
def test_name_of_a_module_is_bound_in_no_way(binding: str) -> None:
    """Also by an error that is caught, and by a pattern."""
    assert rejected(f"{VALID}\nclass Block(nn.Module):\n    {binding}\n").reason is Reason.redefines_module


@pytest.mark.parametrize("ending", ["x = '\ud800'\n", "\\\r\n"])
def test_text_that_one_of_pythons_readers_refuses_is_not_a_network(ending: str) -> None:
    """Half a character, which the parser refuses, and an open line, which Python 3.11 refuses by its tokenizer only."""
    assert rejected(VALID + ending).reason is Reason.syntax


@given(st.sampled_from(["exec", "eval", "open", "globals"]), st.integers(0, 20))
def test_wrapping_does_not_hide_a_name(name: str, depth: int) -> None:
    """However deep a forbidden name sits, it is found."""
    assert rejected(candidate(f"return {'[' * depth}{name}{']' * depth}")).reason is Reason.forbidden_name


@given(st.lists(st.sampled_from([*VALID.split("\n"), "\x0c", "x = '\\", "é = 1", '"""', "\tpass", "\\"]), max_size=30))
def test_any_lines_get_an_answer(lines: list[str]) -> None:
    """No shuffling of code makes the policy raise."""
    rejection = rejection_of("\n".join(lines), CONTRACT)
    assert rejection is None or rejection.stage is Stage.policy
