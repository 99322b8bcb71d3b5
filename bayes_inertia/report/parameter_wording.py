"""What a parameter is, which others it trades against, and what J and K are averaged over."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from bayes_inertia.report.formatting import listed, plain

# Beyond it two parameters are said to be hard to tell apart.
STRONG_CORRELATION = 0.9


def meaning(name: str) -> str:
    """What a parameter is.

    Examples
    --------
    >>> meaning("Jxy"), meaning("K2"), meaning("wheel_friction.coulomb1")
    ('inertia tensor element xy', 'rate-sensor scale factor, axis 2', 'wheel friction: coulomb1')
    """
    if name[:1] == "J" and len(name) == 3:
        if name[1] == name[2]:
            return f"moment of inertia, body {name[1]}"
        return f"inertia tensor element {name[1:]}"
    if name[:1] == "K" and name[1:].isdigit():
        return f"rate-sensor scale factor, axis {name[1:]}"
    return plain(name)


def correlation_sentences(names: Sequence[str], matrix: Sequence[Sequence[float]]) -> list[str]:
    """Sentences on pairs of parameters that the data determine only together.

    Returns: one for each strongly correlated pair, the strongest first.

    Examples
    --------
    >>> correlation_sentences(["Jxx", "K1"], [[1.0, -0.95], [-0.95, 1.0]])[0][:59]
    'Jxx and K1 are hard to tell apart (correlation −0.95): rais'
    """
    pairs = [
        (matrix[i][j], names[j], name)
        for i, name in enumerate(names)
        for j in range(i)
        if abs(matrix[i][j]) > STRONG_CORRELATION
    ]
    sentences = []
    for correlation, first, second in sorted(pairs, key=lambda pair: -abs(pair[0])):
        trade = (
            "raising one while lowering the other"
            if correlation < 0
            else "raising or lowering both together"
        )
        sentences.append(
            f"{first} and {second} are hard to tell apart "
            f"(correlation {_correlation_text(correlation)}): {trade} fits nearly as well."
        )
    return sentences


def _correlation_text(correlation: float) -> str:
    """Two decimals, three where it is close to one, with its sign."""
    sign, size = "−" if correlation < 0 else "+", abs(correlation)
    if size > 0.999:
        return f"beyond {sign}0.999"
    return f"{sign}{size:.{2 if size < 0.985 else 3}f}"


# Of what J and K are averaged over so many cases are listed; the rest are summed up.
_MOST_CASES = 5


def averaged_over(summary: Mapping[str, Any]) -> str:
    """The effects that J and K are averaged over, with their probabilities.

    Returns: A list; empty where J and K are not averaged.

    Examples
    --------
    >>> averaged_over({"averaged_over": [
    ...     {"effects": ["rate_bias", "a_b"], "probability": 0.7},
    ...     {"effects": ["rate_bias", "c"], "probability": 0.3}]})
    'a b 70 %, c 30 %'
    >>> averaged_over({"averaged_over": [
    ...     {"effects": [], "probability": 0.9}, {"effects": ["c"], "probability": 0.1}]})
    'nothing more 90 %, c 10 %'
    """
    rows = summary.get("averaged_over", [])
    in_all = set.intersection(*(set(row["effects"]) for row in rows)) if rows else set()
    cases = [
        (
            listed([plain(name) for name in row["effects"] if name not in in_all]),
            row["probability"],
        )
        for row in rows
    ]
    by_size = [cases[0], *sorted(cases[1:], key=lambda case: -case[1])] if cases else []
    if len(by_size) > _MOST_CASES:
        rest = sum(probability for _, probability in by_size[_MOST_CASES - 1 :])
        by_size = [*by_size[: _MOST_CASES - 1], ("others", rest)]
    return ", ".join(
        f"{effects or 'nothing more'} {100.0 * probability:.0f} %"
        for effects, probability in by_size
    )
