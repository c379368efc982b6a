"""A part that decides is recorded and confined: whatever it does, a decision follows from what it was given."""

import json
import os
import re
import shutil
import subprocess
import sys
import zipfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bundles import entries_of, honest, members_of, resealed, with_entries, zipped
from checkout import ROOT
from commands import publish, tacevo
from refusals import refused
from smallest import PUBLISHED_SIZES, SMALLEST, UNTRACKED, Once

from tacevo.bundles.format import sealed
from tacevo.config.compose import compose
from tacevo.config.conf_folder import reading_own
from tacevo.errors import ConfigError, PartError
from tacevo.parts.kinds import ARCHIVES, PARENTS, PROMPTS
from tacevo.parts.registry import Part, find
from tacevo.parts.sources import read_sources
from tacevo.records import Json, Limits
from tacevo.sandbox.part_process import PartProcess, Recorded

HONEST = ROOT / "tests/support/deciding/honest.py"

GIVEN: Json = {
    "pool": [
        {
            "id": f"g00s{slot:02d}",
            "source": "class Net: pass",
            "fitness": 1.0 / (slot + 1),
            "losses": [1.0],
            "parameters": 1,
            "flops": 1,
            "parents": [],
            "curiosity": 1.0,
        }
        for slot in range(4)
    ],
    "number": 1,
    "rng": [1, 2],
}


def part(body: str, *, head: str = "", tail: str = "") -> Recorded:
    """Return a part whose `draw` has this body, as if a run had recorded it."""
    lines = "\n".join(f"        {line}" for line in body.split("\n"))
    text = f"""from dataclasses import dataclass
import numpy as np
from tacevo.parts import Parents
{head}

@dataclass(frozen=True)
class Rule(Parents):
    def draw(self, pool, number, rng):
{lines}

{tail}
"""
    return Recorded(kind=PARENTS, name="Rule", module="rule", attribute="Rule", sources={"rule.py": text})


@pytest.fixture(scope="module")
def process() -> Any:
    """Return where parts decide."""
    with PartProcess(limits=Limits(seconds=1.5, memory_mib=512)) as process:
        yield process


@pytest.mark.parametrize(
    "body",
    [
        "state.append(1)\nreturn [pool[len(state) - 1]]",
        "for one in pool: object.__setattr__(one, 'fitness', 0.0)\npool.sort(key=lambda one: one.id)\nreturn [pool[0]]",
        "print('x' * 100_000)\nreturn [pool[0]]",
    ],
)
def test_nothing_is_kept_or_shown(process: PartProcess, body: str) -> None:
    """State between calls, changes of what it is given, what it prints: the next decision is that of the first."""
    rule = part(body, head="state = []")
    assert [process.ask(rule, "parents.draw", GIVEN) for _ in range(3)] == [["g00s00"]] * 3


