"""How the sampling temperature moves (paper, Algorithm 1, lines 4 and 9)."""

from tacevo.choices import TemperatureRule


def next_temperature(
    rule: TemperatureRule, temperature: float, *, best: float, best_before: float, step: float
) -> float:
    """Return the temperature of the next generation, T_{g+1}.

    `paper` is the formula as printed: up when the archive best is not worse than before, else down; an archive's
    best never gets worse, so it only ever rises, except where elites are trained again (`tacevo.search.reevaluation`):
    that can take the best away. `stall` raises it only when the generation brought no better best, and lowers it when
    it did. `fixed` leaves it alone.

    The temperature is T_g, `best` and `best_before` are f*_g and f*_{g-1}, the archive's best fitness (lower is better)
    after this generation and the one before, and `step` is eta. Temperatures and eta are in [0, 1].
    """
    match rule:
        case TemperatureRule.fixed:
            rises = 0
        case TemperatureRule.paper:
            rises = 1 if best <= best_before else -1
        case TemperatureRule.stall:
            rises = 1 if best >= best_before else -1
    return clip(temperature + rises * step)


def clip(temperature: float) -> float:
    """Bring a temperature into [0, 1]; rounded to 12 decimals, so that steps of 0.05 do not gather dust."""
    return round(min(max(temperature, 0.0), 1.0), 12)
