"""Forms that mean the same are written so that the policy lets them pass, and the change is said."""

from dataclasses import replace

import pytest
from gate_cases import VALID, completion, contract, fenced, refusal_of, source_of

from tacevo.gate.extraction import Extracted, extract, extracted
from tacevo.gate.policy.check import rejection_of
from tacevo.records import Reason, Rejection, Stage

NAME = "ImageRegressionCNN"
NET = VALID.replace(NAME, "TactileNet")
STARRED = VALID.replace("nn.Conv2d", "Conv2d").replace("nn.Linear", "Linear").replace("nn.Module", "Module")


def found(text: str) -> Extracted:
    """Extract from an answer and insist on a source that the policy admits."""
    result = extracted(completion(text), contract())
    assert isinstance(result, Extracted), result
    assert rejection_of(result.source, contract()) is None
    said, source = "".join(f"# tacevo: {note}\n" for note in result.notes), result.source
    assert source.startswith(said)
    assert extract(completion(source), contract()) == source  # as it stands in the store, and goes into a prompt
    return replace(result, source=source.removeprefix(said))


@pytest.mark.parametrize(
    "text",
    [
        fenced(f"{NET}\n\n{NAME} = TactileNet\n"),
        f"{NET}\n\n{NAME} = TactileNet\n",
        f"It's this:\n\n{NET}\n{NAME} = TactileNet\n\nIt's small.",
        fenced(f"{NET}\n\n{NAME}: type = TactileNet  # as asked\n"),
        f"{fenced(NET)}\nNamed as asked:\n{fenced(f'{NAME} = TactileNet{chr(10)}')}",
        f"The class:\n\n{NET}\nNamed as asked:\n\n{NAME} = TactileNet\n\nIt's small.",
        f"{fenced(NET)}\nUse:\n{fenced(f'{NAME} = TactileNet{chr(10)}net = {NAME}(){chr(10)}')}",
        f"You gave:\n{fenced(VALID.replace('4', '6'))}\nNow:\n{fenced(f'{NET}{chr(10)}{NAME} = TactileNet{chr(10)}')}",
    ],
)
def test_class_that_is_given_the_name_counts_as_it(text: str) -> None:
    """It is renamed, letter for letter else, and this is said."""
    result = found(text)
    assert result.source == VALID
    assert [note for note in result.notes if "TactileNet" in note and NAME in note]


def test_renaming_reaches_every_use_of_the_name_and_nothing_else() -> None:
    """In `super`, in annotations and across lines; not in strings, attributes and longer names."""
    code = NET.replace("super()", "super(TactileNet, self)").replace("Tiny", "TactileNet:").replace("F.relu", "act")
    extra = 'TactileNets = 1\n\n\ndef act(x: "TactileNet", made=(\n    TactileNet\n)):\n    return x\n'
    source = found(fenced(f"{code}\n\n{extra}\n\n{NAME} = TactileNet\n")).source
    assert source == (
        code.replace("class TactileNet", f"class {NAME}").replace("(TactileNet", f"({NAME}")
        + "\n\n"
        + extra.replace("    TactileNet\n", f"    {NAME}\n")
    )


@pytest.mark.parametrize(
    "text",
    [
        fenced(f"{NAME} = TactileNet\n"),
        fenced(f"{NET}\n\n{NAME} = make(TactileNet)\n"),
        fenced(f"{NET}\n\ndef f():\n    {NAME} = TactileNet\n"),
        fenced(f"{NET}\n\nif True:\n    {NAME} = TactileNet\n"),
        fenced(NET),
    ],
)
def test_other_assignments_give_no_class(text: str) -> None:
    """The name has to be given to a class of the answer, at the top level."""
    assert refusal_of(text).reason is Reason.no_class


def test_later_alias_counts_and_two_definitions_are_ambiguous() -> None:
    """As with class statements."""
    assert found(
        f"{fenced(VALID)}\n{fenced(NET.replace('4', '8') + f'{chr(10)}{NAME} = TactileNet{chr(10)}')}"
    ).source == (VALID.replace("4", "8"))
    assert found(
        f"{fenced(NET + f'{chr(10)}{NAME} = TactileNet{chr(10)}')}\n{fenced(VALID.replace('4', '8'))}"
    ).source == (VALID.replace("4", "8"))
    assert refusal_of(fenced(f"{VALID}\n\n{NET}\n\n{NAME} = TactileNet\n")).reason is Reason.ambiguous
    assert refusal_of(f"{fenced(VALID)}\n{fenced(NET)}\n{fenced(f'{NAME} = Other{chr(10)}')}").reason is Reason.no_class