@pytest.mark.parametrize(
    ("body", "fault"),
    [
        ("return [pool[int(statistics.random.random() * 4)]]", "draws what no record has"),
        ("return [pool[np.random.default_rng().integers(4)]]", "draws what no record has"),
        ("return [pool[int(statistics.random._os.sys.argv[0])]]", "for the same"),
        ("return [pool[statistics.random._os.cpu_count()]]", "for the same"),
        ("return [pool[len(statistics.random._os.sched_getaffinity(0))]]", "for the same"),
        ("import time\nreturn [pool[0]]", "may not import time"),
        ("__import__('os').getpid()", "may not import os"),
        ("return [pool[np.random.randint(4)]]", "draws what no record has"),
        ("raise ValueError('no such luck')", "ValueError: no such luck, rule.py, line"),
        ("while True: pass", "out_of_time"),
        ("return [bytearray(4 * 10**9)]", "MemoryError"),
        ("statistics.random._os._exit(0)", "crashed"),
        ("os = statistics.random._os\nos.kill(os.getppid(), 9)\nreturn [pool[0]]", ""),
        ("open('/etc/passwd').read()", "Error"),
        ("statistics.random._os.listdir('/')", "Error"),
        ("statistics.random._os.fork()", "Error"),
        ("return pool[0].nothing", "AttributeError"),
        ("return 3", "TypeError"),
        ("return sorted(pool, key=id)[:1]", "for the same"),
        ("return [pool[min(range(4), key=lambda one: hash(objects[one]))]]", "for the same"),
    ],
)
def test_fault_of_a_part_names_it_and_is_no_decision(process: PartProcess, body: str, fault: str) -> None:
    """A clock, a generator of its own, an endless loop, a file, a socket, a program, a process that is not its own."""
    with pytest.raises(PartError) as caught:
        process.ask(part(body, head="import statistics\nobjects = [object() for _ in range(4)]"), "parents.draw", GIVEN)
    assert fault in caught.value.got
    assert caught.value.place == "proposals.parents=Rule, parents.draw"


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("import time", "imports of its own modules"),
        ("from os import path", "imports of its own modules"),
        ("import tacevo.storage.store", "imports of its own modules"),
        ("def f():\n    import random", "imports of its own modules"),
        ("x = (", "Python"),
        ("import numpy as np\nnow = np.datetime64('now')", "no clock"),
        ("import numpy as np\nnow = np.array('now', dtype='M8[s]')", "no clock"),
        ("def order(pool):\n    return sorted(pool, key=id)", "no address"),
    ],
)
def test_part_is_read_without_being_run(tmp_path: Path, text: str, expected: str) -> None:
    """What it may not import is refused with its line; its module has no effect here."""
    file = tmp_path / "rule.py"
    file.write_text(f"open({str(tmp_path / 'ran')!r}, 'w')\n{text}\n")
    with refused(ConfigError, place="proposals.parents=Rule, rule.py", expected=expected):
        read_sources(find(PARENTS, f"{file}:Rule"))
    assert not (tmp_path / "ran").exists()


def test_mark_before_the_source_is_no_part_of_it(tmp_path: Path) -> None:
    """Some editors write one; the part is the same with it, in a module that it imports, too. UTF-16 is refused."""
    for folder, encoding in (("plain", "utf-8"), ("marked", "utf-8-sig"), ("wide", "utf-16")):
        shutil.copytree(HONEST.parent, tmp_path / folder, ignore=shutil.ignore_patterns("__pycache__"))
        for file in (tmp_path / folder).glob("*.py"):
            file.write_text(file.read_text(), encoding=encoding)
    plain, marked = (read_sources(find(PARENTS, f"{tmp_path / name}/honest.py:Greedy")) for name in ("plain", "marked"))
    assert plain == marked
    with refused(ConfigError, place="proposals.parents=Greedy", expected="UTF-8"):
        read_sources(find(PARENTS, f"{tmp_path}/wide/honest.py:Greedy"))


SIZES = [*SMALLEST, UNTRACKED, *PUBLISHED_SIZES, "search.generations=2", "store.root=cache", "run.dir=run"]

CHOSEN = [
    "proposals.parents=parts/honest.py:Greedy",
    "prompts.policy=parts/honest.py:Last",
    "temperature.rule=parts/honest.py:Falling",
    "training.fitness=parts/honest.py:Half",
    "archive.axes=[arch_div,parts/honest.py:Size]",
    "archive.kind=parts/honest.py:Rows",
    "parts.Greedy.k=3",
]


def _record(folder: Path) -> None:
    """Search with a part of every kind that decides, publish it, and lose the parts."""
    shutil.copytree(HONEST.parent, folder / "parts", ignore=shutil.ignore_patterns("__pycache__"))
    tacevo("search", *SIZES, *CHOSEN, cwd=folder)
    publish("run", "-o", "run.zip", cwd=folder)
    (folder / "parts").rename(folder / "lost")


@pytest.fixture(scope="module")
def recorded(once: Once) -> Path:
    """Return a folder with a run (`run`, `cache`) in which a user's parts decided, and `run.zip`, to be left alone."""
    return once("deciding", _record)


def test_part_without_a_pool_of_its_own_is_not_asked_for_one(tmp_path: Path) -> None:
    """The elites are its pool, and no decision is kept of that."""
    rule = "from dataclasses import dataclass\nfrom tacevo.parts import Parents\n@dataclass(frozen=True)\n"
    rule += "class First(Parents):\n    def draw(self, pool, number, rng):\n        return pool[:number]\n"
    (tmp_path / "rule.py").write_text(rule)
    tacevo("search", *SIZES, "proposals.parents=rule.py:First", cwd=tmp_path)
    kept = [json.loads(path.read_text()) for path in (tmp_path / "cache/decisions").rglob("*.json")]
    assert {entry["request"]["method"] for entry in kept} == {"parents.draw"}


