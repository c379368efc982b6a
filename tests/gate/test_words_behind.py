"""Honest words behind a finished class leave it the answer; a later version of it does not, whatever its form."""

from textwrap import indent

import pytest
from gate_cases import VALID, fenced, refusal_of, source_of

from tacevo.records import Reason

NAME = "ImageRegressionCNN"
NEW = VALID.replace("4", "8")
LAYERS = """    def __init__(self, in_channels=3, num_outputs=3):
        super().__init__()
        self.stem = nn.Conv2d(in_channels, 6, 5)
        self.out = nn.Linear(6, num_outputs)

    def forward(self, x):
        return self.out(F.gelu(self.stem(x)).mean((2, 3)))
"""
OTHER = f"class {NAME}(nn.Module):\n{LAYERS}"
LESS = NEW.replace("F.relu(self.conv(x))", "self.conv(x)")
BROKEN = OTHER.replace("5)", "5")

#: What may stand behind the class and is no version of it.
HONEST = {
    "signatures between bare fences": fenced(
        f"class {NAME}(nn.Module)\n    def __init__(self, in_channels, num_outputs)\n    def forward(self, image)\n", ""
    ),
    "test class": fenced(f"class Test{NAME}:\n    def test_two(self):\n        assert {NAME}()(X).shape == (2, 3)\n"),
    "unittest": fenced(
        f"class {NAME}Test(unittest.TestCase):\n    def setUp(self):\n        self.net = {NAME}()\n\n"
        "    def test_shape(self):\n        out = self.net(torch.zeros(2, 3, 48, 48))\n"
        "        self.assertEqual(out.shape, (2, 3))\n"
    ),
    "broken test class": fenced(
        f"class Test{NAME}(unittest.TestCase):\n    def setUp(self):\n        self.net = {NAME}(\n\n"
        "    def test_shape(self)\n        out = self.net(X)\n"
    ),
    "settings": fenced(f"@dataclass\nclass {NAME}Config:\n    width: int = 4\n    rate: float = 1e-3\n"),
    "settings of a constructor": fenced(
        f"class {NAME}Settings:\n    def __init__(self, width=4):\n        self.width = width\n"
    ),
    "named tuple": fenced(f"class {NAME}Output(NamedTuple):\n    force: torch.Tensor\n    torque: torch.Tensor\n"),
    "trainer": fenced(
        f"class {NAME}Task(lightning.LightningModule):\n    def __init__(self):\n        super().__init__()\n"
        f"        self.net = {NAME}()\n\n    def training_step(self, batch, index):\n        images, forces = batch\n"
        "        return F.mse_loss(self.net(images), forces)\n"
    ),
    "trainer with forward": fenced(
        f"class Lit{NAME}(pl.LightningModule):\n    def __init__(self):\n        super().__init__()\n"
        f"        self.net = {NAME}()\n        self.loss = nn.MSELoss()\n\n    def forward(self, x):\n"
        "        return self.net(x)\n"
    ),
    "trainer of an argument": fenced(
        f"class {NAME}Module(pl.LightningModule):\n    def __init__(self, net):\n        super().__init__()\n"
        "        self.net = net\n        self.f1 = F1Score()\n\n    def forward(self, x):\n        return self.net(x)\n"
        "    def training_step(self, batch, index):\n        return F.cross_entropy(self(batch[0]), batch[1])\n"
    ),
    "subclass with a loss": fenced(
        f"class Lit{NAME}({NAME}):\n    def __init__(self):\n        super().__init__()\n        self.a = nn.L1Loss()\n"
    ),
    "wrapper of an argument": fenced(
        f"class {NAME}Export(nn.Module):\n    def __init__(self, net):\n        super().__init__()\n"
        "        self.net = net\n\n    def forward(self, image):\n        return self.net(image / 255)\n"
    ),
    "wrapper of an argument that computes": fenced(
        f"class {NAME}Student(nn.Module):\n    def __init__(self, teacher):\n        super().__init__()\n"
        "        self.teacher = teacher\n        self.proj = nn.Linear(3, 3)\n\n    def forward(self, x):\n"
        "        return self.proj(self.teacher(F.pad(x, (1, 1))))\n"
    ),
    "loss": fenced(
        f"class {NAME}Loss(nn.Module):\n    def forward(self, force, truth):\n        return F.mse_loss(force, truth)\n"
    ),
    "data set": fenced(
        f"class {NAME}Dataset(Dataset):\n    def __getitem__(self, i):\n        return self.images[i]\n"
    ),
    "trainer of its own": fenced(
        f"class {NAME}Trainer:\n    def __init__(self, net):\n        self.net = net\n\n    def fit(self, loader):\n"
        "        for images, forces in loader:\n            self.step(images, forces)\n"
    ),
    "subclass that trains": fenced(
        f"class Trainable{NAME}({NAME}):\n    def training_step(self, batch, index):\n        return self(batch[0])\n"
    ),
    "ensemble": fenced(
        f"class {NAME}2(nn.Module):\n    def __init__(self):\n        super().__init__()\n        self.a = {NAME}()\n"
        f"        self.b = {NAME}()\n\n    def forward(self, x):\n        return (self.a(x) + self.b(x)) / 2\n"
    ),
    "numbered notes": f"1. class {NAME}: everything\n   - stem: finds edges\n   - out: three numbers\n2. forward: all",
    "numbered notes with a bracket": f"1) class {NAME}(nn.Module): the network\n   a) conv: finds edges\n2) done",
    "bullets": f"- class {NAME}(nn.Module):\n  - conv: finds edges\n  - head: three numbers\n",
    "bullets with code": (
        f"* `class {NAME}(nn.Module):`\n  * `def __init__(self, ...)`: makes the layers\n"
        "  * `def forward(self, x)`: image to force\n"
    ),
    "bullets with its lines": (
        f"- class {NAME}(nn.Module):\n    - self.conv = nn.Conv2d(in_channels, 8, 3): finds edges\n"
        "    - self.head = nn.Linear(8, num_outputs): three numbers\n"
    ),
    "table": f"| part | what |\n|---|---|\n| class {NAME}(nn.Module): | all |\n|     def forward(self, x): | force |\n",
    "table of statements": (
        f"| code | why |\n|---|---|\n| class {NAME}(nn.Module): | all |\n|     self.w = nn.Conv2d(3, 9, 3) | edges |\n"
    ),
    "outline": f"class {NAME}(nn.Module):\n    conv: finds edges\n    head: numbers\n    forward: image to force\n",
    "outline in a fence": fenced(f"class {NAME}\n  __init__\n  forward\n", "text"),
    "outline between bare fences": fenced(f"class {NAME}:\n    conv -> relu -> mean -> head\n", ""),
    "outline that parses": fenced(
        f"class {NAME}(nn.Module):\n    __init__(in_channels, num_outputs)\n    forward(x)\n"
    ),
    "outline of annotations": fenced(f"class {NAME}(nn.Module):\n    conv: Conv2d\n    head: Linear\n", ""),
    "tree": fenced(f"{NAME}\n├── conv: Conv2d(3, 8, 3)\n└── head: Linear(8, 3)\n", ""),
    "print of it": fenced(
        f"{NAME}(\n  (conv): Conv2d(3, 8, kernel_size=(3, 3))\n  (head): Linear(in_features=8)\n)\n", ""
    ),
    "copy with remarks": fenced(
        f"class {NAME}(nn.Module):   <- all of it\n    self.conv = nn.Conv2d(in_channels, 8, 3)   <- edges\n"
        "    def forward(self, x):   <- image to force\n",
        "text",
    ),
    "signature": f"So\n\n    class {NAME}(nn.Module)\n        def __init__(self, in_channels=3, num_outputs=3)\n",
    "bullets with layers": f"class {NAME}(nn.Module):\n- self.conv = a 3x3 conv\n- self.head = a linear layer\n",
    "numbered layers": f"1. class {NAME}:\n2. self.conv = the 3x3 conv\n3. self.head = a linear layer\n",
    "stub": fenced(f"class {NAME}(nn.Module):\n    conv: nn.Conv2d\n    def forward(self, x: Tensor) -> Tensor: ...\n"),
    "outline of assignments": fenced(
        f"class {NAME}(nn.Module):\n    def __init__(self):\n        self.conv = ...\n    def forward(self, x): ...\n"
    ),
    "diagram": fenced(f"classDiagram\n  class {NAME} {{\n    +forward(x)\n  }}\n", "mermaid"),
    "documentation": f".. autoclass:: {NAME}\n\nclass {NAME}(in_channels=3)\n   Maps images.\n\n   forward(x)\n",
    "keras": fenced(
        f"class {NAME}(tf.keras.Model):\n    def __init__(self):\n        super().__init__()\n"
        "        self.head = tf.keras.layers.Dense(3)\n\n    def call(self, x):\n        return self.head(x)\n"
    ),
    "flax": fenced(
        f"class {NAME}(nn.Module):\n    @nn.compact\n    def __call__(self, x):\n        return nn.Dense(3)(x)\n"
    ),
    "matlab": fenced(
        f"classdef {NAME} < handle\n  methods\n    function y = forward(self, x)\n      y = self.conv(x);\n", "matlab"
    ),
    "copy of another name": fenced(NEW.replace(NAME, f"{NAME}Copy")),
    "c++": fenced(
        f"class {NAME} : public torch::nn::Module {{\n public:\n  torch::Tensor forward(torch::Tensor image);\n}};\n",
        "cpp",
    ),
    "c++ with a brace below": fenced(
        f"class {NAME} : public torch::nn::Module\n{{\n  torch::Tensor forward(torch::Tensor x) {{ return x; }}\n}};\n",
        "",
    ),
    "swift": fenced(
        f"class {NAME}: Module {{\n    init() {{\n        self.a = Conv2d(3, 8)\n    }}\n    func forward() {{}}\n}}\n",
        "swift",
    ),
    "kotlin": fenced(
        f"class {NAME}(val outputs: Int = 3) : Module() {{\n    fun forward(x: Tensor) = x\n}}\n", "kotlin"
    ),
    "typescript": fenced(
        f"class {NAME} extends nn.Module {{\n  constructor() {{\n    super();\n    this.conv = conv(3, 8);\n  }}\n}}\n",
        "ts",
    ),
    "ruby": fenced(
        f"class {NAME} < Torch::NN::Module\n  def initialize\n    super()\n    @conv = 1\n  end\nend\n", "ruby"
    ),
    "c sharp": fenced(
        f"public class {NAME} : Module<Tensor, Tensor>\n{{\n    Tensor forward(Tensor x) => x;\n}}\n", "csharp"
    ),
    "yaml": fenced(f"class: {NAME}\nlayers:\n  - conv: 8\n  - head: 3\n", "yaml"),
    "yaml of the name": fenced(f"{NAME}:\n  conv: {{channels: 8}}\n  head: {{outputs: 3}}\n", "yaml"),
    "json": fenced(f'{{"class": "{NAME}", "conv": 8, "head": 3}}\n', "json"),
    "toml": fenced(f"[model]\n{NAME} = {{ conv = 8, head = 3 }}\n", "toml"),
    "julia": fenced(f"{NAME} = Chain(Conv((3, 3), 3 => 8), Dense(8 => 3))\n", "julia"),
    "constant": fenced(f'{NAME} = "8 channels"\n', ""),
    "compiled": fenced(f"{NAME} = torch.compile({NAME})\n"),
    "use": fenced(f"net = {NAME}()\nprint(net(torch.zeros(1, 3, 48, 48)).shape)\n"),
    "factory": fenced(f"def make_{NAME}(width):\n    return {NAME}()\n"),
    "sentence": f"The class {NAME}:\nit is small.\n\nUse self.head = None to cut it.",
    "heading": f"### class {NAME}\n\nIt has self.conv and self.head.",
    "excerpt": fenced(f"class {NAME}(nn.Module):\n    ...\n    def forward(self, x):\n        ...\n"),
    "forward alone": fenced("def forward(self, x):\n    return self.head(F.relu(self.conv(x)).mean((2, 3)))\n"),
    "function with a class in it": fenced(f"def test():\n    class Wrapped({NAME}):\n        pass\n    Wrapped()\n"),
    "copy in a function": fenced("def make():\n" + indent(NEW, "    ") + f"    return {NAME}\n"),
}

