"""The mirror shows a run's ledger in MLflow, writes nothing twice, and never harms the search.

The mirror works in this process where a test is about what it writes, and as a process of its own where the test
is about the process. MLflow is imported only when a test runs, because its telemetry stays off then.
"""

import contextlib
import io
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from hypothesis import given
from hypothesis import strategies as st
from mirrored import (
    BASELINE,
    ENTRIES,
    GENERATION,
    HEADER,
    INSTRUCTIONS,
    MUTATION,
    REJECTED,
    SECOND_GENERATION,
    build_run,
    contents,
    mirror_once,
    open_store,
)

from tacevo.costs import Spending
from tacevo.records import Reason, Stage
from tacevo.redaction import Veil, without_password
from tacevo.search.archive import AddStatus
from tacevo.search.lines import Line, RepairedAnswer
from tacevo.storage.ledger import sealed_text
from tacevo.storage.run_directory import RunDirectory
from tacevo.tracking.entries import (
    LONGEST_PARAM,
    Measure,
    candidate_measures,
    candidate_params,
    config_params,
    cost_measures,
    generation_measures,
    shorten,
)
from tacevo.tracking.process import URI_VARIABLE, Mirror

if TYPE_CHECKING:
    pass

# MLflow uses a loader option of SQLAlchemy that its newest version deprecates.
pytestmark = pytest.mark.filterwarnings("ignore:The ``noload`` loader strategy is deprecated")

#: Seconds after which a process is taken for stuck; the mirror has a low priority, and machines are busy.
PATIENCE = 300


@pytest.fixture
def run_dir(tmp_path: Path) -> Path:
    """Give a finished run."""
    build_run(tmp_path / "run", ENTRIES)
    return tmp_path / "run"


def wait_until(holds: Callable[[], bool]) -> None:
    """Wait until something holds, but not for ever."""
    deadline = time.monotonic() + PATIENCE
    while not holds():
        assert time.monotonic() < deadline, f"it did not come about within {PATIENCE} s"
        time.sleep(0.2)


def test_baseline_has_neither_parents_nor_instruction() -> None:
    """What does not apply to a candidate is no param."""
    assert candidate_params(BASELINE, INSTRUCTIONS) == {"operator": "baseline", "generation": "0", "slot": "0"}


def test_mutation_names_its_instruction() -> None:
    """A mutation's params hold the instruction's id and text, the parent and the request's temperature."""
    assert candidate_params(MUTATION, INSTRUCTIONS) == {
        "operator": "mutation",
        "generation": "0",
        "slot": "1",
        "temperature": "0.625",
        "parents": "g00s00",
        "instruction": "gelu",
        "instruction_text": "ReLU to GELU.",
    }


def test_rejected_crossover_says_where_and_why() -> None:
    """A crossover has both parents and no instruction of the library; a rejection its stage and reason."""
    params = candidate_params(REJECTED, INSTRUCTIONS)
    assert (params["parents"], params["instruction"]) == ("g00s00,g00s01", "crossover")
    assert (params["stage"], params["reason"]) == ("policy", "forbidden_import")
    assert "instruction_text" not in params
    assert candidate_measures(REJECTED) == ()


def test_losses_are_steps_from_epoch_one() -> None:
    """Each epoch's loss is a step of its metric."""
    measures = candidate_measures(BASELINE)
    assert [m for m in measures if m.key == "validation_loss"] == [
        Measure(key="validation_loss", value=0.5, step=1),
        Measure(key="validation_loss", value=0.25, step=2),
    ]


@pytest.mark.parametrize(("status", "inserted"), [("new", 1.0), ("improved", 1.0), ("rejected", 0.0)])
def test_inserted_tells_whether_the_archive_took_it(status: str, inserted: float) -> None:
    """A new niche and an improved one both count as an insertion."""
    measures = candidate_measures(replace(BASELINE, status=AddStatus(status)))
    assert Measure(key="inserted", value=inserted, step=0) in measures


def test_generation_without_trained_candidates_leaves_their_figures_out() -> None:
    """A generation's metrics are at its own step, and what is null is no metric."""
    measures = generation_measures(SECOND_GENERATION)
    assert {measure.step for measure in measures} == {1}
    assert {measure.key for measure in measures} == {
        "best",
        "coverage",
        "qd_score",
        "prompt_coverage",
        "candidates",
        "trained",
        "temperature",
    }


