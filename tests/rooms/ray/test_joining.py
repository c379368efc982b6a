"""What is asked of a node before it gets work, and how images come there; no Ray is started."""

import os
import pickle
import socket
import stat
import sys
import tempfile
from dataclasses import replace
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest
from refusals import refused

from tacevo.choices import Confinement, Device, Numerics
from tacevo.cluster import node_images as files
from tacevo.cluster.connection import check_head, import_ray, is_guarded, kept_environment
from tacevo.cluster.node import ClusterNode
from tacevo.cluster.node_images import Images
from tacevo.cluster.node_members import join, works
from tacevo.cluster.node_report import Facts, check_alike, facts_here
from tacevo.config.compose import compose
from tacevo.errors import ConfigError, DataError, SandboxError
from tacevo.parts.executor import Order
from tacevo.runs.wiring import check_means
from tacevo.sandbox.confinement import available
from tacevo.training.numerics import check_cpu, environment

ORDER = Order(
    entries={},
    equip=None,
    environment=environment(Numerics.portable, Device.cpu),
    numerics=Numerics.portable,
    device=Device.cpu,
    gpu=None,
    per_gpu=1,
    require=Confinement.process,
)

NODE = "node 0123abcd (10.0.0.7)"


@pytest.mark.parametrize("name", facts_here(ORDER).decisive)
def test_node_that_differs_is_refused_by_name(name: str) -> None:
    """The error names the node, what differs and both values; so does one that lacks it."""
    here = facts_here(ORDER)
    check_alike(here, here, NODE)
    rest = {key: value for key, value in here.decisive.items() if key != name}
    for other, got in (({**rest, name: "9.9"}, "9.9"), (rest, "absent")):
        with refused(SandboxError, place=NODE, got=f"{name} {got}", expected=f"{name} {here.decisive[name]}"):
            check_alike(replace(here, decisive=other), here, NODE)


def test_packages_rules_and_numerics_decide() -> None:
    """With fast numerics the model of the CPU does, too."""
    decisive, fast = (
        facts_here(order).decisive.keys()
        for order in (ORDER, replace(ORDER, numerics=Numerics.fast, environment=environment(Numerics.fast, Device.cpu)))
    )
    packages = {"python", "tacevo", "code", "torch", "numpy", "ATEN_CPU_CAPABILITY"}
    assert {*packages, "rules of training", "rules of probe", "rules of study"} <= decisive
    assert ("ATEN_CPU_CAPABILITY" in fast, fast - decisive) == (False, {"cpu"})


