"""What a user may write about the archives of a run, in the group `archive`; see `tacevo.config.schema`."""

from dataclasses import dataclass

from tacevo.choices import ArchiveKind, Axis, BoundsRule, Scale
from tacevo.config.ranges import Count, Settings


@dataclass(frozen=True, kw_only=True)
class ArchiveConfig(Settings):
    """The archives of networks and of prompts; that of prompts is always a CVT archive."""

    niches: Count
    prompt_niches: Count
    #: Uniform points from which k-means finds the centroids.
    samples: int
    seed: int
    bounds: BoundsRule
    #: With `bounds=fixed`: the (low, high) of each descriptor.
    arch_div_bounds: tuple[float, ...]
    eff_ratio_bounds: tuple[float, ...]
    eff_ratio_scale: Scale
    kind: ArchiveKind = ArchiveKind.cvt
    #: With `kind=best`: how many networks are kept; niches, axes and bounds then have no effect on networks.
    kept: Count = 10
    #: The axes of the networks' niches.
    axes: tuple[Axis, ...] = tuple(Axis)