def test_config_is_flattened() -> None:
    """A param's name is the key as the user writes it; lists and null are JSON."""
    config = {"seed": 0, "llm": {"model": "m", "base_url": None}, "data": {"target_columns": ["fx", "fy"]}}
    assert config_params(config) == {
        "seed": "0",
        "llm.model": "m",
        "llm.base_url": "null",
        "data.target_columns": '["fx", "fy"]',
    }


@pytest.mark.parametrize(
    ("uri", "shown"),
    [
        ("postgresql://user:pw@host/db", "postgresql://***@host/db"),
        ("postgresql://user:p@w/o?rd@host:5432/db", "postgresql://***@host:5432/db"),
        ("https://token@host/mlflow", "https://***@host/mlflow"),
        ("postgresql://host/db?user=u&password=pw", "postgresql://host/db?***"),
        ("postgresql:///db?user=u&password=pw", "postgresql:///db?***"),
        ("sqlite+pysqlcipher://:pw@/file.db", "sqlite+pysqlcipher://***@/file.db"),
        ("http://localhost:5000", "http://localhost:5000"),
        ("sqlite:///mlflow.db", "sqlite:///mlflow.db"),
        ("sqlite:////home/me@work/mlflow.db?timeout=9", "sqlite:////home/me@work/mlflow.db?timeout=9"),
        ("file:///home/me@work/mlruns", "file:///home/me@work/mlruns"),
        ("/home/me@work/mlruns", "/home/me@work/mlruns"),
        ("", ""),
    ],
)
def test_password_of_a_uri_is_hidden(uri: str, shown: str) -> None:
    """User info and query are replaced, however carelessly they were written; a plain path is left alone."""
    assert without_password(uri) == shown
    assert without_password(shown) == shown


@given(st.text(), st.text())
def test_no_part_of_the_user_info_is_shown(user_info: str, place: str) -> None:
    """Whatever stands before the last @ of a URI makes no difference to what is shown of it."""
    assert without_password(f"postgresql://{user_info}@{place}") == without_password(f"postgresql://u@{place}")


def test_params_hold_no_password() -> None:
    """Every setting that is a URI is shown without its secrets."""
    config = {"tracking": {"uri": "postgresql://user:pw@host/db"}, "llm": {"base_url": "https://key@proxy/v1"}}
    assert config_params(config) == {
        "tracking.uri": "postgresql://***@host/db",
        "llm.base_url": "https://***@proxy/v1",
    }


@pytest.mark.parametrize(
    "message",
    [
        "no connection to postgresql://user:s%40crt@host/db?key=s3cret",
        "no connection to postgresql://user:s@crt@host/db?key=s3cret",
        "user:s%40crt was refused",
        "password s@crt was refused",
        "options key=s3cret",
    ],
)
def test_veil_hides_the_secrets_of_its_uri(message: str) -> None:
    """A library that writes the URI, or one secret of it, escaped or not, writes asterisks."""
    stream = io.StringIO()
    veil = Veil(stream, "postgresql://user:s%40crt@host/db?key=s3cret")
    assert veil.write(message) == len(message)
    assert "***" in stream.getvalue()
    assert "crt" not in stream.getvalue()
    assert "s3cret" not in stream.getvalue()


def test_veil_of_a_uri_without_secrets_changes_nothing() -> None:
    """A plain path stays readable in the log."""
    stream = io.StringIO()
    Veil(stream, "sqlite:////home/me@work/mlflow.db").write("no sqlite:////home/me@work/mlflow.db")
    assert stream.getvalue() == "no sqlite:////home/me@work/mlflow.db"


@given(st.text(max_size=3 * LONGEST_PARAM))
def test_shortened_text_fits_and_shows_that_it_was_cut(text: str) -> None:
    """A text that fits stays; a longer one is cut to fit and ends in an ellipsis."""
    short = shorten(text)
    assert len(short) <= LONGEST_PARAM
    assert short == text or (short.endswith("…") and text.startswith(short[:-1]) and len(text) > LONGEST_PARAM)


