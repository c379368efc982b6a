"""`python -m tacevo`, and what the script `tacevo` calls: the command, from the first moment on."""

import sys


def main() -> int:
    """Run one command; return its exit status. Ctrl-C while its modules are imported is told in one line, too."""
    try:
        from tacevo.cli.app import main as command

        return command()
    except KeyboardInterrupt:
        print("\ninterrupted; nothing was begun", file=sys.stderr)
        return 130


if __name__ == "__main__":
    sys.exit(main())
