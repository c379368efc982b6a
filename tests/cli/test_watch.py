"""Promise: `tacevo watch` follows a search as far as it goes, answers this machine alone, and writes nothing."""

import argparse
import http.client
import json
import queue
import shutil
import signal
import socket
import subprocess
import sys
import threading
import urllib.request
import webbrowser
from collections.abc import Iterator, Mapping
from pathlib import Path

import pytest
from refusals import refused
from sweeps import files_of

from analysis.runs.begun import load_begun
from tacevo.cli.app import main
from tacevo.cli.watch import LivePage, Server, _check_may_begin, _watch, opened_privately
from tacevo.errors import ConfigError, RunError
from tacevo.results.run import read_run


@pytest.fixture
def begun(published: Path, tmp_path: Path) -> Path:
    """Return a copy of a run, cut off after its first generation, as a killed search leaves it."""
    run = Path(shutil.copytree(published / "run", tmp_path / "run"))
    shutil.rmtree(run / "studies")
    described = json.loads((run / "run.json").read_text())
    (run / "run.json").write_text(json.dumps({**described, "digest": None}))
    lines = (run / "ledger.jsonl").read_text().splitlines(keepends=True)
    end = next(number for number, line in enumerate(lines, start=1) if '"kind":"generation"' in line)
    (run / "ledger.jsonl").write_text(
        "".join(lines[: end + 1]) + lines[end + 1][:20]
    )  # a line of the next, and a torn one
    return run


@pytest.fixture
def server(begun: Path) -> Iterator[Server]:
    """Serve that run."""
    with Server(LivePage(begun), 0) as serving:
        thread = threading.Thread(target=serving.serve_forever)
        thread.start()
        yield serving
        serving.shutdown()
        thread.join()


def ask(
    server: Server, path: str, method: str = "GET", headers: Mapping[str, str] | None = None
) -> tuple[int, bytes, str | None]:
    """Send a request; return status, body and version."""
    connection = http.client.HTTPConnection("127.0.0.1", server.server_port, timeout=60)
    connection.request(method, path, headers=dict(headers or {}))
    answer = connection.getresponse()
    found = answer.status, answer.read(), answer.headers["ETag"]
    connection.close()
    return found


def test_finished_run_is_read_as_begun(published: Path) -> None:
    """Archives that follow from the ledger are those that the search wrote."""
    found = load_begun(published / "run")
    assert found is not None
    assert found[0] == read_run(published / "run")


def test_begun_run_ends_with_its_last_whole_generation(begun: Path, published: Path) -> None:
    """What stands behind it is left out; before there is one, there is no run."""
    found = load_begun(begun)
    whole = read_run(published / "run")
    assert found is not None
    assert found[0].generations == whole.generations[:1]
    assert {line.generation for line in found[0].candidates} == {0}
    (begun / "ledger.jsonl").write_text("".join((begun / "ledger.jsonl").read_text().splitlines(keepends=True)[:2]))
    assert load_begun(begun) is None


def test_edited_ledger_is_refused(begun: Path) -> None:
    """A live page shows nothing that its search did not decide."""
    text = (begun / "ledger.jsonl").read_text()
    (begun / "ledger.jsonl").write_text(text.replace('"slot":0', '"slot":7', 1))
    with refused(RunError, expected="a line that matches its hash"):
        load_begun(begun)


def test_page_and_contents_are_served(server: Server) -> None:
    """The page may ask its own server, and nobody else; asked again, unchanged contents are not sent."""
    status, page, _ = ask(server, server.root)
    assert status == 200
    assert b"connect-src &#39;self&#39;" in page
    status, body, version = ask(server, f"{server.root}data")
    assert (status, json.loads(body)["live"]) == (200, True)
    assert version is not None
    assert ask(server, f"{server.root}data", headers={"If-None-Match": version})[:2] == (304, b"")


