"""Promise: `tacevo init` writes a task to search with at once, whole or not at all, and touches nothing else."""

import shlex
import shutil
from dataclasses import replace
from pathlib import Path

import pytest
from checkout import ROOT
from mounts import read_only
from refusals import refused

from tacevo.cli.app import main
from tacevo.config import conf_folder
from tacevo.config.compose import compose
from tacevo.config.new_task import write_task
from tacevo.config.task_texts import facts_without_data, left_of_others, load_task
from tacevo.errors import ConfigError
from tacevo.runs.datasets import source_of


@pytest.fixture
def conf(place: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return the conf/ of a checkout of the test's own."""
    shutil.copytree(ROOT / "conf", place / "conf")
    monkeypatch.setattr(conf_folder, "__file__", str(place / "tacevo" / "config" / "folder.py"))
    return place / "conf"


def contents(conf: Path) -> dict[str, bytes | None]:
    """Read all that lies in a directory, hidden files and empty directories, too."""
    paths = {str(path.relative_to(conf)): path for path in conf.rglob("*")}
    return {name: None if path.is_dir() else path.read_bytes() for name, path in paths.items()}


@pytest.mark.room("simulator")
@pytest.mark.few(1)
@pytest.mark.parametrize("like", ["force", "grating", "hardness", "shape"])
def test_new_task_is_the_other_under_its_own_name(like: str, conf: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """It has all that the other has, in files of its own; the gate admits its baseline; every printed command works."""
    before = contents(conf)
    assert main(["init", "shear", "--like", like]) == 0
    lines = capsys.readouterr().out.splitlines()
    texts = {f"library/shear/{name}" for name in ("baseline.py", "instructions.yaml", "system.md")}
    after = contents(conf)
    assert after.keys() - before.keys() == {"task/shear.yaml", "library/shear", *texts}
    assert after.items() >= before.items()
    assert {line.split()[1] for line in lines if line.startswith("wrote:")} == {
        *(f"conf/{name}" for name in ("task/shear.yaml", *texts))
    }

    old, new = (compose([f"task={name}"]) for name in (like, "shear"))
    assert {new.task.baseline, new.task.instructions, new.task.system} == texts
    of_old = {"name": like, **{key: getattr(old.task, key) for key in ("baseline", "instructions", "system")}}
    assert replace(new, task=replace(new.task, **of_old)) == old
    read_old, read_new = (load_task(config, facts_without_data(config)) for config in (old, new))
    assert replace(read_new, name=like) == read_old

    commands = {line.split(":")[0]: shlex.split(line, comments=True)[2:] for line in lines}
    assert main([*commands["verify"], "--image-size", "32"]) == 0
    assert "baseline.py: admitted" in capsys.readouterr().out
    assert compose(commands["look"][2:]).task == compose(commands["next"][1:]).task == new.task
    if like == "shape":  # a task of the release, whose images no simulation has
        assert "try" not in commands
    else:
        assert source_of(compose(commands["try"][1:])) == source_of(compose(["experiment=demo", f"task={like}"]))


def test_new_task_may_be_like_an_own_one(conf: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Its texts are copied from wherever they lie; of images that no simulation has, none are offered."""
    path = conf / "task" / "shear.yaml"
    path.write_text((conf / "task" / "force.yaml").read_text().replace("name: force", "name: shear"))
    assert main(["init", "twist", "--like", "shear"]) == 0
    assert "try:" not in capsys.readouterr().out
    for name in ("baseline.py", "instructions.yaml", "system.md"):
        assert (conf / "library" / "twist" / name).read_bytes() == (conf / "library" / "force" / name).read_bytes()


@pytest.mark.parametrize("name", ["Shear", "1shear", "my-", "-my", "my task", "", "../shear", "null", "true", "nan"])
def test_name_is_a_lower_case_identifier(name: str, conf: Path) -> None:
    """Hydra would read another one as a value, or it names a file elsewhere."""
    before = contents(conf)
    with refused(ConfigError, place="NAME", expected="a lower-case identifier", got=repr(name), remedy="shear"):
        write_task(name, "force")
    assert contents(conf) == before


@pytest.mark.parametrize(
    ("name", "there"), [("force", "task/force.yaml"), ("shear", "task/shear.yaml"), ("shear", "library/shear")]
)
def test_what_exists_is_not_touched(name: str, there: str, conf: Path) -> None:
    """The settings or the directory alone are enough to refuse a name."""
    if name == "shear":
        (conf / there).mkdir()
    before = contents(conf)
    with refused(ConfigError, place="NAME", expected="that no task has", got=there, remedy="another"):
        write_task(name, "hardness")
    assert contents(conf) == before


def test_unknown_task_to_copy_is_refused(conf: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The message lists those that there are."""
    before = contents(conf)
    assert main(["init", "shear", "--like", "forse"]) == 2
    assert "--like: expected one of force, grating, hardness, shape; got 'forse'; " in capsys.readouterr().err
    assert contents(conf) == before


@pytest.mark.few(1)
@pytest.mark.parametrize("options", [[], ["--config-dir", "my configs"]], ids=["here", "elsewhere"])
def test_task_lies_where_the_user_stands(
    options: list[str], place: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """In ./conf or the directory that --config-dir names, beside the configs of tacevo, which are left alone."""
    before = contents(ROOT / "conf")
    assert main(["init", "shear", "--like", "force", *options]) == 0
    own = place / (options[-1] if options else "conf")
    assert contents(own).keys() >= {"task/shear.yaml", "library/shear/baseline.py"}
    assert contents(ROOT / "conf") == before
    lines = capsys.readouterr().out.splitlines()
    verify, following = (shlex.split(line)[2:] for line in lines if line.startswith(("verify:", "next:")))
    assert main([*verify, "--image-size", "32"]) == 0
    assert main([*following[:1], "--cfg", "job", *following[1:]]) == 0
    assert "baseline: library/shear/baseline.py" in capsys.readouterr().out
    (place / "below").mkdir()
    monkeypatch.chdir("below")
    assert main([*following[:1], "--cfg", "job", *following[1:]]) == 2
    assert ("--config-dir: expected a directory" if options else "expected one of ") in capsys.readouterr().err


@pytest.mark.few(1)
@pytest.mark.parametrize("name", ["task/grating.yaml", "library/grating/system.md", "ablation/no_qd.yaml"])
def test_name_that_tacevo_has_is_refused_where_it_is_used(name: str, place: Path) -> None:
    """Else an edited copy would silently have no effect; an equal copy, and what is not chosen, may lie there."""
    own = place / "conf" / name
    own.parent.mkdir(parents=True)
    shutil.copy(ROOT / "conf" / name, own)
    (place / "conf" / "task").mkdir(exist_ok=True)
    (place / "conf" / "task" / "hardness.yaml").write_text("another: program's\n")

    def load() -> None:
        config = compose(["experiment=demo", "ablation=no_qd"])
        load_task(config, facts_without_data(config))

    load()
    own.write_text(own.read_text() + "# edited\n")
    with refused(
        ConfigError, place=name.split("/", maxsplit=1)[0].replace("library", "task"), got=str(own), remedy="rename it"
    ):
        load()


@pytest.mark.parametrize("protected", ["task", "library"])
def test_directory_that_cannot_be_written_is_named(protected: str, conf: Path) -> None:
    """Where one of the two places is write-protected, nothing is left in the other."""
    before = contents(conf)
    with (
        read_only(conf / protected),
        refused(ConfigError, place="conf", expected="can be written to", got="nothing was written"),
    ):
        write_task("shear", "force")
    assert contents(conf) == before


@pytest.mark.slow
def test_a_check_and_the_search_after_it_take_the_same_images(conf: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The size that was looked at is the size that is trained with."""
    for name, like in (("shear", "force"), ("ridges", "grating")):
        assert main(["init", name, "--like", like]) == 0
        lines = capsys.readouterr().out.splitlines()
        commands = {line.split(":")[0]: shlex.split(line, comments=True)[2:] for line in lines}
        look, following = compose(commands["look"][2:]), compose(commands["next"][1:])
        assert look.data == following.data
        assert look.data.image_size < 256


def test_what_is_left_of_the_other_task_is_named_until_it_is_gone(
    conf: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The lines whose words are another task's, then what was edited in one file alone; of a sound task, nothing."""
    assert main(["init", "shear", "--like", "force"]) == 0
    out = capsys.readouterr().out
    assert "conf/library/shear/system.md tells the model of another task: 'force' in line 6" in out
    assert left_of_others(compose(["task=force"]).task) == []
    own = conf / "library" / "shear"
    for name in ("system.md", "instructions.yaml", "baseline.py"):
        text = (own / name).read_text()
        (own / name).write_text("".join(line.replace("force", "slip") for line in text.splitlines(keepends=True)))
    assert left_of_others(compose(["task=shear"]).task) == []
    (own / "system.md").write_text((own / "system.md").read_text() + "Grooves help.\n")
    two = compose(["task=shear", "task.outputs=2", "task.output_names=[a,b,c]"]).task
    names, words = left_of_others(two)
    assert "task.outputs=2, and task.output_names=a, b, c" in names
    assert words.startswith("conf/library/shear/system.md")
    assert "'Grooves' in line" in words
    assert left_of_others(replace(two, output_names=("a", "b"))) == [words]


@pytest.mark.few(1)
@pytest.mark.parametrize(
    ("name", "names", "kept"),
    [("shear_force", "[a,b,c]", set()), ("shear", "[force_x,force_y,force_z]", set()), ("shear", "[a,b,c]", {"force"})],
)
def test_words_of_the_tasks_own_names_are_no_trap(name: str, names: str, kept: set[str], conf: Path) -> None:
    """A task may well be about a force, under another name."""
    write_task(name, "force")
    said = " ".join(left_of_others(compose([f"task={name}", f"task.output_names={names}"]).task))
    assert {word for word in ("force", "grating", "hard") if f"'{word}" in said} == kept