def test_search_is_one_run_with_one_nested_run_a_candidate(run_dir: Path, uri: str) -> None:
    """The parent run carries the configuration and the generations, its children the candidates."""
    mirror_once(run_dir, uri)
    said = contents(uri)
    assert set(said) == {"parent", "g00s00", "g00s01", "g00s02"}
    name, status, params, _, histories, _ = said["parent"]
    assert (name, status, params["llm.model"]) == ("run", "FINISHED", "m")
    assert histories["temperature"] == [(0, 0.6), (1, 0.65)]
    assert histories["generation_best"] == [(0, 0.25)]
    assert histories["candidates"] == [(0, 3.0), (1, 0.0)]


def test_trained_candidate_keeps_losses_figures_and_source(run_dir: Path, uri: str) -> None:
    """A trained candidate's run is finished and holds its metrics and its source as an artifact."""
    mirror_once(run_dir, uri)
    name, status, _, _, histories, files = contents(uri)["g00s00"]
    assert (name, status, files) == ("g00s00", "FINISHED", ["g00s00.py"])
    assert histories["train_loss"] == [(1, 0.75), (2, 0.5)]
    assert histories["fitness"] == [(0, 0.25)]
    assert histories["niche"] == [(0, 4.0)]


def test_artifacts_lie_beside_the_database(run_dir: Path, uri: str, tmp_path: Path) -> None:
    """A SQLite store keeps the sources in mlartifacts, in the folder of its database."""
    mirror_once(run_dir, uri)
    files = sorted((tmp_path / "mlartifacts").rglob("*.py"))
    assert sorted(file.read_text(encoding="utf-8") for file in files) == ["# g00s00\n", "# g00s01\n"]


def test_rejected_candidate_is_a_failed_run(run_dir: Path, uri: str) -> None:
    """A rejected candidate's run failed, and has neither metrics nor a source."""
    mirror_once(run_dir, uri)
    _, status, params, _, histories, files = contents(uri)["g00s02"]
    assert (status, params["reason"], histories, files) == ("FAILED", "forbidden_import", {}, [])


def test_finished_search_carries_its_digest(tmp_path: Path, uri: str) -> None:
    """The digest is a tag of the parent run."""
    digest = build_run(tmp_path / "run", ENTRIES)
    mirror_once(tmp_path / "run", uri)
    assert contents(uri)["parent"][3]["tacevo.digest"] == digest


def test_mirroring_twice_changes_nothing(run_dir: Path, uri: str) -> None:
    """A second mirror finds everything there."""
    mirror_once(run_dir, uri)
    first = contents(uri)
    mirror_once(run_dir, uri)
    assert contents(uri) == first


@pytest.mark.parametrize("length", range(1, len(ENTRIES)))
def test_interrupted_search_is_completed(
    length: int, run_dir: Path, uri: str, tmp_path: Path, empty_store: Path
) -> None:
    """Mirrored after any line, and again at the end, a search reads as if it had been mirrored once."""
    mirror_once(run_dir, uri)
    other = f"sqlite:///{shutil.copy(empty_store, tmp_path / 'other.db')}"
    interrupted = tmp_path / "interrupted" / run_dir.name
    build_run(interrupted, ENTRIES[:length], whole=False)
    mirror_once(interrupted, other)
    _, status, _, tags, _, _ = contents(other)["parent"]
    assert (status, "tacevo.digest" in tags) == ("KILLED", False)
    build_run(interrupted, ENTRIES)
    mirror_once(interrupted, other)
    assert contents(other) == contents(uri)


def test_candidate_left_unfinished_is_replaced(run_dir: Path, uri: str) -> None:
    """A mirror that was killed within a candidate leaves a running run; the next mirror writes it anew."""
    mirror_once(run_dir, uri)
    whole = contents(uri)
    client, _, nested = open_store(uri)
    client.update_run(nested["g00s00"].info.run_id, status="RUNNING")
    mirror_once(run_dir, uri)
    assert contents(uri) == whole
    assert open_store(uri)[2]["g00s00"].info.run_id != nested["g00s00"].info.run_id


OTHERS: dict[str, list[Line]] = {
    "candidate": [HEADER, BASELINE, replace(MUTATION, fitness=0.125), *ENTRIES[3:]],
    "generation": [*ENTRIES[:4], replace(GENERATION, coverage=0.5), SECOND_GENERATION],
    "fewer candidates": [HEADER, BASELINE, GENERATION],
    "nothing yet": [HEADER],
}


