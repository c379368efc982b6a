"""Optimisers of others on the table of a space, by ask and tell, beside random draws and the searches of this project.

    make bench-table                         every contender, 200 searches each
    python -m benchmarks.peers_table --help  the same in an environment that has peers.txt

Each contender is a page: a generator that yields the genes of a network and is sent its fitness.
"""
