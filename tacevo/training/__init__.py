"""Confined training: the recipe in the child, the losses and the verdict in the parent."""
