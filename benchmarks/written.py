"""How the tables of these benchmarks write a figure."""


def interval(estimate: float, low: float, high: float, digits: int = 2) -> str:
    """Write an estimate with the ends of its interval."""
    return f"{estimate:.{digits}f} [{low:.{digits}f}, {high:.{digits}f}]"