@pytest.mark.parametrize("name", ["ANTHROPIC_API_KEY", "ANTHROPIC_AUTH_TOKEN", "OPENAI_API_KEY", "MYSQL_PWD"])
def test_node_with_a_key_is_refused(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """The error names the variable, and not the key."""
    monkeypatch.setenv(name, "sk-secret")
    monkeypatch.setenv("RAY_AUTH_TOKEN", "f" * 64)  # which every node has
    facts = facts_here(ORDER)
    with refused(SandboxError, place=NODE, got=f"{name} in the environment", remedy="ray start"):
        check_alike(facts, facts_here(ORDER), NODE)
    assert "sk-secret" not in str(facts.fault)
    assert b"sk-secret" not in pickle.dumps(facts)


def test_node_that_cannot_confine_as_asked_is_refused() -> None:
    """`sandbox.require` holds on each node; a fault that a node found survives its way here."""
    fault = SandboxError("process", place="sandbox.require", expected="kernel", remedy="use another")
    facts = Facts(decisive={}, level=Confinement.process, fault=pickle.loads(pickle.dumps(fault)))
    with refused(
        SandboxError, place=f"{NODE}, sandbox.require", got="process", expected="kernel", remedy="use another"
    ):
        check_alike(facts, facts_here(ORDER), NODE)
    assert facts_here(ORDER).level == available()
    assert facts_here(replace(ORDER, device=Device.cuda, numerics=Numerics.fast)).level == Confinement.none


@pytest.mark.parametrize(("numerics", "lacks"), [(Numerics.portable, "avx2"), (Numerics.portable512, "avx512f")])
def test_node_whose_cpu_cannot_compute_so_is_refused(
    numerics: Numerics, lacks: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The error names the node, the numerics and the instructions that are missing."""
    ours = facts_here(ORDER)
    monkeypatch.setattr(
        "tacevo.cluster.node_report.check_machine", lambda kind, *_: check_cpu(kind, "x86_64", "flags\t\t: fpu avx\n")
    )
    facts = facts_here(replace(ORDER, numerics=numerics))
    with refused(SandboxError, place=f"{NODE}, numerics={numerics}", got=lacks, expected="an x86_64 CPU"):
        check_alike(facts, ours, NODE)


def test_started_ray_inherits_nothing_that_could_be_a_key(monkeypatch: pytest.MonkeyPatch) -> None:
    """What is not known to be harmless is hidden, and is there again afterwards; Ray's own token stays."""
    secrets = [
        "ANTHROPIC_API_KEY",
        "OPENAI_API_KEY",
        "MY_TOKEN",
        "AWS_SECRET_ACCESS_KEY",
        "http_proxy",
        "NVIDIA_API_KEY",
        "CUDA_TOKEN",
        "RAYCAST_API_KEY",
        "PYTHONANYWHERE_TOKEN",
        "MLFLOW_TRACKING_URI",
    ]
    for name in secrets:
        monkeypatch.setenv(name, "secret")
    monkeypatch.setenv("RAY_AUTH_TOKEN", "f" * 64)
    before = dict(os.environ)
    with kept_environment():
        assert "secret" not in os.environ.values()
        assert os.environ["PATH"] == before["PATH"]
        assert os.environ["RAY_AUTH_TOKEN"] == "f" * 64
    assert dict(os.environ) == before


def test_missing_ray_is_named_with_its_remedy(monkeypatch: pytest.MonkeyPatch) -> None:
    """Before anything is made; and a run on this machine needs no Ray."""
    monkeypatch.setitem(sys.modules, "ray", None)
    with refused(ConfigError, place="executor=ray", remedy="pip install -e '.[ray]'"):
        import_ray(None)
    with refused(ConfigError, place="executor=ray", remedy="pip install -e '.[ray]'"):
        check_means(compose(["executor=ray"]))
    check_means(compose([]))


@pytest.fixture
def no_token(monkeypatch: pytest.MonkeyPatch) -> None:
    """Take the user's token for Ray away, if there is one, and do not load Ray."""
    for name in ("RAY_AUTH_MODE", "RAY_AUTH_TOKEN"):
        monkeypatch.setenv(name, "")
        monkeypatch.delenv(name)
    monkeypatch.setitem(sys.modules, "ray", ModuleType("ray"))


@pytest.mark.usefixtures("no_token")
def test_ray_that_is_started_has_a_token(monkeypatch: pytest.MonkeyPatch) -> None:
    """One that cannot be guessed, unless the user has one; a user's cluster keeps its own way."""
    import_ray("10.0.0.7:6379")
    assert not is_guarded()
    import_ray(None)
    assert is_guarded()
    first = os.environ["RAY_AUTH_TOKEN"]
    assert len(bytes.fromhex(first)) == 32
    import_ray(None)
    assert os.environ["RAY_AUTH_TOKEN"] == first
    monkeypatch.delenv("RAY_AUTH_TOKEN")
    import_ray(None)
    assert os.environ["RAY_AUTH_TOKEN"] != first


class _TaskError(Exception):
    """Stands for Ray's error around that of a task."""

    def __init__(self, cause: Exception) -> None:
        super().__init__(str(cause))
        self.cause = cause


class _Actor:
    """Stands for the process of a node, whose methods answer what it was made for; it lacks images."""

    def __init__(self, answer: Any) -> None:
        self.received: Any = None
        self.look = SimpleNamespace(remote=lambda: answer)
        self.prepare = SimpleNamespace(remote=lambda: False)
        self.receive = SimpleNamespace(remote=self._receive)

    def _receive(self, chunks: Any) -> bool:
        self.received = b"".join(chunks)
        return True


class _Ray:
    """Stands for Ray with nodes of which each answers one thing; None is not an answer."""

    exceptions = SimpleNamespace(RayTaskError=_TaskError)

    def __init__(self, answers: dict[str, Any]) -> None:
        self._answers = iter(answers.values())
        self.killed = 0

    def remote(self, _: type[ClusterNode]) -> Any:
        """Return what starts the process of the next node."""
        started = SimpleNamespace(remote=lambda *_: _Actor(next(self._answers)))
        return SimpleNamespace(options=lambda **_: started)

    def get(self, answer: Any, timeout: float | None = None) -> Any:
        """Return an answer, or raise it; what never comes may be waited for only for a time."""
        if answer is None:
            assert timeout is not None
            raise TimeoutError
        if isinstance(answer, Exception):
            raise answer
        return answer

    def put(self, chunk: bytes) -> bytes:
        """Pass a part of a file on."""
        return chunk

    def kill(self, _: Any) -> None:
        """Count."""
        self.killed += 1


def test_node_that_hangs_or_is_lost_while_it_joins_may_try_again_and_holds_up_no_other() -> None:
    """One that finds a fault itself is refused for good."""
    fault = _TaskError(SandboxError("process", place="sandbox.require"))
    alike, hangs, lost, faulty = (digit * 56 for digit in "1234")
    answers = {alike: facts_here(ORDER), hangs: None, lost: OSError("connection reset"), faulty: fault}
    ray = _Ray(answers)
    nodes = [{"NodeID": name, "NodeManagerAddress": "10.0.0.7", "Resources": {"CPU": 1.0}} for name in answers]
    joined, refused_ = join(ray, nodes, ClusterNode, ORDER, None)
    assert list(joined) == [alike]
    assert {refusal.node: refusal.is_final for refusal in refused_} == {hangs: False, lost: False, faulty: True}
    assert ["TimeoutError" in str(refusal.error) for refusal in refused_] == [True, False, False]
    assert ray.killed == 3


def test_images_are_brought_to_a_node_that_lacks_them(tmp_path: Path) -> None:
    """Whole, and in parts; the node is asked for no more than it has."""
    images = describe(tmp_path, np.arange(3 * 16 * 16, dtype=np.uint8).reshape(1, 3, 16, 16))
    node = {"NodeID": "5" * 56, "NodeManagerAddress": "10.0.0.7", "Alive": True, "Resources": {"CPU": 2.0}}
    ray = _Ray({"one": facts_here(ORDER)})
    joined, refused_ = join(ray, [node], ClusterNode, ORDER, (images, tmp_path / "images.npy"))
    (member,) = joined.values()
    assert member.process.received == (tmp_path / "images.npy").read_bytes()
    assert (refused_, works(node), works({**node, "Alive": False})) == ([], True, False)
    assert [member.has({"CPU": cores, "GPU": gpus}) for cores, gpus in ((2, 0), (3, 0), (1, 1))] == [True, False, False]


@pytest.fixture
def temporary(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    """Return where a node keeps temporary files; it has no directory for images by name."""
    monkeypatch.delenv(files.DIRECTORY, raising=False)
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    return tmp_path


def test_default_directory_for_images_is_of_its_user_alone(temporary: Path) -> None:
    """It is made so; one that others may write to, or a link that another user made, is refused."""
    made = files.directory_here()
    assert stat.S_IMODE(made.stat().st_mode) == 0o700
    assert files.directory_here() == made
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv(files.DIRECTORY, str(temporary / "named"))
        assert files.directory_here() == temporary / "named"
    made.chmod(0o777)
    with refused(DataError, place=str(made), remedy=files.DIRECTORY):
        files.directory_here()
    made.rename(temporary / "elsewhere")
    made.symlink_to(temporary / "elsewhere")
    with refused(DataError, place=str(made), got="a link"):
        files.directory_here()


def describe(folder: Path, pixels: "np.ndarray[tuple[int, ...], np.dtype[np.uint8]]") -> Images:
    """Write images as a search has them, and describe them."""
    np.save(folder / "images.npy", pixels)
    return files.describe(folder / "images.npy")


def test_images_arrive_byte_for_byte_and_once(tmp_path: Path) -> None:
    """The file of a node is that of the search; a second run finds it and is sent nothing, unless a bit has flipped."""
    ours, node = tmp_path / "ours", tmp_path / "node"
    ours.mkdir()
    images = describe(ours, np.arange(3 * 16 * 16, dtype=np.uint8).reshape(1, 3, 16, 16))
    content = (ours / "images.npy").read_bytes()
    assert files.find(images, node) is None
    path = files.receive(images, node, [content[:100], content[100:]])
    assert path.read_bytes() == content
    assert files.find(images, node) == path
    assert files.receive(images, node, []) == path
    path.write_bytes(bytes([*content[:-1], content[-1] ^ 1]))
    assert files.find(images, node) is None
    assert files.receive(images, node, [content]).read_bytes() == content


@pytest.mark.parametrize("sent", [[], [b"other bytes"]])
def test_other_bytes_than_the_search_has_are_refused(sent: list[bytes], tmp_path: Path) -> None:
    """Nothing is mapped that is not what the search has."""
    images = describe(tmp_path, np.zeros((1, 3, 16, 16), np.uint8))
    with refused(DataError, place=str(tmp_path / "node"), got="other bytes"):
        files.receive(images, tmp_path / "node", sent)


@pytest.mark.parametrize("address", ["host", "host:0", "host:99999", "ray://host:10001"])
def test_address_of_another_form_is_refused_at_once(address: str) -> None:
    """Ray itself would wait for minutes, or ask for another of its packages."""
    with refused(ConfigError, place="executor.address", got=address, expected="HOST:PORT"):
        check_head(address)


def test_address_where_nothing_listens_is_refused() -> None:
    """A port that was just given back; one that listens is accepted, whatever it is."""
    check_head("auto")  # Ray finds it
    with socket.create_server(("127.0.0.1", 0)) as server:
        address = f"127.0.0.1:{server.getsockname()[1]}"
        check_head(address)
    with refused(ConfigError, place="executor.address", got=address, remedy="ray start --head"):
        check_means(compose(["executor=ray", f"executor.address={address}"]))


@pytest.mark.parametrize(("name", "value"), [("executor.address", "head:6379"), ("executor.per_gpu", "2")])
def test_settings_of_a_cluster_and_of_a_gpu_need_one(name: str, value: str) -> None:
    """Who forgets executor=ray would believe that the cluster is used."""
    with refused(ConfigError, place=name):
        compose([f"{name}={value}"])