#: Versions that the model went on to, in forms that cannot be used.
LATER = {
    "full-width brackets": fenced(f"class {NAME}\uff08nn.Module\uff09:\n{LAYERS}"),
    "full-width signs": fenced(f"class {NAME}\uff08nn.Module\uff09\uff1a\n{LAYERS}"),
    "renamed with an argument of its layers": fenced(
        f"class {NAME}2(nn.Module):\n{LAYERS.replace('in_channels=3, num', 'width, num').replace('6', 'width')}"
    ),
    "less under if": fenced("if True:\n" + indent(LESS, "    ")),
    "less in a function": fenced("def build():\n" + indent(LESS, "    ") + f"    return {NAME}\n"),
    "less in a string": fenced(f"SOURCE = '''\n{LESS}'''\n"),
    "less under another name": fenced(LESS.replace(NAME, f"{NAME}Small")),
    "less without a colon": fenced(LESS.replace("(self, x):", "(self, x)")),
    "less with another indentation": fenced(LESS.replace("        self.head", "      self.head")),
    "no-break space behind class": fenced(OTHER.replace("class ", "class\u00a0")),
    "zero width in class": fenced(OTHER.replace("class ", "cl\u200bass ")),
    "other default": fenced("if True:\n" + indent(NEW.replace("num_outputs=3", "num_outputs=1"), "    ")),
    "in a loop": fenced("for _ in range(1):\n" + indent(OTHER, "    ")),
    "in a case": fenced("match 1:\n    case 1:\n" + indent(OTHER, "        ")),
    "in an async function": fenced("async def build():\n" + indent(OTHER, "    ")),
    "made by type": fenced(f"{NAME} = type('{NAME}', (nn.Module,), {{'forward': run}})\n"),
    "broken under another class's name": fenced(f"{BROKEN.replace(NAME, 'Net')}\n{NAME} = Net\n"),
    "under if": fenced("if True:\n" + indent(OTHER, "    ")),
    "under else": fenced("if False:\n    pass\nelse:\n" + indent(OTHER, "    ")),
    "under try": fenced("try:\n" + indent(OTHER, "    ") + "except Exception:\n    raise\n"),
    "under with": fenced("with torch.no_grad():\n" + indent(OTHER, "    ")),
    "in a function": fenced("def build():\n" + indent(OTHER, "    ") + f"    return {NAME}\n"),
    "in a class": fenced("class Models:\n" + indent(OTHER, "    ")),
    "zero width in the name": fenced(f"class Image\u200bRegressionCNN(nn.Module):\n{LAYERS}"),
    "zero width behind the name": fenced(f"class {NAME}\u200b(nn.Module):\n{LAYERS}"),
    "zero width before class": fenced(f"\u200bclass {NAME}(nn.Module):\n{LAYERS}"),
    "zero width behind class": fenced(f"class\u2060 {NAME}(nn.Module):\n{LAYERS}"),
    "joiner": fenced(f"class Image\u200dRegression\u200cCNN(nn.Module):\n{LAYERS}"),
    "soft hyphen": fenced(f"class Image\u00adRegressionCNN(nn.Module):\n{LAYERS}"),
    "byte order mark": fenced(f"\ufeffclass {NAME}(nn.Module):\n{LAYERS}"),
    "zero width without a fence": f"class Image\u200bRegressionCNN(nn.Module):\n{LAYERS}",
    "in a string": fenced(f"SOURCE = '''\nclass {NAME}(nn.Module):\n{LAYERS}'''\n"),
    "written to a file": fenced(f"Path('net.py').write_text('''class {NAME}(nn.Module):\n{LAYERS}''')\n"),
    "renamed": fenced(f"class {NAME}v2(nn.Module):\n{LAYERS}"),
    "renamed in front": fenced(f"class Better{NAME}(nn.Module):\n{LAYERS}"),
    "renamed with underscores": fenced(f"class Image_Regression_CNN(nn.Module):\n{LAYERS}"),
    "renamed and broken": fenced(f"class {NAME}v2(nn.Module):\n{LAYERS.replace('5)', '5')}"),
    "renamed without a base": fenced(f"class {NAME}2:\n{LAYERS}"),
    "renamed for a trainer": fenced(f"class {NAME}Task(pl.LightningModule):\n{LAYERS}"),
    "renamed under if": fenced("if True:\n" + indent(OTHER.replace("CNN", "CNNv2"), "    ")),
    "subclass with another forward": fenced(
        f"class {NAME}2({NAME}):\n    def forward(self, x):\n        return 2 * super().forward(x)\n"
    ),
    "subclass with other layers": fenced(
        f"class {NAME}2({NAME}):\n    def __init__(self):\n        super().__init__()\n        self.a = nn.ReLU()\n"
    ),
    "function": fenced(f"def {NAME}(in_channels=3, num_outputs=3):\n    return nn.Sequential(nn.Flatten())\n"),
    "sequential": fenced(f"{NAME} = nn.Sequential(nn.Flatten(), nn.LazyLinear(3))\n"),
    "lambda": fenced(f"{NAME} = lambda in_channels=3, num_outputs=3: nn.Flatten()\n"),
    "broken": fenced(BROKEN),
    "broken without a fence": BROKEN,
    "broken in a fence of text": fenced(BROKEN, "text"),
    "broken in a fence of another language": fenced(BROKEN, "java"),
    "only its constructor": fenced(
        f"class {NAME}(nn.Module):\n{LAYERS.split('    def forward', maxsplit=1)[0]}    ...\n"
    ),
    "only its forward": fenced(
        f"class {NAME}(nn.Module):\n    ...\n    def forward(self, x):\n        return self.conv(x)\n"
    ),
    "numbered": "\n".join(f"{at}  {line}" for at, line in enumerate(OTHER.split("\n"), 10)),
    "numbered with points": "\n".join(f"{at:2}. {line}" for at, line in enumerate(OTHER.split("\n"), 1)),
    "bars": "\n".join(f"| {line}" for line in OTHER.split("\n")),
    "diff": fenced(indent(OTHER, "+"), "diff"),
    "diff of a part": fenced(
        f" class {NAME}(nn.Module):\n     def __init__(self):\n-        self.conv = nn.Conv2d(3, 8, 3)\n"
        "+        self.conv = nn.Conv2d(3, 12, 3)\n",
        "diff",
    ),
    "json with a fault": fenced(
        '{"code": "class ' + NAME + "(nn.Module):\\n" + LAYERS.replace("\n", "\\n") + '",,}\n', "json"
    ),
    "behind words": f"So: `class {NAME}(nn.Module):\n{LAYERS}`",
    "upper case": fenced(f"Class {NAME}(nn.Module):\n{LAYERS}"),
    "indentation lost": fenced("\n".join(map(str.strip, OTHER.split("\n")))),
}


