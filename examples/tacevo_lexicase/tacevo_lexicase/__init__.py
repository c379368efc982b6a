"""Parts for TacEvo: two rules that choose parents, a source of a robot's logs, and a table of ancestors."""
