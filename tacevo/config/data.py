"""What a user may write about data; like `tacevo.config.schema`, of which it is the group `data`."""

from dataclasses import dataclass

from tacevo.choices import DataSource, LightScene, Normalisation, SplitRule
from tacevo.config.checks import is_positive, require


@dataclass(kw_only=True)
class DataConfig:
    """Where the images come from, and how they are prepared."""

    source: DataSource
    #: Height and width, in pixels.
    image_size: int
    #: Simulated: how many images, the seed of the contacts, that of the sensor, and its light.
    images: int
    seed: int
    sensor_seed: int
    light: LightScene
    #: Simulated gratings: the spacings that are the classes, in mm.
    spacings_mm: list[float]
    #: Recorded: the folder of the data set, or the file of a NumPy archive.
    root: str | None
    #: CSV: the table and the columns to read.
    table: str
    image_column: str
    target_columns: list[str]
    #: TacVerse: the folders to read; the pattern is for gratings.
    sensor: str
    pattern: str | None
    #: Tables: leave out rows whose image is missing, instead of refusing the table.
    skip_missing: bool
    split: SplitRule
    split_seed: int
    normalisation: Normalisation

    def __post_init__(self) -> None:
        """Check the ranges."""
        simulated = self.source is DataSource.simulated
        most = 256 if simulated else 1024
        sized = 16 <= self.image_size <= most
        require(sized, "data.image_size", f"a value from 16 to {most} for data={self.source}", self.image_size)
        require(self.images >= 10, "data.images", "a value >= 10", self.images)
        for key in ("seed", "sensor_seed", "split_seed"):
            require(getattr(self, key) >= 0, f"data.{key}", "a value >= 0", getattr(self, key))
        if not simulated:
            what = "file" if self.source is DataSource.numpy else "folder"
            require(bool(self.root), "data.root", f"the {what} of the data set for data={self.source}", self.root)
        if self.source is DataSource.csv:
            columns = self.target_columns
            named = bool(columns) and len(set(columns)) == len(columns)
            require(named, "data.target_columns", "the different columns of the labels, e.g. [fx,fy,fz]", columns)
        require(bool(self.sensor), "data.sensor", "the name of a folder", self.sensor)
        require(self.pattern != "", "data.pattern", "the name of a folder, or null", self.pattern)
        spaced = 0 < len(set(self.spacings_mm)) == len(self.spacings_mm) and all(map(is_positive, self.spacings_mm))
        require(spaced, "data.spacings_mm", "different finite values > 0", self.spacings_mm)
