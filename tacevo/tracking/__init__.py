"""A run in MLflow: `mirror` brings the store level with a run directory, and anybody may call it again.

1. It writes nothing into the run directory but its own log, and reads the ledger's lines as they stand.
2. What stands in the store is not written again: done twice, or killed at any moment and done again, it says the same.
   A nested run that a kill left unfinished is written anew; what a user nested there is left alone.
3. Two searches are never mixed: a search is found by the first line of its ledger and its name, a candidate or study
   by its name and the hash of its line; another one of the same name is an error that says what to delete.
4. One process at a time mirrors a directory; jobs of a sweep that begin at once share one run of the sweep.
5. It works beside the search, in a process that may be slow, fail or be killed: the search warns in one line.
6. An address with a password is never recorded: log and warning name the variable that holds it.
7. `tacevo track` does the same for all runs below a directory; a damaged one is named, and the others are written.
"""
