"""The page and the picture of `throws_diagnosis.py`, from its rows."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from analyses.naming.throws_command import command_lines
from analyses.naming.throws_halves import halves_lines
from analyses.pages.table import table_lines
from bayes_inertia.report.pictures import style

_INTRODUCTION = (
    "The plain model misses these data (TU Delft, arXiv 2503.13137) by far more than the "
    "gyro's noise. Every configuration is",
    "fitted with the likelihood discounted by each throw's own dispersion, linearised there, "
    "and each candidate effect added:",
    "with one set of parameters for all throws, or one for each. Two numbers judge it. "
    "The share of the misfit is what its best",
    "amplitudes take away of the squared residuals of ALL throws: that can only grow. "
    "The predictive gain is how much more",
    "probable each throw becomes when everything shared is learnt from the OTHER throws, and "
    "what is its own is averaged over",
    "its prior: that falls where an effect is not real or not shared. "
    "The best are then fitted in full, one after the other.",
    "A flexible mode's frequency is chosen with all throws, so that its gain is too large by "
    "a few units; at the lowest frequency",
    "tried (two periods a throw) it is no ringing but stands for anything slow.",
)


def report(rows: list[dict]) -> str:
    """The tables, in Markdown."""
    lines = [
        "# Bodies thrown by hand: what disturbs them",
        "",
        *command_lines(rows),
        *halves_lines(rows),
        "## Each effect of the library, judged on throws held out",
        "",
        *_INTRODUCTION,
        "",
        "![Effects](../../../figures/throws_diagnosis.png)",
        "",
    ]
    for row in rows:
        lines += [
            f"### {row['configuration']}, {row['throws']} throws",
            "",
            *_candidate_lines(row),
            "",
            *_fit_lines(row),
            "",
        ]
    return "\n".join(lines)


def _candidate_lines(row: dict) -> list[str]:
    columns = (
        "effect",
        "shared or each",
        "misfit explained",
        "gain, throws held out",
        "throws better",
    )
    cells = [
        (
            c["effect"],
            "shared" if c["shared"] else "each throw",
            f"{100 * c['explained']:.0f} %",
            f"{c['gain']:+.1f}",
            f"{c['throws_better']}/{row['throws']}",
        )
        for c in row["candidates"][:10]
    ]
    lines = table_lines(columns, cells)
    lines += ["", "Added one after the other, by what the throws held out say:", ""]
    for s in row["steps"]:
        better = f"better in {s['throws_better']} of {row['throws']} throws"
        lines.append(
            f"- {s['added']}: gain {s['gain']:+.1f}, {better}, misfit explained so far "
            f"{100 * s['explained']:.0f} %"
        )
    return (
        lines
        if row["steps"]
        else [*lines, "- nothing: no effect predicts the throws held out better"]
    )


def _fit_lines(row: dict) -> list[str]:
    columns = (
        "full fit",
        "reduced chi²",
        "explained",
        "principal moments [10⁻⁶ kg m²]",
        "robust sd",
        "error",
        "mean error",
    )
    rows = []
    for f in row["fits"]:
        cells = [f["fit"], f"{f['reduced_chi2']:.2f}", "yes" if f["explained"] else "no"]
        cells += [
            ", ".join(f"{1e6 * x:.1f}" for x in f[key])
            for key in ("principal_moments", "robust_sd")
        ]
        error = _error(row, f)
        cells += (
            ["-", "-"]
            if error is None
            else [", ".join(f"{e:+.2f} %" for e in error), f"{np.abs(error).mean():.2f} %"]
        )
        rows.append(cells)
    lines = table_lines(columns, rows)
    if "truth" in row:
        truth = ", ".join(f"{1e6 * x:.1f}" for x in row["truth"])
        lines += [
            "",
            f"Truth {truth} (known to about 1 %); the authors' estimator, mean of single throws: "
            f"{row['authors_percent']} %.",
        ]
    return lines


def _error(row: dict, fit: dict) -> np.ndarray | None:
    """Errors of the principal moments [%], None where the truth is not known."""
    return (
        100.0 * (np.array(fit["principal_moments"]) / np.array(row["truth"]) - 1.0)
        if "truth" in row
        else None
    )


@style.styled
def picture(rows: list[dict]) -> Figure:
    """What each effect explains, and the errors of the principal moments as effects are added.

    One column a configuration whose truth is known.
    """
    figure, cells = style.grid(
        7.4, 2, 2, left=2.0, right=0.25, top=0.75, bottom=0.5, gap_x=2.1, gap_y=0.75
    )
    known = [row for row in rows if "truth" in row]
    for k, row in enumerate(known[:2]):
        effects, errors = figure.add_axes(cells[k]), figure.add_axes(cells[2 + k])
        _draw_effects(effects, row)
        _draw_errors(errors, row)
        if k == 0:
            effects.legend(loc="lower right")
            grey = Patch(fc=style.PALE, alpha=0.6, label="known to 1 %")
            errors.legend(
                handles=[*errors.get_legend_handles_labels()[0], grey],
                loc="lower left",
                bbox_to_anchor=(-0.02, 1.0),
                ncols=4,
                columnspacing=1.2,
            )
    figure.text(
        0.02,
        0.965,
        "What disturbs bodies thrown by hand, and what leaving it out does to their moments of "
        "inertia",
        fontsize=11,
    )
    return figure


def _draw_effects(axes, row: dict) -> None:
    """Share of the misfit that each of the seven best effects explains alone."""
    explained = {(c["effect"], c["shared"]): c["explained"] for c in row["candidates"]}
    effects = {c["effect"]: None for c in row["candidates"] if c["shared"]}
    best = sorted(effects, key=lambda e: max(explained[e, True], explained[e, False]))[-7:]
    for shared, offset, colour, hatch in (
        (True, 0.2, style.BLUE, ""),
        (False, -0.2, style.ORANGE, "///"),
    ):
        axes.barh(
            np.arange(len(best)) + offset,
            100 * np.array([explained[effect, shared] for effect in best]),
            0.38,
            color=colour,
            hatch=hatch,
            edgecolor="white",
            label="one for all throws" if shared else "different in each throw",
        )
    axes.set_yticks(range(len(best)), [e.replace("_", " ").replace("@", "\n") for e in best])
    axes.set(xlabel="misfit explained by this effect alone [%]", xlim=(0, 100))
    axes.set_title(f"{row['configuration']}, {row['throws']} throws")


def _draw_errors(axes, row: dict) -> None:
    """Errors of the principal moments, fit by fit."""
    errors = np.array([_error(row, f) for f in row["fits"]])
    labels = [f["fit"].replace("_", " ") for f in row["fits"]]
    sd = 100 * np.array([f["robust_sd"] for f in row["fits"]]) / np.array(row["truth"])
    axes.axvspan(-1.0, 1.0, color=style.PALE, alpha=0.6, lw=0)
    axes.axvline(0.0, color=style.MUTED, lw=0.7)
    for i in range(3):
        axes.errorbar(
            errors[:, i],
            np.arange(len(labels)) + 0.2 * (i - 1),
            xerr=sd[:, i],
            fmt=style.MARKERS[i],
            color=style.color(i),
            ms=5,
            capsize=2,
            ls="none",
            label=f"I{i + 1}",
        )
    axes.set_yticks(range(len(labels)), labels)
    axes.invert_yaxis()
    axes.set(xlabel="error of the principal moments [%], one robust sd")
