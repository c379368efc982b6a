"""The task that holds a slot of a node: it passes one job to the node's process and waits.

Its process has few modules, for there are as many as slots; so it reads neither the job nor the answer.
"""

import functools
from typing import Any


def name_of(node: str) -> str:
    """Return the name of a node's process, by Ray's id of the node; names belong to one run."""
    return f"tacevo-{node}"


def run_job(job: bytes) -> bytes:
    """Have the process of this node run a job."""
    import ray

    gpus = [str(gpu) for gpu in ray.get_gpu_ids()]
    answer: bytes = ray.get(_process(ray.get_runtime_context().get_node_id()).run.remote(job, gpus))
    return answer


@functools.cache
def _process(node: str) -> Any:
    import ray

    return ray.get_actor(name_of(node))