def test_parts_of_every_kind_decide(recorded: Path) -> None:
    """What the ledger has is what each says; their sources are in the run, and nothing else of the folder."""
    lines = [json.loads(line) for line in (recorded / "run/ledger.jsonl").read_text().splitlines()]
    trained = [line for line in lines if line.get("fitness")]
    ids = {line["id"]: line["fitness"] for line in trained}
    assert all(line["fitness"] == pytest.approx(min(line["validation_losses"]) / 2) for line in trained)
    assert all(line["measures"] == [line["parameters"]] for line in trained)
    assert {line["prompt"] for line in lines if line.get("operator") == "mutation"} == {19}
    before = [line["id"] for line in trained if line["generation"] < 2]
    best = sorted(before, key=lambda name: (ids[name], name))[:3]
    assert {name for line in lines if line.get("generation") == 2 for name in line.get("parents", [])} <= set(best)
    generations = [line for line in lines if line["kind"] == "generation"]
    assert [line["next_temperature"] for line in generations][1] < generations[1]["temperature"]
    summary = (recorded / "run/summary.md").read_text()
    assert "proposals.parents=Greedy (k=3, margin=0.0)" in summary
    assert "archive.axes=Size" in summary
    assert re.search(r"^\| elite .* EffRatio +\| Size +\|", summary, re.MULTILINE)
    niches = json.loads((recorded / "run/archive.json").read_text())["elites"]
    assert {tuple(elite["centroid"]) for elite in niches} <= {((niche + 0.5) / 5,) * 2 for niche in range(5)}
    assert {path.name for path in (recorded / "run/parts").rglob("*.py")} == {"honest.py", "neighbour.py"}


def test_axis_of_a_user_is_shown(recorded: Path) -> None:
    """Under the name of its descriptor."""
    name, line = next((line["id"], line) for line in _lines(recorded) if line.get("measures"))
    shown = tacevo("show", "run", name, cwd=recorded).stdout
    (value,) = re.findall(r"^\| Size +\| (\S+) +\|", shown, re.MULTILINE)
    assert float(value) == pytest.approx(line["measures"][0], rel=1e-5)
    assert "measures" not in shown


def _lines(recorded: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in (recorded / "run/ledger.jsonl").read_text().splitlines()]


def test_what_python_compiled_is_no_source(recorded: Path, tmp_path: Path) -> None:
    """A directory of bytecode in a run changes no part; any other file does, and is named."""
    for name in ("run", "cache"):
        shutil.copytree(recorded / name, tmp_path / name)
    compiled = tmp_path / "run/parts/Greedy/__pycache__"
    compiled.mkdir()
    (compiled / "honest.cpython-311.pyc").write_bytes(b"\0")
    tacevo("replay", "run", cwd=tmp_path)
    (tmp_path / "run/parts/Greedy/stray.py").write_text("x = 1\n")
    assert "stray.py" in tacevo("replay", "run", cwd=tmp_path, status=2).stderr


def test_many_niches_of_a_user_are_placed(process: PartProcess) -> None:
    """As many as one entry of a store may hold; a configuration with more is refused."""
    text = "from dataclasses import dataclass\nimport numpy as np\nfrom tacevo.parts import Archive\n"
    text += "@dataclass(frozen=True)\nclass Many(Archive):\n    def centroids(self, niches, axes):\n"
    text += "        return np.random.Generator(np.random.Philox(1)).random((niches, axes)).tolist()\n"
    many = Recorded(kind=ARCHIVES, name="Many", module="many", attribute="Many", sources={"many.py": text})
    placed = process.ask(many, "archives.centroids", {"niches": 125_000, "axes": 2})
    assert isinstance(placed, list)
    assert placed[-1] == np.random.Generator(np.random.Philox(1)).random((125_000, 2))[-1].tolist()
    with refused(ConfigError, place="archive.niches", expected="at most 125000", got="125001"):
        compose(["experiment=demo", f"archive.kind={HONEST}:Rows", "archive.niches=125001"])


