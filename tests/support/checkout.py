"""The checkout that the tests try, and what lies in it and beside it."""

from pathlib import Path

ROOT = Path(__file__).parents[2]
GOLDEN = ROOT / "tests" / "golden"  # recorded results
BUNDLES = GOLDEN / "bundles"  # the first published runs
PUBLISHED = ROOT / "cache" / "published"  # today's
LIBRARY = ROOT / "conf" / "library"
SHARED = ROOT.parent / "shared"  # data sets, photographs and real answers, where they are at hand
