"""Promise: `tacevo init NAME --from-supplement FILE` makes a task of the prompts in the reader's copy of a page."""

from pathlib import Path

import pytest
from refusals import refused
from supplement import PAGE

from tacevo.cli.app import main
from tacevo.config.compose import compose
from tacevo.config.new_task import write_task
from tacevo.config.task_texts import facts_without_data, load_task
from tacevo.errors import ConfigError


@pytest.fixture
def page(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A page like the supplement, in a directory where a user stands."""
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "index.html"
    path.write_text(PAGE, encoding="utf-8")
    return path


@pytest.mark.few(1)
@pytest.mark.parametrize(
    ("name", "options", "texts", "words"),
    [
        (
            "force-paper",
            [],
            ["Make it smaller than 1.", *["Again."] * 18, "Add a `nn.Tanh` between \u22121 and 1."],
            "Change ImageRegres",
        ),
        (
            "grating-paper",
            [],
            ["Widen `conv2` for $5.", *["Again."] * 16],
            "Change it for $5 < $6, (see the instruction in the",
        ),
        ("other", ["--like", "grating"], ["Widen `conv2` for $5.", *["Again."] * 16], "Change it for $5 < $6"),
    ],
)
def test_prompts_are_the_pages(page: Path, name: str, options: list[str], texts: list[str], words: str) -> None:
    """Word for word, but for the two marks that the next message answers; all else is that of the task it is like."""
    assert main(["init", name, "--from-supplement", str(page), *options]) == 0
    like = options[-1] if options else name.split("-", maxsplit=1)[0]
    worded = "temperature.carrier=words"
    config, usual = compose([f"task={name}", worded]), compose([f"task={like}", worded])
    task, old = (load_task(each, facts_without_data(each)) for each in (config, usual))
    assert [instruction.text for instruction in task.instructions] == texts
    assert task.system.startswith(words)
    assert "{" not in task.system
    assert (task.baseline, task.crossover, task.boldness, task.contract, task.name) == (
        old.baseline,
        old.crossover,
        old.boldness,
        old.contract,
        old.name,
    )


def test_text_behind_nested_tags_stays(page: Path) -> None:
    """An instruction that holds a list, and a listing that holds a block, are read to their own end."""
    nested = PAGE.replace("than 1.</code>", "than 1:</code><ul><li>here<li></li></li><li>there</li></ul>or<br>both.")
    nested = nested.replace("Code:", "<div>Mind <div>this</div></div>Code:")
    page.write_text(nested, encoding="utf-8")
    write_task("force-paper", "force", page)
    config = compose(["task=force-paper"])
    task = load_task(config, facts_without_data(config))
    assert task.instructions[0].text == "Make it smaller than 1: here there or both."
    after = [line.strip() for line in task.system.splitlines()[2:]]
    assert after == ["Mind", "this", "Code:", "```python", "(see the parent network in the next message)", "```"]


@pytest.mark.few(2)
@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("force-paper", PAGE.replace("<li>Again.</li>", "", 1)),
        ("force-paper", PAGE.replace("<li>Again.</li>", "<li>Again.<li>Again.</li>", 1)),
        ("grating-paper", PAGE.replace("for $5.</code></li>", "for $5.</code>")),
        ("force-paper", "<p>another page</p>"),
        ("force-paper", PAGE.replace("{base_net_code}", "")),
        (
            "grating-paper",
            PAGE.replace("<li><code>Widen", "<p><code>Widen").replace("$5.</code></li>", "$5.</code></p>"),
        ),
    ],
)
def test_another_page_is_refused_and_leaves_nothing(page: Path, name: str, text: str) -> None:
    """The message says what the page lacks."""
    page.write_text(text, encoding="utf-8")
    with refused(ConfigError, place="--from-supplement", expected="{instruction_prompt}", remedy="index.html"):
        write_task(name, name.split("-", maxsplit=1)[0], page)
    assert [path for path in page.parent.rglob("*") if path.is_file()] == [page]


def test_task_without_prompts_there_is_refused(page: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The supplement has those of two tasks; a missing file is told, too."""
    assert main(["init", "hardness-paper", "--from-supplement", str(page)]) == 2
    assert "--like: expected one of force, grating; got 'hardness'" in capsys.readouterr().err
    with refused(ConfigError, place="--from-supplement", got="a file that cannot be read"):
        write_task("force-paper", "force", page.parent / "absent.html")