def test_constant_that_is_no_bool_is_refused(tmp_path: Path) -> None:
    """With its name."""
    (tmp_path / "rule.py").write_text(
        "from dataclasses import dataclass\nfrom tacevo.parts import Parents\n@dataclass(frozen=True)\n"
        "class Rule(Parents):\n    has_parents = 'yes'\n"
    )
    with refused(ConfigError, place="proposals.parents=Rule", got="has_parents"):
        compose(["experiment=demo", f"proposals.parents={tmp_path}/rule.py:Rule"])


def test_part_may_lie_in_a_namespace(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, process: PartProcess) -> None:
    """A directory without `__init__.py`, beside a file or as a package that others share, is imported by the rules."""
    (tmp_path / "lab/rules").mkdir(parents=True)
    (tmp_path / "lab/rules/few.py").write_text("SIZE = 2\n")
    (tmp_path / "lab/rules/mine.py").write_text(
        "from dataclasses import dataclass\nfrom lab.rules import few\nfrom tacevo.parts import Parents\n"
        "@dataclass(frozen=True)\nclass Rule(Parents):\n    def draw(self, pool, number, rng):\n"
        "        return pool[few.SIZE :][:number]\n"
    )
    (tmp_path / "beside.py").write_text((tmp_path / "lab/rules/mine.py").read_text())
    monkeypatch.syspath_prepend(tmp_path)
    packed = Part(kind=PARENTS, name="mine", module="lab.rules.mine", attribute="Rule", origin="lab 1.0")
    for found in (packed, find(PARENTS, f"{tmp_path}/beside.py:Rule")):
        sources = read_sources(found)
        assert "lab/rules/few.py" in sources
        rule = Recorded(kind=PARENTS, name="Rule", module=found.module, attribute="Rule", sources=sources)
        assert process.ask(rule, "parents.draw", GIVEN) == ["g00s02"]


def test_whoever_lacks_the_parts_replays_and_shows(recorded: Path, tmp_path: Path) -> None:
    """A run and its bundle; what decided is said, and with trust it decides again."""
    for name in ("run", "run.zip"):
        done = tacevo("replay", recorded / name, cwd=recorded)
        assert "proposals.parents=Greedy: " in done.stdout
        assert "--trust-parts" in done.stdout
    trusted = tacevo("replay", recorded / "run.zip", "--trust-parts", cwd=tmp_path)
    assert "as its recorded sources decide" in trusted.stdout
    tacevo("show", "run", cwd=recorded)
    tacevo("tables", "run", "--output", tmp_path / "tables", cwd=recorded)


def _members(bundle: Path) -> dict[str, bytes]:
    members = dict(members_of(bundle))
    del members["manifest-sha256.txt"]
    return members


def _edited(members: dict[str, bytes]) -> None:
    members["run/parts/Greedy/honest.py"] += b"# edited\n"


def _exchanged(members: dict[str, bytes]) -> None:
    members["run/parts/Greedy/honest.py"] = members["run/parts/Greedy/neighbour.py"]


def _dropped(members: dict[str, bytes]) -> None:
    del members["run/parts/Greedy/neighbour.py"]


def _more(members: dict[str, bytes]) -> None:
    members["run/parts/Greedy/other.py"] = b"x = 1\n"


def _another(members: dict[str, bytes]) -> None:
    members["run/parts/Other/other.py"] = b"x = 1\n"


@pytest.mark.parametrize("edit", [_edited, _exchanged, _dropped, _more, _another])
def test_bundle_whose_part_is_not_the_recorded_one_is_refused(
    recorded: Path, tmp_path: Path, edit: Callable[[dict[str, bytes]], None]
) -> None:
    """Also with a manifest that was written again, and with nothing of it run."""
    members = _members(recorded / "run.zip")
    edit(members)
    (tmp_path / "run.zip").write_bytes(sealed(members)[0])
    done = tacevo("replay", "run.zip", cwd=tmp_path, status=1)
    assert "refused: " in done.stderr