def test_page_follows_a_search_that_ends_and_begins_again(begun: Path, published: Path) -> None:
    """One generation, then all of them, then files that cannot be read, then all of them again."""
    page = LivePage(begun)
    first = page.now()
    assert [len(run.generations) for run in first.contents.runs] == [1]
    assert first.contents.state == "0 of 1 run finished, 0 at work."
    shutil.rmtree(begun)
    shutil.copytree(published / "run", begun)
    second = page.now()
    assert [len(run.generations) for run in second.contents.runs] == [2]
    assert len(second.contents.runs[0].studies) == 1
    assert second.contents.state == "1 of 1 run finished, 0 at work."
    text = (begun / "ledger.jsonl").read_text()
    (begun / "ledger.jsonl").write_text(text.replace('"slot":0', '"slot":7', 1))
    third = page.now()
    assert third.contents.state.startswith("This cannot be read now: ")
    assert [len(run.generations) for run in third.contents.runs] == [2]
    (begun / "ledger.jsonl").write_text(text)
    assert page.now().contents.state == "1 of 1 run finished, 0 at work."
    assert len({first.version, second.version, third.version}) == 3


def test_version_is_that_of_the_contents(begun: Path) -> None:
    """Lines of a generation that has not ended change files, and nothing that is shown."""
    page = LivePage(begun)
    before = page.now()
    with (begun / "ledger.jsonl").open("a") as ledger:
        ledger.write("torn")
    assert page.now() == before


def test_unchanged_files_are_not_read_again(begun: Path) -> None:
    """Nor are the contents written again: a large page is asked for every two seconds."""
    page = LivePage(begun)
    assert page.now() is page.now()


def test_run_that_is_not_begun_has_an_empty_page(tmp_path: Path) -> None:
    """`watch` may be given before `search`."""
    contents = LivePage(tmp_path / "later").now().contents
    assert (contents.runs, contents.state) == ((), "0 of 1 run finished, 0 at work.")


def test_directory_of_something_else_is_refused(place: Path) -> None:
    """A page of `conf` would wait for ever; a search that has just begun has no run.json, but a lock and a ledger."""
    Path("conf").mkdir()
    Path("conf/.lock").touch()
    Path("conf/ledger.jsonl").touch()
    _check_may_begin(Path("conf"))
    _check_may_begin(Path("absent"))
    Path("conf/config.yaml").touch()
    with refused(ConfigError, place="conf", expected="a run or a sweep", got="without run.json and sweep.json"):
        _watch(argparse.Namespace(run="conf", store=None, port=0))


def test_sweep_shows_what_is_begun_of_it(swept: Path, tmp_path: Path) -> None:
    """A job without a directory is waited for; the arms are compared as soon as jobs are finished."""
    sweep = Path(shutil.copytree(swept / "sweep", tmp_path / "sweep"))
    shutil.rmtree(sweep / "none-seed1")
    contents = LivePage(sweep).now().contents
    assert [run.name for run in contents.runs] == ["none-seed0", "fixed_temperature-seed0"]
    assert contents.sweep is not None
    assert contents.state == "2 of 3 runs finished, 0 at work."


def test_sweep_shows_its_runs_before_its_arms_can_be_compared(swept: Path, tmp_path: Path) -> None:
    """The reason stands beside how far they are."""
    sweep = Path(shutil.copytree(swept / "sweep", tmp_path / "sweep"))
    for job in sweep.glob("*/run.json"):
        job.write_text(json.dumps({**json.loads(job.read_text()), "digest": None}))
    contents = LivePage(sweep).now().contents
    assert (len(contents.runs), contents.sweep) == (3, None)
    assert contents.state.startswith("0 of 3 runs finished, 0 at work. The arms are not compared yet: ")
    assert "expected at least one finished job" in contents.state


def test_watching_writes_nothing(server: Server, begun: Path) -> None:
    """Every file stays as it was, and none is added."""
    before = files_of(begun.parent)
    for path in (server.root, f"{server.root}data"):
        assert ask(server, path)[0] == 200
    assert files_of(begun.parent) == before


@pytest.mark.parametrize(
    "path", ["/", "/data", "/x/", "ROOT../data", "ROOTrun.json", "ROOTdata?x=1", "/xROOT", "ROOT%2e"]
)
def test_other_addresses_are_not_found(path: str, server: Server) -> None:
    """Without the token, or beside the two things that are served, there is nothing."""
    assert ask(server, path.replace("ROOT", server.root))[0] == 404


@pytest.mark.parametrize("method", ["HEAD", "POST", "PUT", "DELETE", "PATCH", "OPTIONS", "CONNECT", "TRACE", "X"])
def test_other_methods_are_refused(method: str, server: Server) -> None:
    """There is no way to change anything."""
    assert ask(server, server.root, method)[0] == 405