@pytest.mark.parametrize("other", OTHERS.values(), ids=OTHERS.keys())
def test_search_begun_anew_in_its_folder_is_not_mixed_with_the_former(
    other: list[Line], run_dir: Path, uri: str, tmp_path: Path, empty_store: Path
) -> None:
    """Of the same settings, name and id, but another ledger: what MLflow shows is this one's alone."""
    mirror_once(run_dir, uri)
    _, former, _ = open_store(uri)
    for path in (run_dir / "ledger.jsonl", run_dir / "run.json"):
        path.unlink()
    build_run(run_dir, other)
    mirror_once(run_dir, uri)
    fresh = f"sqlite:///{shutil.copy(empty_store, tmp_path / 'fresh.db')}"
    mirror_once(run_dir, fresh)
    assert contents(uri) == contents(fresh)
    assert open_store(uri)[1].info.run_id != former.info.run_id


def test_equal_searches_in_two_folders_are_two_runs(run_dir: Path, uri: str, tmp_path: Path) -> None:
    """Two users run one command against one server: neither takes away what the other is writing."""
    mirror_once(run_dir, uri)
    client, parent, nested = open_store(uri)
    client.update_run(nested["g00s00"].info.run_id, status="RUNNING")
    build_run(tmp_path / "elsewhere" / run_dir.name, ENTRIES)
    mirror_once(tmp_path / "elsewhere" / run_dir.name, uri)
    searches = client.search_runs([parent.info.experiment_id], "tags.`tacevo.digest` LIKE '%'")
    assert len(searches) == 2
    assert len({run.data.tags["tacevo.digest"] for run in searches}) == 1
    assert client.get_run(nested["g00s00"].info.run_id).info.lifecycle_stage == "active"


def test_renamed_folder_is_the_same_run(run_dir: Path, uri: str) -> None:
    """Its id goes with it."""
    mirror_once(run_dir, uri)
    first = contents(uri)
    mirror_once(run_dir.rename(run_dir.with_name("renamed")), uri)
    assert contents(uri) == first


def test_tag_that_a_lost_answer_took_already_is_no_error(run_dir: Path, uri: str) -> None:
    """The client asks again, and the server has no such tag any more."""
    from tacevo.tracking.client import unlabel

    mirror_once(run_dir, uri)
    client, parent, _ = open_store(uri)
    for _ in range(2):
        unlabel(client, parent.info.run_id, "tacevo.digest")
    assert "tacevo.digest" not in contents(uri)["parent"][3]


def test_tag_of_a_run_that_is_gone_is_an_error(run_dir: Path, uri: str) -> None:
    """Only the missing tag is passed over."""
    from mlflow.exceptions import MlflowException

    from tacevo.tracking.client import unlabel

    mirror_once(run_dir, uri)
    client, parent, _ = open_store(uri)
    client.delete_run(parent.info.run_id)
    with pytest.raises(MlflowException, match="active"):
        unlabel(client, parent.info.run_id, "tacevo.digest")


def test_longer_run_loses_the_digest_of_the_shorter(tmp_path: Path, uri: str) -> None:
    """A finished run that is taken further, and killed, has no digest."""
    build_run(tmp_path / "run", ENTRIES[:-1])
    mirror_once(tmp_path / "run", uri)
    build_run(tmp_path / "run", ENTRIES, whole=False)
    mirror_once(tmp_path / "run", uri)
    _, status, _, tags, _, _ = contents(uri)["parent"]
    assert (status, "tacevo.digest" in tags) == ("KILLED", False)


def test_line_without_its_end_waits(tmp_path: Path) -> None:
    """A line is read only when it is whole, and then once."""
    from tacevo.tracking.mirror import follow

    path = tmp_path / "ledger.jsonl"
    text, digest = sealed_text([HEADER, GENERATION])
    path.write_text(text[:-9], encoding="utf-8")
    answers = iter([False, True])

    def finished() -> bool:
        last = next(answers)
        if last:
            path.write_text(text, encoding="utf-8")
        return last

    lines = list(follow(path, finished))
    assert [line for line, _ in lines] == [HEADER, GENERATION]
    assert lines[-1][1] == digest


