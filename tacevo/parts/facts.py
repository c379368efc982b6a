"""The facts of our sources, providers and outputs by their names alone: nothing is imported for it.

A recorded run is read, shown, compared and replayed by these facts where the part itself is not installed. Of a part
that is not ours, the defaults hold.
"""

from collections.abc import Mapping
from dataclasses import dataclass

from tacevo.choices import OPTIONAL_SAMPLING
from tacevo.records import Delivery


@dataclass(frozen=True, slots=True, kw_only=True)
class SourceFacts:
    """The facts that are known of a source."""

    #: Settings of `data` that it uses, where they have an effect (`tacevo.config.sources`); beside `EVERY_SOURCE`.
    uses: frozenset[str] = frozenset()
    #: Whether its images follow from settings alone: they are made where they are needed, and lie nowhere.
    is_made: bool = False
    #: Whether nothing is trained, because evaluations are looked up in the table of a space: there are no images.
    is_looked_up: bool = False
    #: Whether it reads the TacVerse release, which has its own split and names.
    is_release: bool = False
    #: The kind of thing that `data.root` must name, `directory` or `file`; empty where it may be left out.
    root: str = ""
    #: The largest `data.image_size`, in pixels.
    largest: int = 1024
    #: The meaning of `data.sensor_column`: the name of a `column` or `array`, or a `level` of directories; empty where
    #: a user cannot say so which sensor recorded an image.
    names_sensors: str = ""
    #: Whether the files themselves say which images belong together.
    has_groups: bool = False
    #: The setting by which a user says which images were recorded together; empty where that cannot be said.
    grouping: str = ""


#: Settings of `data` that every source of images uses.
EVERY_SOURCE = frozenset(
    {"source", "image_size", "split", "split_seed", "validation_part", "test_part", "normalisation"}
)

#: Settings of a recording that names sensors and parts.
_SENSORS = frozenset({"sensor_column", "split_column", "sensor", "test_sensor", "shots"})

_BY_PATTERN = "data.group_pattern='\"REGEX\"' on the paths"

SOURCES: Mapping[str, SourceFacts] = {
    "simulated": SourceFacts(
        uses=EVERY_SOURCE | {"images", "seed", "sensor", "sensor_seed", "light", "gel_mm", "spacings_mm"},
        is_made=True,
        largest=256,
    ),
    "csv": SourceFacts(
        uses=EVERY_SOURCE
        | {"root", "table", "image_column", "target_columns", "skip_missing"}
        | {"white_point", "group_column", "group_pattern"}
        | _SENSORS,
        root="directory",
        names_sensors="column",
        grouping=f"; name groups by data.group_column=COLUMN, or {_BY_PATTERN}",
    ),
    "folder": SourceFacts(
        uses=EVERY_SOURCE | {"root", "white_point", "group_pattern"} | _SENSORS,
        root="directory",
        names_sensors="level",
        grouping=f"; name groups by {_BY_PATTERN}",
    ),
    "tacverse": SourceFacts(
        uses=EVERY_SOURCE
        | {"root", "sensor", "pattern", "skip_missing", "white_point", "group_pattern"}
        | {"select", "images", "spacings_mm", "classes", "test_sensor", "shots"},
        is_release=True,
        root="directory",
        grouping=f"; name groups by data.split=random {_BY_PATTERN}",
    ),
    "numpy": SourceFacts(
        uses=EVERY_SOURCE | {"root", "white_point"} | _SENSORS,
        root="file",
        names_sensors="array",
        has_groups=True,
        grouping="; name groups by an array `groups`",
    ),
    "table": SourceFacts(
        uses=frozenset({"source", "root", "image_size"}), is_looked_up=True, root="file", has_groups=True
    ),
}


@dataclass(frozen=True, slots=True, kw_only=True)
class ProviderFacts:
    """The facts that are known of a provider."""

    #: Whether a language model answers; if not, it draws networks from a grammar, which a space may bound.
    is_model: bool = True
    #: The host of the provider's own servers, and the variable that tells its SDK of another address; empty where it
    #: asks none that is known here.
    host: str = ""
    variable: str = ""
    #: The further sampling settings that it knows.
    sampling: tuple[str, ...] = OPTIONAL_SAMPLING
    #: The ways in which its answers may be asked for.
    deliveries: tuple[Delivery, ...] = (Delivery.direct,)


PROVIDERS: Mapping[str, ProviderFacts] = {
    "grammar": ProviderFacts(is_model=False, sampling=()),
    "anthropic": ProviderFacts(
        host="api.anthropic.com", variable="ANTHROPIC_BASE_URL", deliveries=(Delivery.direct, Delivery.batch)
    ),
    "openai": ProviderFacts(
        host="api.openai.com",
        variable="OPENAI_BASE_URL",
        sampling=tuple(name for name in OPTIONAL_SAMPLING if not name.startswith("thinking")),
    ),
}

#: The kinds of tables that each of our outputs makes, of a run, a study and a sweep.
OUTPUT_TABLES: Mapping[str, tuple[str, ...]] = {
    "effects": ("instruction_effects", "instruction_mix"),
    "pareto": ("pareto",),
    "alarms": ("health",),
    "motifs": ("motifs",),
    "noise": ("noise", "ranking", "fitness_rules", "corrected"),
    "images": ("ensembles", "image_outputs"),
    "transfer": ("transfer", "transfer_joint", "transfer_sensors"),
    "published": ("published", "beside_published"),
}

#: The executor of this machine. All others run candidates elsewhere.
HERE = "local"


#: A source of a user's names groups in its catalogue, or none.
_BROUGHT = SourceFacts(has_groups=True)


def source_facts(name: str) -> SourceFacts:
    """Return what is known of a source by its name, installed or not."""
    return SOURCES.get(name, _BROUGHT)


def provider_facts(name: str) -> ProviderFacts:
    """Return what is known of a provider by its name, installed or not."""
    return PROVIDERS.get(name, ProviderFacts())
