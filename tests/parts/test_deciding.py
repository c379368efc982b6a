"""A part that decides is recorded and confined: whatever it does, a decision follows from what it was given."""

import json
import re
import shutil
import subprocess
import sys
import zipfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from bundles import entries_of, members_of, resealed, with_entries
from checkout import ROOT
from commands import publish, tacevo
from refusals import refused
from smallest import PUBLISHED_SIZES, SMALLEST, UNTRACKED, Once

from tacevo.bundles.format import sealed
from tacevo.config.compose import compose
from tacevo.errors import ConfigError, PartError
from tacevo.parts.kinds import PARENTS, PROMPTS
from tacevo.parts.registry import find
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
        ("return [pool[int(statistics.random.random() * 4)]]", "for the same"),
        ("import time\nreturn [pool[0]]", "may not import time"),
        ("__import__('os').getpid()", "may not import os"),
        ("return [pool[np.random.randint(4)]]", "for the same"),
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
    ],
)
def test_fault_of_a_part_names_it_and_is_no_decision(process: PartProcess, body: str, fault: str) -> None:
    """A clock, a generator of its own, an endless loop, a file, a socket, a program, a process that is not its own."""
    with pytest.raises(PartError) as caught:
        process.ask(part(body, head="import statistics"), "parents.draw", GIVEN)
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
    ],
)
def test_part_is_read_without_being_run(tmp_path: Path, text: str, expected: str) -> None:
    """What it may not import is refused with its line; its module has no effect here."""
    file = tmp_path / "rule.py"
    file.write_text(f"open({str(tmp_path / 'ran')!r}, 'w')\n{text}\n")
    with refused(ConfigError, place="proposals.parents=Rule, rule.py", expected=expected):
        read_sources(find(PARENTS, f"{file}:Rule"))
    assert not (tmp_path / "ran").exists()


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
    niches = json.loads((recorded / "run/archive.json").read_text())["elites"]
    assert {tuple(elite["centroid"]) for elite in niches} <= {((niche + 0.5) / 5,) * 2 for niche in range(5)}
    assert {path.name for path in (recorded / "run/parts").rglob("*.py")} == {"honest.py", "neighbour.py"}


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
    ],
)
def test_settings_of_a_part_are_checked(setting: str, place: str, expected: str, got: str) -> None:
    """By their types, when a search is composed."""
    with refused(ConfigError, place=place, expected=expected, got=got):
        compose(["experiment=demo", f"proposals.parents={HONEST}:Greedy", setting])


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
