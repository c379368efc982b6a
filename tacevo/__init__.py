"""TacEvo: architecture search for vision-based tactile sensors that can be replayed bit for bit."""

__version__ = "0.2.0.dev0"
