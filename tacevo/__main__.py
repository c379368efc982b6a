"""`python -m tacevo` is the `tacevo` command."""

import sys

from tacevo.cli.app import main

if __name__ == "__main__":
    sys.exit(main())
