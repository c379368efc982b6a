"""What makes a real search small: the settings that the tests of whole searches share."""

from collections.abc import Callable
from pathlib import Path

UNTRACKED = "tracking=none"

#: Few niches, found quickly.
ARCHIVES = ["archive.niches=5", "archive.prompt_niches=5", "archive.samples=100"]

#: Answers of the tests' own provider (`tests_own`).
DRAWN = ["llm.provider=drawn", "llm.model=drawn"]

#: A force search that trains, on few images of the tests' own source and for one epoch.
TOUCHES = ["experiment=published_force", "data.source=touches", "data.images=40", "training.epochs=1"]

#: The same with few niches, and answers of the tests' own provider.
SMALLEST = [*TOUCHES, *DRAWN, *ARCHIVES]

#: The same with the simulator and the grammar, which are rooms.
SIMULATED = ["experiment=published_force", "data.images=40", "training.epochs=1", *ARCHIVES]

#: The size of the search that the fixture `published` makes.
PUBLISHED_SIZES = ["search.generations=1", "search.candidates=3", "search.initial=2"]

#: The fixture `once`: fills a directory of a name by a function, once a session, and returns it.
Once = Callable[[str, Callable[[Path], object]], Path]
