"""Candidates that use what an allowed library looks up, sets or runs for them, each with what refuses it.

Where one of them came through, it would reach Python's own functions, or torch's classes.
"""

from dataclasses import dataclass

from gate_cases import VALID, candidate

from tacevo.records import Reason

_NAME = Reason.forbidden_name
_CONSTRUCT = Reason.forbidden_construct

#: Gives any attribute of any object: a container of parameters that looks names up as they come.
_PLAIN = "def plain():\n    pass\n\n\nplain._key_to_attr = lambda key: key\n"
_OPEN = "class Open(nn.ParameterDict):\n    def _key_to_attr(self, key):\n        return key\n\n\n"


@dataclass(frozen=True)
class Door:
    """One way; the reasons are those of the policy and of the probe behind it, None where it is admitted there."""

    source: str
    policy: Reason | None
    probe: Reason | None


def _before(code: str, policy: Reason | None, probe: Reason | None) -> Door:
    return Door(f"{code}\n\n\n{VALID}", policy, probe)


DOORS = {
    "method of a container, of another object": _before(
        f"{_PLAIN}names = nn.ParameterDict.__getitem__(plain, '__globals__')", _NAME, _NAME
    ),
    "the same by another name": _before(
        f"{_PLAIN}kind = nn.ParameterDict\nnames = kind.__getitem__(plain, '__globals__')", _NAME, _NAME
    ),
    "the same by super": _before(
        f"{_PLAIN}class Some(nn.ParameterDict):\n    def get(self, thing, key):\n"
        "        return super().__getitem__(thing, key)\n\n\nnames = Some.get(Some, plain, '__globals__')",
        None,
        _NAME,
    ),
    "the same by a super of its own": _before(
        f"{_PLAIN}def super():\n    return nn.ParameterDict\n\n\n"
        "class Some:\n    def get(self):\n        return super().__getitem__(plain, '__globals__')\n\n\nSome().get()",
        _CONSTRUCT,
        _NAME,
    ),
    "the same by self": _before(
        f"{_PLAIN}def get(self):\n    return self.__getitem__(plain, '__globals__')\n\n\nget(nn.ParameterDict)",
        None,
        _NAME,
    ),
    "container that looks up what it is asked": _before(f"{_OPEN}names = Open()['__dict__']", None, _NAME),
    "container that sets what it is asked": _before(f"{_OPEN}Open()['__dict__'] = nn.Linear", None, _NAME),
    "container that deletes what it is asked": _before(
        f"{_OPEN}def end(parts):\n    parts._keys['__dict__'] = None\n    del parts['__dict__']\n\n\nend(Open())",
        None,
        _NAME,
    ),
    "list whose index answers for its name": _before(
        "class Index:\n    def __str__(self):\n        return '__dict__'\n\n\n"
        "class Some(nn.ParameterList):\n    def _get_abs_string_index(self, idx):\n        return idx\n\n"
        "    def get(self, idx):\n        return nn.ParameterList.__getitem__(self, idx)\n\n\nSome().get(Index())",
        _NAME,
        _NAME,
    ),
    "name of a weight that is parametrised": _before(
        "from torch.nn.utils.parametrizations import orthogonal\n\n\northogonal(nn.Linear(2, 2), '__dict__')",
        None,
        _NAME,
    ),
    "members of another module": _before(
        "from enum import Enum\n\n\nEnum._convert_('All', 'candidate', lambda name: name == 'math')", _NAME, None
    ),
    "the same by a computed name": _before(
        "from enum import Enum\n\n\ngetattr(Enum, '_con' + 'vert_')('All', 'candidate', lambda name: name == 'math')",
        None,
        _NAME,
    ),
    "field whose name is text that runs": _before(
        "from dataclasses import dataclass\nfrom typing import TypedDict\n\n\n"
        "dataclass(TypedDict('Fields', {'a=print(1), b': int}))",
        None,
        _NAME,
    ),
    "field whose name is changed later": _before(
        "from dataclasses import dataclass, field\n\n\nplace = field(default=0, init=False)\n\n\n"
        "@dataclass\nclass Base:\n    a: int = place\n\n\nplace.name = 'a if print(1) else self.a'\n\n\n"
        "@dataclass(init=False)\nclass Below(Base):\n    b: int = 0",
        None,
        _NAME,
    ),
    "fields in a dictionary of its own": _before(
        "from dataclasses import dataclass\n\n\n"
        "class Words(dict):\n    def __iter__(self):\n        return iter(['a'])\n\n\n"
        "make = type\ndataclass(make('Base', (), {'a': 0, '__annotations__': Words({'a if print(1) else 0': int})}))",
        None,
        _NAME,
    ),
    "module of an error": _before(
        "try:\n    nn.Nothing\nexcept AttributeError as error:\n    names = error.obj.functional", _NAME, None
    ),
    "mode of torch by another name": _before("kind = torch.no_grad\nkind.extra = 1", None, Reason.redefines_module),
    "class of Python by another name": _before(
        "from collections import Counter\n\n\nkind = Counter\nkind.__init__: object = print",
        None,
        Reason.redefines_module,
    ),
    "copy that sets an attribute": _before(
        "from copy import copy\n\n\nclass Some:\n    pass\n\n\n"
        "setattr(Some, '__reduce' + '_ex__', lambda self, version: (lambda: nn.Linear, (), (None, {'__call__': 1})))\n"
        "copy(Some())",
        None,
        _NAME,
    ),
    "import by its function": _before("__builtins__['__import__']('sys')", _NAME, _NAME),
    "text that runs": _before("__builtins__['eval']('1')", _NAME, Reason.construction_failed),
    "import past the policy": _before("import os", Reason.forbidden_import, _NAME),
    "computed name that is a class of its own": _before(
        "class Name(str):\n    pass\n\n\ngetattr(plain, Name('__globals__'))".replace("plain", "nn.Linear"),
        None,
        Reason.construction_failed,
    ),
    "private part of what was imported": _before("nn.Linear._reset = 3", _NAME, Reason.redefines_module),
    "class of torch by another name": _before(
        "kind = torch.Tensor\nreal = kind.backward\n\n\ndef more(self, *rest):\n    return real(self, *rest)\n\n\n"
        "kind.backward = more",
        None,
        Reason.redefines_module,
    ),
    "method of tensors that a training calls": _before(
        "kind = torch.Tensor\n\n\ndef other(self, values):\n    return self\n\n\nkind.div_ = other",
        None,
        Reason.redefines_module,
    ),
    "layer of torch by the type of an object": _before(
        "kind = type(nn.Linear(1, 1))\nkind.forward = lambda self, x: x", None, Reason.redefines_module
    ),
    "class of torch in a pass": Door(
        candidate("kind = type(self.conv)\nkind.extra = 1\nreturn self.head(F.relu(self.conv(x)).mean((2, 3)))"),
        None,
        Reason.redefines_module,
    ),
    "backward pass of its own": Door(
        candidate(
            "y = self.conv(x)\nif y.grad_fn is not None:\n    y.grad_fn(torch.ones_like(y))\n"
            "return self.head(F.relu(y).mean((2, 3)))"
        ),
        None,
        Reason.learns_by_itself,
    ),
}
