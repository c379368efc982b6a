"""What portable numerics compute, so that a CPU can be compared with those that recorded it.

`python -m tacevo.reproduce.bits` computes all of it in a process that has the variables of a level; `compare` starts
such processes and reads `recorded/`, without importing torch.
"""
