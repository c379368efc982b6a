"""The metrics of a sweep's runs, and which way each is better."""

from enum import StrEnum


class Metric(StrEnum):
    """A metric of a run; the values are the words of a table."""

    test_mse = "test MSE"
    test_accuracy = "test accuracy"
    test_loss = "test loss"
    best_fitness = "best fitness"
    new_quartile = "new candidates, lower quartile"
    new_median = "new candidates, median"
    improvement = "improvement over generation 0"
    improvement_over_baseline = "improvement over the baseline"
    qd_score = "QD-score"
    coverage = "coverage"
    trainable = "trainable"
    candidates = "candidates"
    evaluations = "evaluations"
    training_flops = "training FLOPs (10^12)"
    tokens = "tokens"
    cost = "cost (USD)"


#: The metrics of the networks that a job found, trained again (`tacevo.results.job_scores`), by the metric of the task.
TESTS = {"mse": Metric.test_mse, "accuracy": Metric.test_accuracy}

#: All that are of these trainings.
TESTED = frozenset([*TESTS.values(), Metric.test_loss])

#: Metrics of what a search used, and not of what it found.
SPENT = frozenset([Metric.candidates, Metric.evaluations, Metric.training_flops, Metric.tokens, Metric.cost])

#: Metrics that are whole numbers.
COUNTS = frozenset([Metric.candidates, Metric.evaluations, Metric.tokens])

#: Metrics that are fractions.
FRACTIONS = frozenset(
    [
        *(Metric.test_accuracy, Metric.improvement, Metric.improvement_over_baseline),
        *(Metric.coverage, Metric.trainable),
    ]
)

#: Metrics of which less is better; of what a search used, less is better only where it came as far.
LESS_IS_BETTER = SPENT | {
    *(Metric.test_mse, Metric.test_loss),
    *(Metric.best_fitness, Metric.new_quartile, Metric.new_median),
}