@pytest.mark.parametrize("behind", HONEST.values(), ids=HONEST)
@pytest.mark.parametrize("write", ["{}", "It's done.\n\n{}\n\nThat's all."])
def test_honest_words_do_not_reject_a_finished_class(behind: str, write: str) -> None:
    """A test, settings, a wrapper, notes, a table, an outline and another language are no versions."""
    assert source_of(f"{fenced(NEW)}\n\n{write.format(behind)}") == NEW


@pytest.mark.parametrize("behind", LATER.values(), ids=LATER)
@pytest.mark.parametrize("first", [fenced(NEW), f"\n{NEW}", fenced(NEW, "text")], ids=["fenced", "bare", "text"])
def test_later_version_that_cannot_be_used_leaves_no_answer(first: str, behind: str) -> None:
    """Otherwise the archive would hold a network that the model had given up."""
    assert refusal_of(f"It's:\n{first}\n\nBetter:\n\n{behind}\n\nUse that one.").reason in (
        Reason.no_class,
        Reason.syntax,
    )


@pytest.mark.parametrize("behind", HONEST.values(), ids=HONEST)
def test_later_version_counts_among_honest_words(behind: str) -> None:
    """Words between two versions hide neither the later one nor its fault."""
    broken = NEW.replace("nn.Linear(8, num_outputs)", "nn.Linear(8, num_outputs")
    assert source_of(f"{fenced(VALID)}\n\n{behind}\n\nBetter:\n{fenced(NEW)}\n\n{behind}") == NEW
    assert refusal_of(f"{fenced(VALID)}\n\n{behind}\n\nBetter:\n{fenced(broken)}\n\n{behind}").reason is Reason.syntax


def test_class_under_if_without_a_fence_counts_or_leaves_no_answer() -> None:
    """The first one does not count in any case."""
    text = f"{fenced(NEW)}\n\nBetter:\n\nif True:\n{indent(OTHER, '    ')}"
    assert source_of(text) == OTHER