METHOD = VALID.replace("    def forward", "    @torch.compile\n    def forward")

COMPILED = {
    "class": f"@torch.compile\n{VALID}",
    "class with arguments": f'@torch.compile(mode="max-autotune", dynamic=False)\n{VALID}',
    "class with arguments on lines": f'@torch.compile(\n    mode="max-autotune",\n    dynamic=False,\n)\n{VALID}',
    "method": METHOD,
    "method with arguments": METHOD.replace("@torch.compile", "@torch.compile(fullgraph=True)  # fast"),
    "method without arguments": METHOD.replace("@torch.compile", "@torch.compile()"),
    "class and method": f"@torch.compile\n{METHOD}",
}


@pytest.mark.parametrize("code", COMPILED.values(), ids=COMPILED)
@pytest.mark.parametrize(
    "write", [fenced, "{}".format, "It's:\n\n{}\nIt's small.".format], ids=["fenced", "all", "bare"]
)
def test_compile_as_a_decorator_is_left_out(code: str, write: object) -> None:
    """It changes how fast a network runs, not what it computes."""
    assert callable(write)
    result = found(write(code))
    assert result.source == VALID
    assert [note for note in result.notes if "torch.compile" in note]


@pytest.mark.parametrize(
    ("head", "decorator", "left"),
    [
        ("from torch import compile\n\n\n", "@compile", ""),
        ("from torch import compile as fast\n\n\n", "@fast(dynamic=True)", ""),
        ("from torch import compile, nn\n\n\n", "@compile", "from torch import nn\n\n\n"),
        ("import torch as th\n\n\n", "@th.compile", "import torch as th\n\n\n"),
        ("import torch\n\n\n", "@torch.no_grad()\n@torch.compile", "import torch\n\n\n@torch.no_grad()\n"),
    ],
)
def test_compile_is_left_out_under_any_name(head: str, decorator: str, left: str) -> None:
    """With its import, and without the decorators beside it."""
    assert found(fenced(f"{head}{decorator}\n{VALID}")).source == f"{left}{VALID}"


@pytest.mark.parametrize(
    ("behind", "left"),
    [
        (f"net = torch.compile({NAME}())", f"net = {NAME}()"),
        (f"net = torch.compile({NAME}(), mode='default')", f"net = {NAME}()"),
        (f"net = torch.compile(model={NAME}())", f"net = {NAME}()"),
        (f"net = torch.compile(dynamic=True)({NAME}())", f"net = {NAME}()"),
        (f"net = torch.compile(\n    {NAME}(\n        3,\n    ),\n)", f"net = {NAME}(\n        3,\n    )"),
        (f"def make():\n    return torch.compile({NAME}())", f"def make():\n    return {NAME}()"),
        (f"if False:\n    net = torch.compile({NAME}())", f"if False:\n    net = {NAME}()"),
        (f"{NAME} = torch.compile({NAME})", ""),
        ("é = 'é'; net = torch.compile(é)".replace("é =", "e =").replace("(é)", "(e)"), "e = 'é'; net = e"),
    ],
)
def test_compile_around_the_network_behind_it_is_left_out(behind: str, left: str) -> None:
    """It is an example of use, in the block of the class or in one of its own."""
    result = found(fenced(f"{VALID}\n\n{behind}\n"))
    assert result.source.rstrip() == f"{VALID}\n\n{left}".rstrip()
    assert result.notes
    alone = found(f"{fenced(VALID)}\nFaster:\n{fenced(behind + chr(10))}")
    assert (alone.source, alone.notes) == (VALID, ())


def test_compile_in_a_class_and_other_decorators_are_left_to_the_policy() -> None:
    """They may change what the network is."""
    inside = VALID.replace("4, 3)\n", "4, 3)\n        self.fast = torch.compile(self.conv)\n")
    for code in (inside, f"@torch.jit.script\n{VALID}"):
        assert source_of(fenced(code)) == code
        rejection = rejection_of(code, contract())
        assert isinstance(rejection, Rejection)
        assert rejection.stage is Stage.policy