def test_bundle_holds_nothing_that_a_run_passes_over(recorded: Path, tmp_path: Path) -> None:
    """A directory of bytecode below a part is no member."""
    members = {**_members(recorded / "run.zip"), "run/parts/Greedy/__pycache__/other.py": b"x = 1\n"}
    zipped(honest(members), tmp_path / "run.zip")
    assert "__pycache__" in tacevo("replay", "run.zip", cwd=tmp_path, status=1).stderr


@pytest.mark.few(6)
@pytest.mark.parametrize("answer", [None, [], {}, "text", 5.5, [["g00s00"]], ["g99s99"], True])
@pytest.mark.parametrize("method", ["parents.draw", "parents.pool", "prompts.draw", "fitness.of"])
def test_decision_of_no_known_form_is_refused(recorded: Path, tmp_path: Path, answer: Json, method: str) -> None:
    """A store entry may hold anything under its question, with every checksum right."""
    members = dict(members_of(recorded / "run.zip"))
    entries = entries_of(members)
    for entry in entries:
        if entry["kind"] == "decisions" and entry["request"]["method"] == method:
            entry["answer"] = answer
    resealed(with_entries(members, entries), tmp_path / "run.zip")
    done = tacevo("replay", "run.zip", cwd=tmp_path, status=1)
    assert re.search("^(refused|different): ", done.stderr, re.MULTILINE)


def _link(path: Path) -> None:
    path.symlink_to(HONEST)


def _pipe(path: Path) -> None:
    os.mkfifo(path)


def _huge(path: Path) -> None:
    with path.open("wb") as file:
        file.truncate(50 * 10**9)  # which takes no place on the disk


def _loop(path: Path) -> None:
    path.symlink_to(path.parent)


@pytest.mark.parametrize("lay", [_link, _pipe, _huge, _loop])
def test_what_is_no_file_of_sources_is_never_read(recorded: Path, tmp_path: Path, lay: Callable[[Path], None]) -> None:
    """Below `parts/` of a run, in place of a source or beside the sources: it is another part than what decided.

    What Python compiled there changes nothing.
    """
    shutil.copytree(recorded / "run", tmp_path / "run")
    asked = "replay", "run", "--store", str(recorded / "cache")
    sources = tmp_path / "run/parts/Greedy"
    (sources / "__pycache__").mkdir()
    lay(sources / "__pycache__" / "honest.pyc")
    assert "EQUAL: " in tacevo(*asked, cwd=tmp_path).stdout
    (sources / "deep").mkdir()
    lay(sources / "deep" / "other")
    refusal = tacevo(*asked, cwd=tmp_path, status=2).stderr
    assert re.search("they were edited; .*deep/other", refusal), refusal
    (sources / "deep" / "other").unlink()
    (sources / "honest.py").unlink()
    lay(sources / "honest.py")
    assert "they were edited" in tacevo(*asked, cwd=tmp_path, status=2).stderr


def test_link_in_place_of_the_sources_is_not_followed(recorded: Path, tmp_path: Path) -> None:
    """Not even to the very sources that decided."""
    shutil.copytree(recorded / "run", tmp_path / "run")
    sources = tmp_path / "run/parts/Greedy"
    sources.rename(tmp_path / "elsewhere")
    sources.symlink_to(tmp_path / "elsewhere")
    refusal = tacevo("replay", "run", "--store", recorded / "cache", cwd=tmp_path, status=2)
    assert "they were edited" in refusal.stderr


@pytest.mark.parametrize(("name", "mode"), [("big.py", 0o100644), ("link.py", 0o120777), ("pipe.py", 0o010644)])
def test_bundle_brings_no_link_pipe_or_huge_file(recorded: Path, tmp_path: Path, name: str, mode: int) -> None:
    """Beside the sources of a part, in a zip that says so of a member; nothing is laid down."""
    shutil.copy(recorded / "run.zip", tmp_path)
    with zipfile.ZipFile(tmp_path / "run.zip", "a", zipfile.ZIP_DEFLATED) as bundle:
        member = zipfile.ZipInfo(f"run/parts/Greedy/{name}")
        member.external_attr, member.compress_type = mode << 16, zipfile.ZIP_DEFLATED
        bundle.writestr(member, b"/etc/passwd" if name != "big.py" else bytes(300_000_000))
    assert "refused: " in tacevo("replay", "run.zip", cwd=tmp_path, status=1).stderr


