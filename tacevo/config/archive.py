"""What a user may write about the archives of a run, in the group `archive`; see `tacevo.config.schema`."""

import math
from dataclasses import dataclass, field

from tacevo.choices import ArchiveKind, Axis, BoundsRule, Scale
from tacevo.config.checks import require


@dataclass(kw_only=True)
class ArchiveConfig:
    """The archives of networks and of prompts; that of prompts is always a CVT archive."""

    niches: int
    prompt_niches: int
    #: Uniform points from which k-means finds the centroids.
    samples: int
    seed: int
    bounds: BoundsRule
    #: With `bounds=fixed`: the (low, high) of each descriptor.
    arch_div_bounds: list[float]
    eff_ratio_bounds: list[float]
    eff_ratio_scale: Scale
    kind: ArchiveKind = ArchiveKind.cvt
    #: With `kind=best`: how many networks are kept; niches, axes and bounds then have no effect on networks.
    kept: int = 10
    #: The axes of the networks' niches.
    axes: list[Axis] = field(default_factory=lambda: list(Axis))

    def __post_init__(self) -> None:
        """Check the ranges."""
        require(self.kept >= 1, "archive.kept", "a value >= 1", self.kept)
        known = [list(Axis), *([axis] for axis in Axis)]
        told = [str(axis) for axis in self.axes]
        require(self.axes in known, "archive.axes", "[arch_div,eff_ratio], [arch_div] or [eff_ratio]", told)
        whole = self.kind is ArchiveKind.cvt or len(self.axes) == len(Axis)
        require(whole, "archive.axes", "[arch_div,eff_ratio] with archive.kind=best, which has no axes", told)
        most = self.samples
        require(1 <= self.niches <= most, "archive.niches", f"a value from 1 to archive.samples={most}", self.niches)
        prompt_niches = self.prompt_niches
        fits = 1 <= prompt_niches <= most
        require(fits, "archive.prompt_niches", f"a value from 1 to archive.samples={most}", prompt_niches)
        for key in ("arch_div_bounds", "eff_ratio_bounds"):
            pair = getattr(self, key)
            ordered = len(pair) == 2 and -math.inf < pair[0] < pair[1] < math.inf
            require(ordered, f"archive.{key}", "[low, high] with finite low < high", pair)
        if self.bounds is BoundsRule.fixed and self.eff_ratio_scale is Scale.log:
            low = self.eff_ratio_bounds[0]
            require(low > 0, "archive.eff_ratio_bounds", "low > 0 with eff_ratio_scale=log", low)
