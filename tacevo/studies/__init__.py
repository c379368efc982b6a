"""Full trainings of the best networks."""