def test_run_goes_on_only_with_the_part_that_began_it(recorded: Path, tmp_path: Path) -> None:
    """The same command finds the run; with an edited part it is another one. A stranger's run asks for trust."""
    for name in ("run", "cache"):
        shutil.copytree(recorded / name, tmp_path / name)
    shutil.copytree(recorded / "lost", tmp_path / "parts")
    tacevo("search", *SIZES, *CHOSEN, cwd=tmp_path)
    neighbour = tmp_path / "parts/neighbour.py"
    neighbour.write_text(neighbour.read_text() + "# later\n")
    other = tacevo("search", *SIZES, *CHOSEN, cwd=tmp_path, status=2)
    assert "another run" in other.stderr
    longer = ["search.generations=3", "run.dir=longer", UNTRACKED, "store.root=cache"]
    refusal = tacevo("extend", recorded / "run.zip", *longer, cwd=tmp_path, status=2)
    assert "--trust-parts" in refusal.stderr
    tacevo("extend", recorded / "run.zip", "--trust-parts", *longer, cwd=tmp_path)


@pytest.mark.parametrize(
    ("setting", "place", "expected", "got"),
    [
        ("parts.Greedy.k=two", "parts.Greedy.k", "an integer", '"two"'),
        ("parts.Greedy.margin=true", "parts.Greedy.margin", "a number", "true"),
        ("parts.Greedy.kk=2", "parts.Greedy.kk", "", "not a setting"),
        ("parts.Gredy.k=2", "parts.Gredy", "", "nothing chooses"),
        ("parts=3", "parts", "parts.NAME.SETTING=VALUE", "parts=3"),
        ("code.Greedy.sha256=0", "", "KEY=VALUE", "code"),
        ("proposals.parents={file}:Gredy", "proposals.parents=Gredy", "", "did you mean Greedy"),
    ],
)
def test_settings_of_a_part_are_checked(setting: str, place: str, expected: str, got: str) -> None:
    """By their types, when a search is composed."""
    with refused(ConfigError, place=place, expected=expected, got=got):
        compose(["experiment=demo", f"proposals.parents={HONEST}:Greedy", setting.format(file=HONEST)])


def test_settings_of_a_part_stand_in_the_file_of_an_arm(tmp_path: Path) -> None:
    """It is laid over what was chosen, as all settings of an arm; a misspelt one is refused by its name."""
    (tmp_path / "ablation").mkdir()
    arm = tmp_path / "ablation/mine.yaml"
    arm.write_text(f"proposals:\n  parents: {HONEST}:Greedy\nparts:\n  Greedy:\n    k: 4\n")
    with reading_own(str(tmp_path)):
        for given in ([], ["parts.Greedy.margin=0.5"]):
            config = compose(["experiment=demo", "ablation=mine", *given])
            assert config.parts["Greedy"] == {"k": 4, "margin": 0.5 if given else 0.0}
        arm.write_text(arm.read_text().replace("k: 4", "kk: 4"))
        with refused(ConfigError, place="parts.Greedy.kk", got="not a setting"):
            compose(["experiment=demo", "ablation=mine"])


