r"""The gate's reasons in words that a request may tell: stage, reason, and a detail that carries nothing else.

A detail may quote a candidate: its names, a line of it, the message of an exception that it raised. Such a text could
be meant for the model that reads it. So a detail is told only where it is a sentence of the gate, of torch or of Python
that is known here, in which the candidate decides numbers, shapes and names of at most 40 letters alone.
"""

import re

from tacevo.records import Reason, Rejection, Stage

#: What a candidate may decide within a sentence: a name, perhaps a dotted one, and numbers and shapes.
_NAME = r"[A-Za-z_][\w.]{0,39}"
_SIZES = r"[-\d., x()\[\]]{1,60}"

#: The longest detail that is told.
_LONGEST = 240

#: The sentences of extraction that quote what a model wrote; all others of it are the gate's alone.
_CLASSES = re.compile(rf"(expected a class \S+; got )({_NAME})(?:, .*)?", re.ASCII)
_LAST_VERSION = re.compile(r"(?<=whole); got .*")
_SYNTAX = re.compile(
    r"(line \d+: (?:SyntaxError|IndentationError|TabError): [A-Za-z ,.()'=?-]{1,80}): ['\"].*", re.ASCII
)

_POLICY = re.compile(
    rf"line \d+: (?:(?:attribute|module|special method|class) )?{_NAME} (?:may|already means|is the module) [ -~]*",
    re.ASCII,
)

#: Sentences of the probe and the trainer, and of what they run. `NAME` and `SIZES` stand for what a candidate decides.
_SENTENCES = (
    r"expected shape SIZES; got SIZES",
    r"expected float32; got torch\.\w{1,20}",
    r"expected a torch\.Tensor; got (?:tuple|list|dict|NoneType|int|float|str)",
    r"expected at most SIZES (?:parameters|modules|FLOPs an image|operations a pass); got (?:more|SIZES)",
    r"expected trainable parameters; got none",
    r"expected gradients of the parameters after backward; got none",
    r"expected finite outputs for a batch of \d+; got NaN or infinity",
    r"expected finite weights after one training step; got NaN or infinity",
    r"expected initial weights that follow the trainer's seed; got equal draws under two seeds",
    r"expected the same weights before and after a pass with training=\w+; got others",
    r"expected training=\w+ in every module after a pass; got another value",
    r"the predictions after epoch \d+ are not all finite",
    r"(?:NameError: )name 'NAME' is not defined",
    r"AttributeError: '(?:NAME)' object has no attribute '(?:NAME)'",
    r"AttributeError: cannot assign module before Module\.__init__\(\) call",
    r"TypeError: NAME\(\) (?:got an unexpected keyword argument 'NAME'|got multiple values for argument 'NAME')",
    r"TypeError: NAME\(\) (?:missing|takes) [\w ]{0,40} positional arguments?(?: but \d+ (?:was|were) given)?",
    r"TypeError: NAME\(\) missing \d+ required positional arguments?: 'NAME'",
    r"ModuleNotFoundError: No module named 'NAME'",
    r"(?:ValueError|TypeError|RuntimeError): (?:in_channels|out_channels|num_channels|embed_dim|hidden size) "
    r"must be divisible by (?:groups|num_groups|num_heads)",
    r"(?:RuntimeError|ValueError): mat1 and mat2 shapes cannot be multiplied SIZES(?: and SIZES)?",
    r"RuntimeError: Given groups=\d+, weight of size SIZES, expected inputSIZES to have \d+ channels, but got \d+ "
    r"channels instead",
    r"RuntimeError: The size of tensor a SIZES must match the size of tensor b SIZES at non-singleton dimension \d+",
    r"RuntimeError: Sizes of tensors must match except in dimension \d+\. Expected size \d+ but got size \d+ for "
    r"tensor number \d+ in the list\.",
    r"RuntimeError: Calculated padded input size per channel: SIZES\. Kernel size: SIZES\. Kernel size can't be "
    r"greater than actual input size",
    r"RuntimeError: Given input size: SIZES\. Calculated output size: SIZES\. Output size is too small",
    r"RuntimeError: Given normalized_shape=SIZES, expected input with shape \[\*, \d+\], but got input of sizeSIZES",
    r"RuntimeError: running_mean should contain \d+ elements not \d+",
    r"RuntimeError: Expected \dD(?: \(\w{1,9}\))?(?: or \dD(?: \(\w{1,9}\))?)? input to \w{1,20}, but got input "
    r"of size: SIZES",
    r"RuntimeError: shape 'SIZES' is invalid for input of size \d+",
    r"ValueError: expected \d+D(?: or \d+D)? input \(got \d+D input\)",
    r"ValueError: Expected more than 1 value per channel when training, got input size torch\.Size\(SIZES\)",
)
_KNOWN = re.compile(
    "|".join(f"(?:{one})" for one in _SENTENCES).replace("NAME", _NAME).replace("SIZES", _SIZES), re.ASCII
)


def reason_in_words(rejection: Rejection) -> str:
    """Write the stage and the reason of a rejection, and its detail as far as it carries nothing else."""
    detail = _harmless(rejection)
    return f"{rejection.stage}, {rejection.reason}{f': {detail}' if detail else ''}"


def _harmless(rejection: Rejection) -> str:
    """Return what of a detail can be told; empty where that is nothing."""
    detail = rejection.detail
    if len(detail) > 2 * _LONGEST:
        return ""
    match rejection.stage:
        case Stage.extract if rejection.reason is Reason.syntax:
            known = _SYNTAX.fullmatch(detail)
            return known[1] if known else ""
        case Stage.extract if detail.startswith("expected a class ") and not detail.endswith("; got no Python class"):
            known = _CLASSES.fullmatch(detail)
            return known[1] + known[2] if known else ""
        case Stage.extract:
            return _LAST_VERSION.sub("", detail)
        case Stage.policy:
            return detail[:_LONGEST] if _POLICY.fullmatch(detail) else ""
        case _:
            return detail if _KNOWN.fullmatch(detail) else ""
