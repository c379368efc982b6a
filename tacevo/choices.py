"""The named choices of a configuration; member names are what users write (Hydra reads enums by name)."""

from enum import StrEnum


class SensorTask(StrEnum):
    """What is pressed onto the simulated sensor, and what the network must read from the image."""

    force = "force"
    grating = "grating"
    hardness = "hardness"


class SimulatedSensor(StrEnum):
    """What the camera of a simulated sensor sees: markers and the object (ViTacTip), or one of both.

    The names are those of the real sensors (and of their directories in the TacVerse release).
    """

    ViTacTip = "ViTacTip"
    #: Without markers.
    ViTac = "ViTac"
    #: Behind an opaque skin.
    TacTip = "TacTip"


#: Stands for all sensors that a recording names.
ALL_SENSORS = "*"


class RecordedTask(StrEnum):
    """What recordings of the release's sensors are for: the tasks that come with the project."""

    force = "force"
    grating = "grating"
    hardness = "hardness"
    shape = "shape"


class GratingClasses(StrEnum):
    """What the classes of recorded gratings are: their sizes, the families dot and line of patterns, or both."""

    size = "size"
    pattern = "pattern"
    joint = "joint"


class SplitRule(StrEnum):
    """Who decides which rows are for training: `random`, by a seed; `release`, the authors of the recording."""

    random = "random"
    release = "release"


class LightScene(StrEnum):
    """The light that a simulated sensor is seen in."""

    standard = "standard"
    dim = "dim"
    bright = "bright"
    side = "side"


class Normalisation(StrEnum):
    """How uint8 images become the network's input."""

    standardise = "standardise"
    unit = "unit"


class TargetScaling(StrEnum):
    """How regression labels are scaled, by the training split's statistics."""

    minmax = "minmax"
    zscore = "zscore"
    none = "none"


class SystemTurn(StrEnum):
    """Where a request has the system prompt: as one, or at the start of the user's first turn."""

    system = "system"
    user = "user"


#: Sampling settings that reach a request only where they are set, in the order of their names.
OPTIONAL_SAMPLING = ("stop_sequences", "thinking_tokens", "top_k", "top_p")


#: The axes of the paper. A recorded run whose configuration names none has these.
PAPER_AXES = ("arch_div", "eff_ratio")


class BoundsRule(StrEnum):
    """Which range of a descriptor maps to [0, 1]."""

    adaptive = "adaptive"
    fixed = "fixed"


class Scale(StrEnum):
    """Whether the Efficiency Ratio is normalised as it is or by its logarithm."""

    linear = "linear"
    log = "log"


class OperatorScope(StrEnum):
    """What one draw of the operator holds for."""

    generation = "generation"
    candidate = "candidate"


class Numerics(StrEnum):
    """Where training bits are equal: `portable` and `portable512` on any x86-64 CPU with AVX2 or with AVX-512.

    `fast`: on the recorded machine only.
    """

    portable = "portable"
    portable512 = "portable512"
    fast = "fast"


class Device(StrEnum):
    """What candidates are trained on."""

    cpu = "cpu"
    cuda = "cuda"


class Layout(StrEnum):
    """How images and weights lie in a GPU's memory."""

    #: Channel after channel, as torch has them by default.
    contiguous = "contiguous"
    #: All channels of a pixel beside each other.
    channels_last = "channels_last"


class Precision(StrEnum):
    """How a GPU multiplies: in float32; in TF32, which cuts inputs to 10 bits of mantissa; or by autocast to bf16."""

    float32 = "float32"
    tf32 = "tf32"
    bf16 = "bf16"


class Confinement(StrEnum):
    """How strongly candidates are confined; each level includes the one before. A run names the least it accepts."""

    none = "none"
    process = "process"
    kernel = "kernel"


class ChosenBy(StrEnum):
    """What the elites of a study are chosen by: their recorded fitness, or the median of a noise run's re-estimates."""

    fitness = "fitness"
    reestimated = "reestimated"


class Primary(StrEnum):
    """What the arms of a sweep are compared by first; all other metrics are secondary."""

    #: Of the best networks of each job, trained again with fresh seeds: accuracy or MSE.
    test_score = "test_score"
    #: Of these trainings, the geometric mean of cross-entropy or MSE.
    test_loss = "test_loss"
    best_fitness = "best_fitness"
    #: Of the fitness of the new candidates in the later half of the generations, in which no luck piles up.
    new_quartile = "new_quartile"
    qd_score = "qd_score"
    coverage = "coverage"

    @property
    def is_tested(self) -> bool:
        """Whether networks must be trained fully for it, and tested."""
        return self in {Primary.test_score, Primary.test_loss}


class Varied(StrEnum):
    """A setting that each job of a sweep may take from its seed."""

    contacts = "data.seed"
    sensor = "data.sensor_seed"
    splitting = "data.split_seed"


class MarginKind(StrEnum):
    """What an equivalence margin counts in."""

    #: Parts of the baseline's median.
    relative = "relative"
    #: Parts of what the baseline gets wrong, which is of an accuracy what lacks to 1; of an error, its median.
    errors = "errors"
    #: The unit of the metric.
    absolute = "absolute"
