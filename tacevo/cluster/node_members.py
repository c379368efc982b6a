"""The start of a node that gets jobs: its process is started and checked, and the images are brought there."""

import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tacevo.choices import Confinement
from tacevo.cluster.node import ClusterNode
from tacevo.cluster.node_images import CHUNK, Images
from tacevo.cluster.node_report import check_alike, facts_here
from tacevo.cluster.slot import name_of
from tacevo.errors import SandboxError, TacevoError
from tacevo.parts.executor import Order
from tacevo.sandbox.protocol import describe

#: Seconds that a node's process may take to start and to say what it is, on a busy machine.
_START_SECONDS = 300.0

#: Bytes of images that a node takes in a second at least, on a busy network or a slow disk.
_SLOWEST = 1e6


@dataclass(frozen=True, eq=False, kw_only=True)
class ClusterMember:
    """A node that gets jobs."""

    #: The node's name, as people are told.
    name: str
    #: The node's resources by Ray's names: CPU, memory in bytes, GPU.
    resources: Mapping[str, float]
    level: Confinement
    #: The actor of `Node`.
    process: Any

    def has(self, needs: Mapping[str, float]) -> bool:
        """Tell whether the node has as much, free or not."""
        return all(self.resources.get(name, 0.0) >= amount for name, amount in needs.items())


@dataclass(frozen=True, eq=False, kw_only=True)
class Refusal:
    """The reason why a node gets no job."""

    #: Ray's id.
    node: str
    error: SandboxError
    #: False where Ray lost the node's process: another try may do.
    is_final: bool


#: The description of a node by `ray.nodes`.
Described = Mapping[str, Any]


def works(node: Described) -> bool:
    """Tell whether Ray runs tasks on a node; a head often has no CPU for them."""
    return bool(node["Alive"]) and node["Resources"].get("CPU", 0) >= 1


def join(
    ray: Any, nodes: Sequence[Described], process: type[ClusterNode], order: Order, images: tuple[Images, Path] | None
) -> tuple[dict[str, ClusterMember], list[Refusal]]:
    """Start, check and prepare nodes, all at once; a node that fails gets no job.

    Returns:
        Those that get jobs, by Ray's id of the node, and why the others are refused; the error's place is the node.
    """
    names = {node["NodeID"]: f"node {node['NodeID'][:8]} ({node['NodeManagerAddress']})" for node in nodes}
    described = None if images is None else images[0]
    processes = {node["NodeID"]: _placed(ray.remote(process), node).remote(order, described) for node in nodes}
    wanted = facts_here(order)
    refused: list[Refusal] = []
    patience = _START_SECONDS + (described.size / _SLOWEST if described else 0)

    def settled(method: str, of: Iterable[str], check: Callable[[Any, str], None], *arguments: Any) -> dict[str, Any]:
        """Call a method of several processes at once, and return the answers of those where all is well."""
        asked = {node: getattr(processes[node], method).remote(*arguments) for node in of}
        answers = {}
        deadline = time.monotonic() + patience
        for node, ref in asked.items():
            try:
                answers[node] = ray.get(ref, timeout=max(0.0, deadline - time.monotonic()))
                check(answers[node], names[node])
            except Exception as error:  # Ray's, or what the node raised
                answers.pop(node, None)
                refused.append(_refusal(ray, error, node, names[node]))
                ray.kill(processes[node])
        return answers

    looked = settled("look", processes, lambda facts, name: check_alike(facts, wanted, name))
    ready = settled("prepare", looked, lambda *_: None)
    missing = [node for node, has_images in ready.items() if not has_images]
    if missing and images is not None:
        chunks = [ray.put(chunk) for chunk in _chunks(images[1])]
        brought = settled("receive", missing, lambda *_: None, chunks)
        ready = {node: True for node in ready if node in brought or node not in missing}
    return {
        node["NodeID"]: ClusterMember(
            name=names[node["NodeID"]],
            resources=node["Resources"],
            level=looked[node["NodeID"]].level,
            process=processes[node["NodeID"]],
        )
        for node in nodes
        if node["NodeID"] in ready
    }, refused


def _placed(process: Any, node: Described) -> Any:
    """Have a process start on a node; it holds no slot, and takes a job of every slot at once."""
    from ray.util.scheduling_strategies import NodeAffinitySchedulingStrategy

    return process.options(
        name=name_of(node["NodeID"]),
        num_cpus=0,
        max_concurrency=int(node["Resources"]["CPU"]) + 1,
        max_restarts=-1,
        scheduling_strategy=NodeAffinitySchedulingStrategy(node["NodeID"], soft=False),
    )


def _chunks(path: Path) -> Iterator[bytes]:
    with path.open("rb") as file:
        while chunk := file.read(CHUNK):
            yield chunk


def _refusal(ray: Any, error: Exception, node: str, name: str) -> Refusal:
    """Say of a node why it gets no job."""
    cause: BaseException = error
    while isinstance(cause, ray.exceptions.RayTaskError):
        cause = cause.cause
    if isinstance(cause, TacevoError):
        place = cause.place if cause.place.startswith(name) else f"{name}, {cause.place}".rstrip(", ")
        own = SandboxError(cause.got, place=place, expected=cause.expected, remedy=cause.remedy)
        return Refusal(node=node, error=own, is_final=True)
    lost = SandboxError(
        _why(error),
        place=name,
        expected="a process of tacevo that starts",
        remedy="install there what is installed here, or take the node out of the cluster",
    )
    return Refusal(node=node, error=lost, is_final=False)


def _why(error: Exception) -> str:
    """Return the line of an error that tells most: Ray puts a traceback into one, whose last line it is."""
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    named = [line for line in lines if "Error: " in line]
    return describe(type(error)(named[-1])) if named else describe(error)
