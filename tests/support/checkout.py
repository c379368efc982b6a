"""The checkout that the tests try, and what lies in it and beside it."""

import os
from pathlib import Path

ROOT = Path(__file__).parents[2]
GOLDEN = ROOT / "tests" / "golden"  # recorded results
BUNDLES = GOLDEN / "bundles"  # the first published runs
PUBLISHED = ROOT / "cache" / "published"  # today's
LIBRARY = ROOT / "conf" / "library"
#: Names a directory of recordings, photographs and real answers that are not published, for tests that try them, too.
VARIABLE = "TACEVO_TEST_DATA"
SHARED = Path(os.environ.get(VARIABLE) or ROOT / "not-at-hand")
