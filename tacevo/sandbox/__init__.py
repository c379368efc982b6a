"""The sandbox: a zygote, a supervisor for each candidate, limits, and the child side of a job."""
