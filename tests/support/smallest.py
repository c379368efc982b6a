"""What makes a real search small: the settings that the tests of whole searches share."""

from collections.abc import Callable
from pathlib import Path

UNTRACKED = "tracking=none"

#: Few niches, found quickly.
ARCHIVES = ["archive.niches=5", "archive.prompt_niches=5", "archive.samples=100"]

#: A force search that trains, on few images and for one epoch; its images and answers are of the tests' own (`tests_own`).
SMALLEST = [
    *("experiment=published_force", "data.source=touches", "llm.provider=drawn", "llm.model=drawn"),
    *("data.images=40", "training.epochs=1", *ARCHIVES),
]

#: The same with the simulator and the grammar.
SIMULATED = ["experiment=published_force", "data.images=40", "training.epochs=1", *ARCHIVES]

#: The size of the search that the fixture `published` makes.
PUBLISHED_SIZES = ["search.generations=1", "search.candidates=3", "search.initial=2"]

#: The fixture `once`: fills a directory of a name by a function, once a session, and returns it.
Once = Callable[[str, Callable[[Path], object]], Path]
