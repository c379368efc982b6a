"""The named choices of a configuration; member names are what users write (Hydra reads enums by name)."""

from enum import StrEnum


class SensorTask(StrEnum):
    """The task of a simulated sensor: the object pressed onto it, and the quantity to be read from the image."""

    force = "force"
    grating = "grating"
    hardness = "hardness"


class SimulatedSensor(StrEnum):
    """The view of a simulated sensor's camera: markers and the object (ViTacTip), or one of both.

    The names are those of the real sensors (and of their directories in the TacVerse release).
    """

    ViTacTip = "ViTacTip"
    #: The object alone, without markers.
    ViTac = "ViTac"
    #: The markers alone, behind an opaque skin.
    TacTip = "TacTip"


#: Stands for all sensors that a recording names.
ALL_SENSORS = "*"


class RecordedTask(StrEnum):
    """The task that a recording of the release's sensors is for: one of those that come with the project."""

    force = "force"
    grating = "grating"
    hardness = "hardness"
    shape = "shape"


class GratingClasses(StrEnum):
    """The classes of recorded gratings: their sizes, the families dot and line of patterns, or both."""

    size = "size"
    pattern = "pattern"
    joint = "joint"


class SplitRule(StrEnum):
    """The rule that splits the rows: `random` draws by a seed, `release` follows the authors of the recording."""

    random = "random"
    release = "release"


class LightScene(StrEnum):
    """The light that a simulated sensor is seen in."""

    standard = "standard"
    dim = "dim"
    bright = "bright"
    side = "side"


class Normalisation(StrEnum):
    """The way in which uint8 images become the network's input."""

    standardise = "standardise"
    unit = "unit"


class TargetScaling(StrEnum):
    """The scaling of regression labels, by the training split's statistics."""

    minmax = "minmax"
    zscore = "zscore"
    none = "none"


class SystemTurn(StrEnum):
    """The place of the system prompt in a request: as a system prompt, or at the start of the user's first turn."""

    system = "system"
    user = "user"


class Carrier(StrEnum):
    """The carrier of a request's temperature T: what of the request T decides."""

    #: The sampling temperature, as in the paper.
    parameter = "parameter"
    #: One of five sentences of the task's library, which say how far to depart from the parent.
    words = "words"
    #: The model's effort.
    effort = "effort"
    #: Nothing: T is nominal.
    none = "none"


class Effort(StrEnum):
    """The effort that a model is asked to put into an answer, from the least to the most."""

    low = "low"
    medium = "medium"
    high = "high"
    xhigh = "xhigh"
    max = "max"


class Thinking(StrEnum):
    """Whether a model thinks before it answers: as much as it decides itself, or not at all."""

    adaptive = "adaptive"
    disabled = "disabled"


class Tell(StrEnum):
    """What a request tells the model beside its parents and its instruction, in the order in which it stands there."""

    #: The fitness, parameters and FLOPs of the parents and of the baseline.
    fitness = "fitness"
    #: A control for `fitness`: the same lines, each with the figures of another network.
    shuffled = "shuffled"
    #: The reasons for which the gate rejected candidates of the last generation.
    failures = "failures"
    #: The three best networks so far.
    best = "best"
    #: The notes that the model wrote at the end of the answers that became the parents.
    notes = "notes"


class AnswerForm(StrEnum):
    """The form of an answer: the `whole` class, or an `edit` of the parent, by search and replace."""

    whole = "whole"
    edit = "edit"


class ModelChoice(StrEnum):
    """The choice of a slot's model among several: by fixed `weights`, or a `bandit` that learns from the children."""

    weights = "weights"
    bandit = "bandit"


#: Sampling settings that reach a request only where they are set, in the order of their names.
OPTIONAL_SAMPLING = ("effort", "stop_sequences", "thinking", "thinking_tokens", "top_k", "top_p")


#: The axes of the paper. A recorded run whose configuration names none has these.
PAPER_AXES = ("arch_div", "eff_ratio")


class BoundsRule(StrEnum):
    """The range of a descriptor that maps to [0, 1]."""

    adaptive = "adaptive"
    fixed = "fixed"


class Scale(StrEnum):
    """Whether the Efficiency Ratio is normalised as it is or by its logarithm."""

    linear = "linear"
    log = "log"


class OperatorScope(StrEnum):
    """The scope of one draw of the operator: what it holds for."""

    generation = "generation"
    candidate = "candidate"


class Numerics(StrEnum):
    """The machines with equal training bits: `portable`, `portable512` are any x86-64 CPU with AVX2, with AVX-512.

    `fast`: on the recorded machine only.
    """

    portable = "portable"
    portable512 = "portable512"
    fast = "fast"


class Device(StrEnum):
    """The device on which candidates are trained."""

    cpu = "cpu"
    cuda = "cuda"


class Layout(StrEnum):
    """The layout of images and weights in a GPU's memory."""

    #: Channel after channel, as torch has them by default.
    contiguous = "contiguous"
    #: The layout with all channels of a pixel beside each other.
    channels_last = "channels_last"


class Precision(StrEnum):
    """The precision of a GPU's products: float32; TF32, which cuts inputs to 10 bits of mantissa; autocast to bf16."""

    float32 = "float32"
    tf32 = "tf32"
    bf16 = "bf16"


class Confinement(StrEnum):
    """The level of confinement; each includes the one before. A run names the least it accepts."""

    none = "none"
    process = "process"
    kernel = "kernel"


class ChosenBy(StrEnum):
    """The quantity that chooses a study's elites."""

    #: The recorded fitness.
    fitness = "fitness"
    #: The median of a noise run's re-estimates.
    reestimated = "reestimated"
    #: The validation loss of one training as long as the study's, of each of several elites. One elite is chosen.
    validated = "validated"


class Primary(StrEnum):
    """The metric by which the arms of a sweep are compared first; all others are secondary."""

    #: The accuracy or MSE on the test images of the best networks of each job, trained again with fresh seeds.
    test_score = "test_score"
    #: The geometric mean of the cross-entropies or MSEs of these trainings.
    test_loss = "test_loss"
    best_fitness = "best_fitness"
    #: The fitness that a quarter of the new candidates of the later generations reach; no luck piles up in it.
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
    """The unit of an equivalence margin."""

    #: Parts of the baseline's median.
    relative = "relative"
    #: Parts of what the baseline gets wrong, which is of an accuracy what lacks to 1; of an error, its median.
    errors = "errors"
    #: The unit of the metric.
    absolute = "absolute"
