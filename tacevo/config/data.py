"""What a user may write about data, in the group `data`; see `tacevo.config.schema`."""

from dataclasses import dataclass
from typing import Annotated

from annotated_types import Ge

from tacevo.choices import DataSource, LightScene, Normalisation, SplitRule
from tacevo.config.ranges import Natural, Positive, Settings, Text


@dataclass(frozen=True, kw_only=True)
class DataConfig(Settings):
    """Where the images come from, and how they are prepared."""

    source: DataSource
    #: Height and width, in pixels.
    image_size: Annotated[int, Ge(16)]
    #: Simulated: how many images, the seed of the contacts, that of the sensor, and its light.
    images: Annotated[int, Ge(10)]
    seed: Natural
    sensor_seed: Natural
    light: LightScene
    #: Simulated gratings: the spacings that are the classes, in mm.
    spacings_mm: tuple[Positive, ...]
    #: Recorded: the directory of the data set, or the file of a NumPy archive.
    root: str | None
    #: CSV: the table and the columns to read.
    table: str
    image_column: str
    target_columns: tuple[str, ...]
    #: TacVerse: the directories to read; the pattern is for gratings.
    sensor: Text
    pattern: Text | None
    #: Tables: leave out rows whose image is missing, instead of refusing the table.
    skip_missing: bool
    split: SplitRule
    split_seed: Natural
    normalisation: Normalisation
