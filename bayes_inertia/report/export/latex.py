"""A table of the parameters for LaTeX (package booktabs)."""

from __future__ import annotations

from bayes_inertia.report.export.content import (
    ExportedParameter,
    ExportedResult,
    comment_lines,
    one_line,
    rounded,
)
from bayes_inertia.report.formatting import common_exponents

_ESCAPED = {c: f"\\{c}" for c in "&%$#_{}"} | {"\\": "/", "~": "-", "^": "-"}


def latex_text(result: ExportedResult) -> str:
    """A `tabular` of name, old, new with its uncertainty, unit, and change in prior sds."""
    powers = common_exponents({p.name: (p.unit, p.new, p.sd) for p in result.parameters})
    warned = [] if result.trusted else ["\\textbf{Do not use this result as it stands.}\\\\"]
    return "\n".join(
        [
            *(f"% {line}" for line in comment_lines(result, "needs \\usepackage{booktabs}")),
            *warned,
            "\\begin{tabular}{lrrlr}",
            "\\toprule",
            "parameter & before flight & estimate & unit & change [prior sd] \\\\",
            "\\midrule",
            *(_row(p, powers[p.name]) for p in result.parameters),
            "\\bottomrule",
            "\\end{tabular}",
            "",
        ]
    )


def _row(p: ExportedParameter, power: int) -> str:
    old, new, sd = (rounded(x / 10.0**power, p.sd / 10.0**power) for x in (p.old, p.new, p.sd))
    factor = f"$10^{{{power}}}$ " if power else ""
    unit = f"{factor}{p.unit.replace('^2', '$^2$')}".strip() or "--"
    change = f"${p.change / p.old_sd:+.2f}$" if p.old_sd > 0.0 else "--"
    return f"{_escaped(p.name)} & ${old}$ & ${new} \\pm {sd}$ & {unit} & {change} \\\\"


def _escaped(name: str) -> str:
    return "".join(_ESCAPED.get(c, c) for c in one_line(name))
