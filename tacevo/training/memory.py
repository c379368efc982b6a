"""The memory of a GPU that a training will want, as far as the probe's profile tells; pure.

It is a guess, and no result depends on it: a training that was refused memory under a guess is made again with all that
its recipe allows (`tacevo.training.leases`).
"""

import math

from tacevo.profile import Profile
from tacevo.records import Contract, Recipe

#: Memory that a process takes of a GPU beside its tensors, for context and kernels, in MiB: 767 on an H200, with
#: torch 2.11.
CONTEXT_MIB = 1024

_FLOAT = 4  # bytes
#: The values in memory for each parameter: itself, its gradient and two moments of Adam.
_OF_A_PARAMETER = 4
#: The values in memory for each activation: itself, and as much again for its gradient, masks and what is being
#: computed.
_OF_AN_ACTIVATION = 2
#: A captured step is tried on a second network first, whose memory lies in another stream and is not used again.
_NETWORKS = 2
#: The memory for the workspaces of cuBLAS and cuDNN, and what lies idle between blocks.
_BESIDE_MIB = 512


def predicted_mib(profile: Profile, contract: Contract, recipe: Recipe, images: int) -> int | None:
    """Predict the memory that a training takes beside the driver's, in MiB.

    Args:
        profile: the probe's; its steps name the shape of each result for one image.
        contract: what its images are.
        recipe: how it is trained.
        images: those that lie on the device, uint8.

    Returns:
        A positive number; None where the profile has no steps, as those of early releases and of long networks.
    """
    if not profile.steps:
        return None
    activations = recipe.batch_size * sum(math.prod(step.shape) for step in profile.steps)
    values = _OF_A_PARAMETER * profile.learnt + _OF_AN_ACTIVATION * activations
    stored = images * contract.in_channels * contract.image_size**2
    return math.ceil((_NETWORKS * _FLOAT * values + stored) / 2**20) + _BESIDE_MIB