def test_search_that_ended_before_its_first_line_is_no_run(tmp_path: Path, uri: str) -> None:
    """Nothing is written of a run without a ledger."""
    from mlflow import MlflowClient

    (tmp_path / "run").mkdir()
    mirror_once(tmp_path / "run", uri)
    assert MlflowClient(uri).get_experiment_by_name("tacevo") is None


def test_process_follows_a_growing_ledger(tmp_path: Path, uri: str) -> None:
    """The process writes lines as they come, and ends when it is told that no more will."""
    run_dir = tmp_path / "run"
    build_run(run_dir, ENTRIES[:2], whole=False)
    mirror = Mirror(run_dir, uri=uri, experiment="tacevo")
    mirror.start()
    wait_until(lambda: any((tmp_path / "mlartifacts").rglob("g00s00.py")))
    digest = build_run(run_dir, ENTRIES)
    assert mirror.finish(PATIENCE) is None
    said = contents(uri)
    assert set(said) == {"parent", "g00s00", "g00s01", "g00s02"}
    assert said["parent"][3]["tacevo.digest"] == digest
    assert (run_dir / "tracking.log").read_text(encoding="utf-8") == ""


def test_store_that_cannot_be_written_gives_a_warning(run_dir: Path) -> None:
    """A broken tracking URI is one line for the user, and no exception."""
    mirror = Mirror(run_dir, uri="nonsense://nowhere", experiment="tacevo")
    mirror.start()
    warning = mirror.finish(PATIENCE)
    assert warning is not None
    assert "nonsense://nowhere failed: " in warning
    assert "the run itself is not affected" in warning
    assert "\n" not in warning


@pytest.mark.parametrize("uri", ["nonsense://user:s3cret@nowhere", "postgresql://user:s3cret@nowhere/db?key=s3cret"])
def test_password_reaches_neither_log_nor_warning_nor_command_line(run_dir: Path, uri: str) -> None:
    """MLflow repeats a URI in its messages, and a command line is read by every user: the password is in neither."""
    mirror = Mirror(run_dir, uri=uri, experiment="tacevo")
    mirror.start()
    (command,) = wait_for_commands(run_dir)
    assert "s3cret" not in command
    warnings = [mirror.finish(0), mirror.finish(PATIENCE)]
    assert "goes on by itself" in str(warnings[0])
    assert " failed: " in str(warnings[1])
    assert "s3cret" not in str(warnings)
    log = (run_dir / "tracking.log").read_text(encoding="utf-8")
    assert "Traceback" in log
    assert "s3cret" not in log


def wait_for_commands(run_dir: Path) -> list[str]:
    """Wait until a mirror of a directory is at work; give the command lines of all of them."""
    found: list[str] = []

    def any_found() -> bool:
        for path in Path("/proc").glob("[0-9]*/cmdline"):
            with contextlib.suppress(OSError):  # it has ended meanwhile
                command = path.read_text(encoding="utf-8").split("\0")
                if "tacevo.tracking" in command and str(run_dir) in command:
                    found.append(" ".join(command))
        return bool(found)

    wait_until(any_found)
    return found


def test_database_is_whole_although_its_maker_was_killed(run_dir: Path, tmp_path: Path) -> None:
    """A mirror killed among MLflow's migrations leaves a hidden file, which the next one replaces."""
    command = [sys.executable, "-m", "tacevo.tracking", str(run_dir), "--experiment", "tacevo"]
    folders = [tmp_path / f"try{number}" for number in range(5)]
    folder = next((folder for folder in folders if left_half_made(command, folder)), None)
    assert folder is not None, "no mirror could be killed while it made its database"
    assert [path.name for path in folder.iterdir() if path.suffix == ".db"] == []
    subprocess.run(command, env=environment_of(folder), check=True, timeout=PATIENCE)
    assert contents(environment_of(folder)[URI_VARIABLE])["parent"][1] == "FINISHED"
    assert not list(folder.glob(".*"))


def environment_of(folder: Path) -> dict[str, str]:
    """Give the environment of a mirror whose database stands in a folder."""
    return {**os.environ, URI_VARIABLE: f"sqlite:///{folder}/mlflow.db"}


