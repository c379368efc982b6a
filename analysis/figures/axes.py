"""Axes that several figures share."""

import textwrap
from collections.abc import Iterable

from matplotlib.axes import Axes

from analysis.runs.run import Run
from tacevo.search.unsent import TEMPERATURE

#: The longest line of a title over a single column, in characters.
_TITLE = 40

#: Losses stand on a logarithmic axis where the largest is at least this many times the smallest.
LOG_FROM = 10.0


def on_loss_axis(axes: Axes, losses: Iterable[float | None]) -> None:
    """Name and scale the upright axis of validation losses.

    Args:
        axes: where they are drawn.
        losses: all that is drawn; None, where nothing was trained, is not.
    """
    values = [loss for loss in losses if loss is not None]
    axes.set_ylabel("validation loss")
    if values and min(values) > 0 and max(values) >= LOG_FROM * min(values):
        axes.set_yscale("log")
    else:
        axes.set_ylim(bottom=0)


def title_unsent_temperatures(axes: Axes, run: Run) -> None:
    """Write above the axes of temperatures that they were not sent to the model, where that is so."""
    axes.set_title(textwrap.fill(run.not_sent.get(TEMPERATURE, ""), _TITLE))