@pytest.mark.parametrize(
    "host", ["evil.example", "evil.example:PORT", "127.0.0.1", "127.0.0.1:1", "localhost.evil:PORT", ""]
)
def test_foreign_name_of_this_machine_is_refused(host: str, server: Server) -> None:
    """A page from elsewhere whose name was pointed at 127.0.0.1 gets nothing, even with the token."""
    assert ask(server, server.root, headers={"Host": host.replace("PORT", str(server.server_port))})[0] == 404


def test_server_listens_on_loopback_under_a_new_token(server: Server, begun: Path) -> None:
    """No other machine reaches it, and an old address opens nothing."""
    assert server.server_address[0] == "127.0.0.1"
    with Server(LivePage(begun), 0) as other:
        assert other.root != server.root
    assert len(server.root) >= 32
    assert server.address == f"http://127.0.0.1:{server.server_port}{server.root}"


def test_browser_gets_an_address_without_the_token() -> None:
    """Its command line is seen by every user; the file that it opens by this user alone, and it is removed."""
    opened: queue.SimpleQueue[str] = queue.SimpleQueue()
    with opened_privately("http://127.0.0.1:1/token/", opened.put):
        address = opened.get(timeout=60)
        file = Path(address.removeprefix("file://"))
        assert "token" not in address
        assert 'url=http://127.0.0.1:1/token/"' in file.read_text()
        assert file.parent.stat().st_mode & 0o077 == 0
    assert not file.exists()


def test_replay_is_named_once_all_is_finished(begun: Path, published: Path, tmp_path: Path) -> None:
    """Before, it would fail; a name that a shell reads otherwise is quoted."""
    assert LivePage(begun).now().contents.commands == ()
    run = shutil.copytree(published / "run", tmp_path / "a; b")
    assert LivePage(run).now().contents.commands[0] == "tacevo replay 'a; b'"


@pytest.mark.parametrize("file", ["run.json", "ledger.jsonl"])
def test_what_the_system_refuses_is_said(file: str, begun: Path) -> None:
    """A file that is away or locked for a moment ends no answer."""
    page = LivePage(begun)
    page.now()
    (begun / file).unlink()
    (begun / file).mkdir()
    contents = page.now().contents
    assert contents.state.startswith("This cannot be read now: ")
    assert len(contents.runs) == 1


@pytest.mark.slow
def test_command_serves_until_it_is_interrupted(tmp_path: Path) -> None:
    """Its first line is the address, also of a search that is not begun; Ctrl-C ends it."""
    command = [sys.executable, "-m", "tacevo.cli.app", "watch", str(tmp_path / "later")]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as watch:
        assert watch.stdout is not None
        address = watch.stdout.readline().removeprefix("watch: ").strip()
        assert "does not exist yet; the page waits for it" in watch.stdout.readline()
        with urllib.request.urlopen(address, timeout=120) as page:
            assert page.status == 200
        watch.send_signal(signal.SIGINT)
        _, errors = watch.communicate(timeout=120)
    assert watch.returncode == 130
    assert errors == "\ninterrupted; the search was not touched\n"


def test_request_that_is_none_is_refused(tmp_path: Path) -> None:
    """The server answers the next one all the same."""
    with Server(LivePage(tmp_path / "later"), 0) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        with socket.create_connection(("127.0.0.1", server.server_port), timeout=60) as connection:
            connection.sendall(b"GET / HTTP/nonsense\r\n\r\n")
            assert b"400" in connection.recv(1_000)
        assert ask(server, server.root)[0] == 200
        server.shutdown()
        thread.join()


@pytest.mark.parametrize("port", ["-1", "65536"])
def test_port_that_none_has_is_refused(port: str, begun: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The range is named."""
    assert main(["watch", str(begun), f"--port={port}"]) == 2
    assert f"--port: expected 0 to 65535; got {port}" in capsys.readouterr().err


def test_bundle_is_refused(published: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """It does not change; `tacevo report` makes its page."""
    assert main(["watch", str(published / "run.zip")]) == 2
    assert "`tacevo report` makes the page of a bundle" in capsys.readouterr().err


def test_page_is_opened_where_that_is_wished(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """In the browser of the system, before the server answers."""
    opened: list[str] = []
    monkeypatch.setattr(webbrowser, "open", opened.append)
    monkeypatch.setattr(Server, "serve_forever", lambda _: None)
    assert main(["watch", str(tmp_path / "later"), "--open"]) == 0
    assert [address.partition(":")[0] for address in opened] == ["file"]