def left_half_made(command: list[str], folder: Path) -> bool:
    """Kill a mirror once its database has some tables; False where it was done with the making before it stood still.

    It is stopped first: what is seen of it then is still so when it is killed.
    """
    part = folder / ".mlflow.db.part"
    with subprocess.Popen(command, env=environment_of(folder)) as mirror:
        wait_until(lambda: size_of(part) > 60_000 or mirror.poll() is not None)
        mirror.send_signal(signal.SIGSTOP)
        if mirror.returncode is None:
            os.waitid(os.P_PID, mirror.pid, os.WSTOPPED | os.WEXITED | os.WNOWAIT)
        half_made = size_of(part) > 60_000
        mirror.kill()
    return half_made


def size_of(path: Path) -> int:
    """Give the size of a file in bytes; 0 where there is none."""
    try:
        return path.stat().st_size
    except FileNotFoundError:
        return 0


def test_process_without_a_uri_says_what_to_set(run_dir: Path) -> None:
    """The URI comes by the environment; without it the process says so and does nothing."""
    environment = {key: value for key, value in os.environ.items() if key != URI_VARIABLE}
    command = [sys.executable, "-m", "tacevo.tracking", str(run_dir), "--experiment", "tacevo"]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False, timeout=PATIENCE)
    assert done.returncode == 2
    assert "TACEVO_TRACKING_URI is not set" in done.stderr


def test_process_that_cannot_start_gives_a_warning(tmp_path: Path) -> None:
    """A folder that is not there is one line for the user, and no exception."""
    mirror = Mirror(tmp_path / "missing", uri="sqlite:///mlflow.db", experiment="tacevo")
    mirror.start()
    assert "No such file or directory" in str(mirror.finish(PATIENCE))


def test_slow_mirror_is_left_to_itself(run_dir: Path, uri: str) -> None:
    """A mirror that needs longer than it is given is told of, and goes on to its end."""
    mirror = Mirror(run_dir, uri=uri, experiment="tacevo")
    mirror.start()
    assert "goes on by itself" in str(mirror.finish(0))
    assert mirror.finish(PATIENCE) is None
    assert contents(uri)["parent"][1] == "FINISHED"


def test_cost_of_candidates_and_of_their_generation_reach_mlflow(run_dir: Path, uri: str) -> None:
    """What timings.jsonl says of each candidate is on its run, and the sum on the search's, at its generation."""
    for name, dollars in (("g00s01", 0.25), ("g00s02", 0.5)):
        RunDirectory(run_dir).add_timing(Spending(answers=1, input_tokens=10, usd=dollars), id=name)
    mirror_once(run_dir, uri)
    client, parent, nested = open_store(uri)
    assert nested["g00s01"].data.metrics["usd"] == 0.25
    assert "usd" not in nested["g00s00"].data.metrics
    (point,) = client.get_metric_history(parent.info.run_id, "usd")
    assert (point.step, point.value) == (0, 0.75)
    assert parent.data.metrics["input_tokens"] == 20


def test_cost_without_answers_or_price_is_absent() -> None:
    """Nothing is shown as a cost of zero that is none."""
    spent = Spending(answers=1, input_tokens=10, output_tokens=20, usd=0.5)
    assert cost_measures(spent, 3) == tuple(
        Measure(key=key, value=value, step=3)
        for key, value in (("answers", 1.0), ("input_tokens", 10.0), ("output_tokens", 20.0), ("usd", 0.5))
    )
    unpriced = cost_measures(Spending(answers=1, input_tokens=10, output_tokens=20, unpriced=1), 0)
    assert "usd" not in {measure.key for measure in unpriced}
    assert cost_measures(Spending(), 0) == ()


def test_repairs_are_shown_apart() -> None:
    """A repaired candidate says how often it was sent back, and a generation how many trained after that."""
    line = replace(MUTATION, repairs=(RepairedAnswer(answer="0", stage=Stage.probe, reason=Reason.bad_output),))
    assert candidate_params(line, INSTRUCTIONS)["repairs"] == "1"
    measures = {measure.key: measure.value for measure in generation_measures(replace(SECOND_GENERATION, repaired=2))}
    assert measures["repaired"] == 2
