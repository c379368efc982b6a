"""The kinds of parts, and those that come with tacevo: names and where they are; nothing is imported for that.

One of ours is imported when it is used, so what a run does not use may be missing.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field

#: The most that a part that decides may be, in bytes and in files: it is part of each run and bundle.
MOST_BYTES, MOST_FILES = 1_000_000, 200


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Kind:
    """One kind of parts."""

    #: The name of the kind, also that of the group of its entry points: `tacevo.parents`.
    name: str
    #: The work of a part of this kind, for a list of kinds.
    does: str
    #: The setting that chooses one; empty where all that are installed are used.
    setting: str
    #: Whether results of a run follow from it, so that it is recorded, confined and compared.
    decides: bool
    #: Ours, by name: `module:attribute`.
    ours: Mapping[str, str]
    #: The class of `tacevo.parts` that one of a user's extends, and the constants of that class which others look at.
    base: str = ""
    constants: tuple[str, ...] = ()
    #: The extra of tacevo that installs the libraries that one of ours needs, where `pip install tacevo` does not.
    extras: Mapping[str, str] = field(default_factory=dict)

    @property
    def key(self) -> tuple[str, str]:
        """The group of settings, and the setting in it, that chooses one."""
        group, _, setting = self.setting.partition(".")
        return group, setting

    @property
    def group(self) -> str:
        """The group of the entry points by which an installed package offers parts of this kind."""
        return f"tacevo.{self.name}"


PROVIDERS = Kind(
    name="providers",
    does="answers requests",
    setting="llm.provider",
    decides=False,
    ours={
        "grammar": "tacevo.llm.grammar.provider:from_settings",
        "anthropic": "tacevo.llm.claude:from_settings",
        "openai": "tacevo.llm.openai:from_settings",
    },
    extras={"openai": "openai"},
)

SOURCES = Kind(
    name="sources",
    does="reads or makes images and their labels",
    setting="data.source",
    decides=False,
    ours={
        "simulated": "tacevo.data.simulator.tasks:from_settings",
        "csv": "tacevo.data.sources.table:from_settings",
        "folder": "tacevo.data.sources.folder:from_settings",
        "tacverse": "tacevo.data.sources.tacverse:from_settings",
        "numpy": "tacevo.data.sources.arrays:from_settings",
        "table": "tacevo.runs.table_answers:LookedUp",
    },
)

EXECUTORS = Kind(
    name="executors",
    does="runs candidates in sandboxes, here or elsewhere",
    setting="executor.kind",
    decides=False,
    ours={
        "local": "tacevo.runs.local:Local",
        "ray": "tacevo.cluster.executor:Ray",
    },
    extras={"ray": "ray"},
)

TRACKERS = Kind(
    name="trackers",
    does="mirrors runs and studies",
    setting="tracking.kind",
    decides=False,
    ours={
        "mlflow": "tacevo.tracking.tracker:MLflow",
        "none": "tacevo.parts.tracker:Untracked",
    },
)

PARENTS = Kind(
    name="parents",
    does="chooses who the parents of the next candidates are",
    setting="proposals.parents",
    decides=True,
    ours={
        "uniform": "tacevo.evolution.parents:Uniform",
        "best": "tacevo.evolution.parents:Best",
        "curiosity": "tacevo.evolution.parents:Curious",
        "baseline": "tacevo.evolution.parents:Baseline",
        "trained": "tacevo.evolution.parents:Trained",
        "best_k": "tacevo.evolution.parents:BestK",
        "none": "tacevo.evolution.parents:Nobody",
    },
    base="Parents",
    constants=("has_parents", "crosses", "counts_elites", "chooses_pool"),
)

PROMPTS = Kind(
    name="prompts",
    does="draws the instruction of a mutation",
    setting="prompts.policy",
    decides=True,
    ours={
        "uniform": "tacevo.evolution.instructions:Uniform",
        "curiosity": "tacevo.evolution.instructions:Curious",
        "effect": "tacevo.evolution.instructions:Effect",
        "none": "tacevo.evolution.instructions:Unrecorded",
    },
    base="Prompts",
    constants=("records",),
)

TEMPERATURES = Kind(
    name="temperatures",
    does="sets the sampling temperature of the next generation",
    setting="temperature.rule",
    decides=True,
    ours={
        "paper": "tacevo.evolution.temperatures:Paper",
        "fixed": "tacevo.evolution.temperatures:Fixed",
        "stall": "tacevo.evolution.temperatures:Stall",
    },
    base="Temperature",
)

ARCHIVES = Kind(
    name="archives",
    does="says where the niches of the network archive are",
    setting="archive.kind",
    decides=True,
    ours={
        "cvt": "tacevo.evolution.archive:Cvt",
        "best": "tacevo.evolution.archive:Fittest",
    },
    constants=("has_niches",),
    base="Archive",
)

DESCRIPTORS = Kind(
    name="descriptors",
    does="measures a network for an axis of the archive",
    setting="archive.axes",
    decides=True,
    ours={
        "arch_div": "tacevo.evolution.descriptors:ArchDiv",
        "eff_ratio": "tacevo.evolution.descriptors:EffRatio",
    },
    base="Descriptor",
)

FITNESS = Kind(
    name="fitness",
    does="turns the validation losses of a training into a fitness",
    setting="training.fitness",
    decides=True,
    ours={
        "last": "tacevo.evolution.fitness:Last",
        "lowest": "tacevo.evolution.fitness:Lowest",
        "mean_of_3": "tacevo.evolution.fitness:MeanOf3",
    },
    base="Fitness",
)

OUTPUTS = Kind(
    name="outputs",
    does="adds tables, figures or a section of the page",
    setting="",
    decides=False,
    ours={
        "effects": "analysis.tables.instruction_tables:InstructionEffects",
        "pareto": "analysis.report.pareto:Pareto",
        "alarms": "analysis.tables.health:Alarms",
        "motifs": "analysis.tables.motifs:Motifs",
        "noise": "analysis.tables.noise:Noise",
        "images": "analysis.tables.images:ImageTests",
        "transfer": "analysis.tables.transfer:Transfer",
        "published": "analysis.tables.published:Published",
    },
)

#: Our commands by group, as the help lists them. Each is a name in `tacevo.cli.commands`.
COMMAND_GROUPS: Mapping[str, tuple[str, ...]] = {
    "search": ("search", "extend", "study", "noise", "tabulate", "judge", "plan"),
    "reproduce": ("replay", "export", "publish", "cache"),
    "analyse": ("show", "tables", "figures", "report", "ablations", "pairs"),
    "tools": ("init", "data", "check", "parts", "track", "doctor"),
}

COMMANDS = Kind(
    name="commands",
    does="adds a command",
    setting="",
    decides=False,
    ours={name: f"tacevo.cli.commands:{name}" for group in COMMAND_GROUPS.values() for name in group},
)

#: All kinds, by name, in the order in which a search meets them.
KINDS: Mapping[str, Kind] = {
    kind.name: kind
    for kind in (
        PROVIDERS,
        SOURCES,
        EXECUTORS,
        TRACKERS,
        PARENTS,
        PROMPTS,
        TEMPERATURES,
        ARCHIVES,
        DESCRIPTORS,
        FITNESS,
        OUTPUTS,
        COMMANDS,
    )
}