def test_default_of_a_part_is_data(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing in it is resolved: a secret of the environment would stand in the run."""
    monkeypatch.setenv("SECRET", "sk-very-secret")
    head = "from dataclasses import dataclass, field\nfrom tacevo import parts\n\n@dataclass(frozen=True)\n"
    body = "class Rule(parts.Parents):\n    note: str = '${oc.env:SECRET}'\n    k: int = field(default_factory=int)\n"
    (tmp_path / "rule.py").write_text(f"{head}{body}")
    config = compose(["experiment=demo", f"proposals.parents={tmp_path}/rule.py:Rule"])
    assert config.parts == {"Rule": {"note": "${oc.env:SECRET}", "k": 0}}


@pytest.mark.parametrize("name", ["random.py", "json.py", "numpy.py", "a-b.py", "a.v2.py"])
def test_file_that_python_could_take_for_another_is_refused(tmp_path: Path, name: str) -> None:
    """Or could not import by its name."""
    (tmp_path / name).write_text("x = 1\n")
    with refused(ConfigError, place="proposals.parents", expected="name"):
        compose(["experiment=demo", f"proposals.parents={tmp_path}/{name}:Rule"])


@pytest.mark.parametrize("answer", ["'0.5'", "True", "1.0", "None", "[0]"])
def test_answer_of_another_type_is_no_decision(process: PartProcess, answer: str) -> None:
    """It is refused, and not made to fit."""
    text = "from dataclasses import dataclass\nfrom tacevo.parts import Prompts\n@dataclass(frozen=True)\n"
    text += f"class Rule(Prompts):\n    def draw(self, history, pool, rng):\n        return {answer}\n"
    rule = Recorded(kind=PROMPTS, name="Rule", module="rule", attribute="Rule", sources={"rule.py": text})
    with pytest.raises(PartError):
        process.ask(rule, "prompts.draw", {"trials": [], "changes": {}, "pool": [0, 1], "rng": [1, 2]})


@pytest.mark.skipif("avx512f" not in Path("/proc/cpuinfo").read_text(), reason="this CPU has no AVX-512")
def test_numpy_computes_alike_on_cpus_with_and_without_avx512(process: PartProcess) -> None:
    """A deciding process uses none of these instructions, in which sums and functions have other last bits."""
    used = part(
        "known = np._core._multiarray_umath\n"
        "raise ValueError([name for name in known.__cpu_dispatch__ if known.__cpu_features__[name]])"
    )
    with pytest.raises(PartError) as caught:
        process.ask(used, "parents.draw", GIVEN)
    assert re.search("AVX2|X86_V3", caught.value.got)
    assert not re.search("AVX512|X86_V4", caught.value.got)


def test_part_has_all_of_numpy(process: PartProcess) -> None:
    """Also what NumPy imports when it is first needed."""
    rule = part("return [pool[int(np.median([0, 1, 1]) + len(np.unique([1, 1])) + abs(np.fft.fft([0])[0]))]]")
    assert process.ask(rule, "parents.draw", GIVEN) == ["g00s02"]


def test_file_that_only_a_record_names_is_not_loaded(recorded: Path, tmp_path: Path) -> None:
    """A run may be a stranger's, and name a file that lies where its reader stands."""
    shutil.copytree(recorded / "run", tmp_path / "run")
    (tmp_path / "evil.py").write_text("open('ran', 'w').close()\n")
    file = tmp_path / "run/run.json"
    record = json.loads(file.read_text())
    record["config"]["data"]["source"] = "evil.py:Source"
    record["config"]["executor"]["kind"] = "evil.py:Executor"
    record["config"]["tracking"]["kind"] = "evil.py:Tracker"
    file.write_text(json.dumps(record))
    for command in ("report run", "figures run", "study run elites=1 seeds=2", "noise run", "show run", "tables run"):
        done = subprocess.run(
            [sys.executable, "-m", "tacevo", *command.split()],
            cwd=tmp_path,
            capture_output=True,
            text=True,
            check=False,
        )
        assert "Traceback" not in done.stderr
        assert not (tmp_path / "ran").exists(), command


def test_settings_of_a_part_are_part_of_the_run() -> None:
    """Defaults as well as what is set; those of an installed part that is not chosen have no effect."""
    config = compose(["experiment=demo", f"proposals.parents={HONEST}:Greedy", "parts.Greedy.margin=1"])
    assert config.parts == {"Greedy": {"k": 2, "margin": 1.0}}
    assert compose(["experiment=demo"]).parts == {}


def test_name_of_ours_is_never_another_part() -> None:
    """Whatever a package offers."""
    assert find(PARENTS, "uniform").is_ours
    rule = replace(part("return [pool[0]]"), name="uniform")
    assert rule.place == "proposals.parents=uniform"


def test_bundle_names_no_place_of_the_machine(recorded: Path) -> None:
    """Of a part in a file the run has the name of its class."""
    with zipfile.ZipFile(recorded / "run.zip") as bundle:
        assert not [name for name in bundle.namelist() if str(recorded).encode() in bundle.read(name)]
    run = json.loads((recorded / "run/run.json").read_text())
    assert run["config"]["proposals"]["parents"] == "Greedy"
