"""The files on disk: stores, ledgers, and the directories of runs, studies and sweeps."""