@pytest.mark.parametrize(
    ("stars", "written"),
    [
        ("from torch.nn import *", "from torch.nn import Conv2d, Linear, Module"),
        ("from torch.nn import *  # all", "from torch.nn import Conv2d, Linear, Module  # all"),
        ("import torch\nfrom torch.nn import *", "import torch\nfrom torch.nn import Conv2d, Linear, Module"),
        ("from torch.nn import *; import math", "from torch.nn import Conv2d, Linear, Module; import math"),
        ("from torch.nn import *\nfrom math import *", "from torch.nn import Conv2d, Linear, Module"),
        (
            "from torch.nn import *\nfrom torch.nn.functional import *\nfrom typing import *",
            "from torch.nn import Conv2d, Linear, Module",
        ),
        (
            "try:\n    from torch.nn import *\nexcept ImportError:\n    raise",
            "try:\n    from torch.nn import Conv2d, Linear, Module\nexcept ImportError:\n    raise",
        ),
    ],
)
def test_import_of_everything_becomes_the_imports_that_the_text_lacks(stars: str, written: str) -> None:
    """Neither what the sandbox provides nor what Python has."""
    result = found(fenced(f"{stars}\n\n\n{STARRED}"))
    assert result.source == f"{written}\n\n\n{STARRED}"
    assert [note for note in result.notes if "torch.nn" in note]
    assert found(f"{stars}\n\n\n{STARRED}").source == f"{written}\n\n\n{STARRED}"


@pytest.mark.parametrize(
    ("module", "old", "new", "names"),
    [
        ("torch.nn.functional", "F.relu", "relu", "relu"),
        ("torch", ".mean((2, 3))", ".mean((2, 3)) * sigmoid(ones(1)) * max(1, 1)", "ones, sigmoid"),
        ("math", "4, 3)", "4, int(sqrt(9)))", "sqrt"),
        ("typing", "self, x)", "self, x: Optional[Any])", "Any, Optional"),
        ("torch.nn.init", "4, 3)\n", "4, 3)\n        kaiming_normal_(self.conv.weight)\n", "kaiming_normal_"),
        ("torch.nn", "F.relu", "functional.relu", "functional"),
    ],
)
def test_import_of_everything_may_be_of_any_module_that_may_be_imported(
    module: str, old: str, new: str, names: str
) -> None:
    """Functions and modules alike; a built-in function stays the built-in one."""
    code = VALID.replace(old, new)
    assert found(fenced(f"from {module} import *\n\n\n{code}")).source == f"from {module} import {names}\n\n\n{code}"


def test_import_of_everything_that_brings_nothing_is_dropped() -> None:
    """The class names its layers by their module."""
    assert found(fenced(f"from torch.nn import *\n{VALID}")).source == VALID
    assert found(fenced(f"from torch.nn import *\nimport math\n{VALID}")).source == f"import math\n{VALID}"


def test_import_of_everything_in_another_block_comes_with_the_class() -> None:
    """It is written out there, too."""
    result = found(f"{fenced('from torch.nn import *' + chr(10))}\n{fenced(STARRED)}")
    assert result.source == f"from torch.nn import Conv2d, Linear, Module\n\n{STARRED}"
    assert result.notes
    helper = "class Act(Module):\n    def forward(self, x):\n        return F.relu(x)\n"
    using = VALID.replace("F.relu", "Act()")
    example = f"opt = Adam({NAME}().parameters())\n"
    texts = [fenced(code) for code in ("from torch.nn import *\n", helper, using, example)]
    assert found("\n".join(texts)).source == f"from torch.nn import Module\n\n{helper.rstrip()}\n\n{using}"


@pytest.mark.parametrize("module", ["os", "numpy", "torchvision", ".layers", "torch.distributed"])
def test_import_of_everything_from_elsewhere_is_left_to_the_policy(module: str) -> None:
    """It is refused."""
    code = f"from {module} import *\n\n\n{VALID}"
    assert source_of(fenced(code)) == code
    rejection = rejection_of(code, contract())
    assert rejection is not None
    assert rejection.reason is Reason.forbidden_import


def test_text_that_is_not_changed_has_no_note() -> None:
    """A note is said for a reason."""
    assert found(fenced(VALID)).notes == ()
    assert (
        found(f"{fenced('from torch.nn import *' + chr(10) + 'net = ' + NAME + '()' + chr(10))}\n{fenced(VALID)}").notes
        == ()
    )
