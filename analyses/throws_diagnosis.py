"""What disturbs the thrown bodies? Each effect of the library, shared by all throws or different in
each, judged on throws held out.

The plain model misses these data (TU Delft, arXiv 2503.13137) by far more than the gyro's noise.
Every configuration is
fitted with the likelihood discounted by each throw's own dispersion, linearised there, and each
candidate effect added:
with one set of parameters for all throws, or one for each. Two numbers judge it. The share of the
misfit is what its best
amplitudes take away of the squared residuals of ALL throws: that can only grow. The predictive gain
is how much more
probable each throw becomes when everything shared is learnt from the OTHER throws, and what is its
own is averaged over
its prior: that falls where an effect is not real or not shared. The best are then fitted in full,
one after the other.
A flexible mode's frequency is chosen with all throws, so that its gain is too large by a few units;
at the lowest frequency
tried (two periods a throw) it is no ringing but stands for anything slow.

    python analyses/throws_diagnosis.py [--data ../shared/data/delft]

writes `analyses/results/throws_diagnosis.md` and `.json` and `figures/throws_diagnosis.png`.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from scipy import linalg

from bayes_inertia.campaign.reader import read_campaign
from bayes_inertia.diagnosis.flexible_mode_search import (
    FlexibleModeCandidate,
    best_flexible_mode,
    frequencies,
    theta_with_mode,
)
from bayes_inertia.diagnosis.torque_response import torque_response
from bayes_inertia.files import write_atomically
from bayes_inertia.inference.laplace import Estimate, principal_sd
from bayes_inertia.inference.linearised_fit import LinearisedFit
from bayes_inertia.inference.objective import prior_rows
from bayes_inertia.inference.optimizer import estimate, move_to
from bayes_inertia.maths.inertia_tensor import principal_moments
from bayes_inertia.physics.effect import Effect
from bayes_inertia.physics.effects import LIBRARY, EachSlew
from bayes_inertia.physics.forward_model import Model
from bayes_inertia.report.pictures import style

HERE = Path(__file__).parent
CONFIGURATIONS = ("config_empty", "config_a", "proof_body", "device_only")
MOST = 3
FLEXIBLE = "flexible_mode"


@dataclass(frozen=True)
class Term:
    """One effect as columns (throws, numbers, k) in units of prior sd, shared by all throws or
    different in each.
    """

    effect: str
    shared: bool
    columns: np.ndarray

    @property
    def label(self) -> str:
        """How the table calls it."""
        return f"{self.effect}, {'shared' if self.shared else 'each throw'}"


@dataclass(frozen=True)
class Linear:
    """The base fit's linear model: residuals and columns by throw, and the prior rows of what all
    throws share.
    """

    residual: np.ndarray
    shared: np.ndarray
    local: np.ndarray
    local_at: np.ndarray
    precision: np.ndarray
    pull: np.ndarray

    @classmethod
    def of(cls, at: Estimate, fit: LinearisedFit) -> Linear:
        """From an estimate and its linearised fit; columns: of "measured minus predicted"."""
        slope, distance = (rows[at.free] for rows in prior_rows(at.model, at.theta))
        precision = np.concatenate([slope**2, np.ones(fit.n_shared - len(at.free))])
        pull = np.concatenate([slope * distance, at.point.bias])
        return cls(
            fit.residual,
            fit.shared,
            fit.local,
            at.point.local,
            precision,
            pull,
        )

    def misfit(self, terms: tuple[Term, ...]) -> float:
        """Squared residuals of all throws at the best amplitudes (priors hold them, but are not
        counted).
        """
        posterior = [self._messages(s, terms) for s in range(len(self.residual))]
        mean = -linalg.solve(
            sum(A for A, *_ in posterior) + np.diag(self._precision(terms)),
            sum(g for _, g, *_ in posterior) + self._pull(terms),
        )
        return float(
            sum(np.sum(self._left(s, terms, mean) ** 2) for s in range(len(self.residual)))
        )

    def predictive(self, terms: tuple[Term, ...]) -> np.ndarray:
        """Log density (throws,) of each throw given the others, up to a constant that all sets of
        terms share.
        """
        posterior = [self._messages(s, terms) for s in range(len(self.residual))]
        prior, pull = np.diag(self._precision(terms)), self._pull(terms)
        out = []
        for s, (A, g, value, logdet) in enumerate(posterior):
            others = sum(p[0] for k, p in enumerate(posterior) if k != s) + prior
            toward = sum(p[1] for k, p in enumerate(posterior) if k != s) + pull
            mean = -linalg.solve(others, toward, assume_a="pos")
            # The throw's own quadratic at the predicted mean, with the prediction's uncertainty
            # integrated out.
            slope = g + A @ mean
            height = value + g @ mean + 0.5 * mean @ A @ mean
            both = A + others
            out.append(
                -height
                + 0.5 * slope @ linalg.solve(both, slope, assume_a="pos")
                - 0.5 * (np.linalg.slogdet(both)[1] - np.linalg.slogdet(others)[1])
                - logdet
            )
        return np.array(out)

    def _precision(self, terms) -> np.ndarray:
        return np.concatenate(
            [self.precision, *(np.ones(t.columns.shape[-1]) for t in terms if t.shared)]
        )

    def _pull(self, terms) -> np.ndarray:
        return np.concatenate(
            [self.pull, *(np.zeros(t.columns.shape[-1]) for t in terms if t.shared)]
        )

    def _columns(self, s: int, terms) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        shared = np.concatenate([self.shared[s], *(t.columns[s] for t in terms if t.shared)], -1)
        own = np.concatenate([self.local[s], *(t.columns[s] for t in terms if not t.shared)], -1)
        at = np.concatenate(
            [self.local_at[s], *(np.zeros(t.columns.shape[-1]) for t in terms if not t.shared)]
        )
        return shared, own, at

    def _messages(self, s: int, terms) -> tuple[np.ndarray, np.ndarray, float, float]:
        """What throw s says of everything shared, its own unknowns integrated out: quadratic,
        slope, value, log determinant.
        """
        shared, own, at = self._columns(s, terms)
        r = self.residual[s]
        stiff = own.T @ own + np.eye(own.shape[-1])
        factor = linalg.cho_factor(stiff)
        across, gradient = own.T @ shared, own.T @ r + at
        A = shared.T @ shared - across.T @ linalg.cho_solve(factor, across)
        g = shared.T @ r - across.T @ linalg.cho_solve(factor, gradient)
        value = 0.5 * (r @ r + at @ at - gradient @ linalg.cho_solve(factor, gradient))
        return A, g, float(value), float(np.log(np.diag(factor[0])).sum())

    def _left(self, s: int, terms, mean: np.ndarray) -> np.ndarray:
        shared, own, at = self._columns(s, terms)
        r = self.residual[s] + shared @ mean
        return r - own @ linalg.solve(
            own.T @ own + np.eye(own.shape[-1]), own.T @ r + at, assume_a="pos"
        )


def ringing_of(at: Estimate, fit: LinearisedFit) -> tuple[FlexibleModeCandidate, str]:
    """The flexible mode that the residuals show best, and what the tables call it."""
    flexible, response = next(e for e in LIBRARY if e.name == FLEXIBLE), torque_response(at)
    ringing = best_flexible_mode(
        FLEXIBLE, response, fit, flexible.parameters(at.model.campaign)[0].priors[0].sd ** 2
    )
    lowest = np.isclose(ringing.frequency, frequencies(response)[0])
    return ringing, f"{FLEXIBLE}@{ringing.frequency:.3g} Hz{', lowest' if lowest else ''}"


def candidates(
    at: Estimate, fit: LinearisedFit, ringing: FlexibleModeCandidate, label: str
) -> list[Term]:
    """Every effect that leaves a trace here, shared and different in each throw."""
    space, terms = at.model.space, []
    for effect in at.model.effects:
        part = space.slice_of(effect.name)
        columns = fit.parameters[..., part] * space.sd[part]
        if columns.size and np.abs(columns).max() > 1e-6:
            terms += [Term(effect.name, shared, columns) for shared in (True, False)]
    return terms + [Term(label, shared, ringing.products) for shared in (True, False)]


def search(linear: Linear, terms: list[Term]) -> list[dict]:
    """Forward selection by what the throws held out say."""
    chosen: tuple[Term, ...] = ()
    base, steps = linear.predictive(()), []
    whole = linear.misfit(())
    while len(chosen) < MOST:
        trials = [t for t in terms if t.effect not in {c.effect for c in chosen}]
        gains = [linear.predictive((*chosen, t)) for t in trials]
        best = int(np.argmax([g.sum() for g in gains]))
        if gains[best].sum() < base.sum() + 3.0:
            break
        chosen, gained = (*chosen, trials[best]), gains[best] - base
        base = gains[best]
        steps.append(
            {
                "added": trials[best].label,
                "effect": trials[best].effect,
                "shared": trials[best].shared,
                "gain": float(gained.sum()),
                "throws_better": int((gained > 0).sum()),
                "explained": 1.0 - linear.misfit(chosen) / whole,
            }
        )
    return steps


def diagnose_configuration(folder: Path) -> dict:
    """Scores of every candidate, the forward selection, and full fits along it."""
    campaign = read_campaign(folder)
    base = estimate(Model(campaign, (), "measured"))
    usable = tuple(e for e in LIBRARY if e.name != FLEXIBLE and not e.needs)
    at = move_to(base, Model(campaign, usable, "measured"))
    fit = at.linearised()
    ringing, label = ringing_of(at, fit)
    linear, terms = Linear.of(at, fit), candidates(at, fit, ringing, label)
    whole, none = linear.misfit(()), linear.predictive(())
    rows = []
    for term in terms:
        gained = linear.predictive((term,)) - none
        rows.append(
            {
                "effect": term.effect,
                "shared": term.shared,
                "explained": 1.0 - linear.misfit((term,)) / whole,
                "gain": float(gained.sum()),
                "throws_better": int((gained > 0).sum()),
            }
        )
    steps = search(linear, terms)
    row = {
        "configuration": folder.name,
        "throws": len(campaign.slews),
        "candidates": sorted(rows, key=lambda r: -r["gain"]),
        "steps": steps,
        "fits": [_fitted("plain model", base), *_full_fits(campaign, base, steps, ringing)],
    }
    if (folder / "truth.json").is_file():
        truth = json.loads((folder / "truth.json").read_text())
        row |= {
            "truth": truth["principal_moments_kgm2"],
            "authors_percent": truth["authors_mean_principal_error_percent"],
        }
    return row


def _full_fits(
    campaign, base: Estimate, steps: list[dict], ringing: FlexibleModeCandidate
) -> list[dict]:
    """Fits with the chosen effects added one after the other, each from the one before."""
    library = {e.name: e for e in LIBRARY}
    fits, effects, before = [], (), base
    for step in steps:
        name = step["effect"].partition("@")[0]
        effect: Effect = library[name]
        if name == FLEXIBLE and not step["shared"]:
            break  # ten modes of ten frequencies: the linear gain says what they could bring
        if name == FLEXIBLE:
            effect = replace(effect, frequency=ringing.frequency)
        effects = (*effects, effect if step["shared"] else EachSlew.of(effect, campaign))
        begin = move_to(before, Model(campaign, effects, "measured"))
        before = estimate(
            begin.model, start=theta_with_mode(begin, ringing) if name == FLEXIBLE else begin.theta
        )
        fits.append(_fitted("+ " + step["added"], before))
    return fits


def _fitted(label: str, at: Estimate) -> dict:
    return {
        "fit": label,
        "reduced_chi2": at.tests["rate"].reduced_chi2,
        "explained": not any(t.too_large for t in at.tests.values()),
        "principal_moments": principal_moments(at.theta[:6]).tolist(),
        "robust_sd": principal_sd(at, at.robust_covariance).tolist(),
    }


def report(rows: list[dict]) -> str:
    """The tables, in Markdown."""
    lines = [
        "# What disturbs the thrown bodies?",
        "",
        *__doc__.split("\n\n")[1].splitlines(),
        "",
        "![Effects](../../figures/throws_diagnosis.png)",
        "",
    ]
    for row in rows:
        lines += [
            f"## {row['configuration']}, {row['throws']} throws",
            "",
            *_candidate_lines(row),
            "",
            *_fit_lines(row),
            "",
        ]
    return "\n".join(lines)


def _candidate_lines(row: dict) -> list[str]:
    lines = [
        "| effect | shared or each | misfit explained | gain, throws held out | throws better |",
        "|---|---|---|---|---|",
    ]
    for c in row["candidates"][:10]:
        whose, share = "shared" if c["shared"] else "each throw", f"{100 * c['explained']:.0f} %"
        lines.append(
            f"| {c['effect']} | {whose} | {share} | {c['gain']:+.1f} | "
            f"{c['throws_better']}/{row['throws']} |"
        )
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
    lines = [
        "| full fit | reduced chi² | explained | principal moments [10⁻⁶ kg m²] | robust sd | "
        "error | mean error |",
        "|---|---|---|---|---|---|---|",
    ]
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
        lines.append(f"| {' | '.join(cells)} |")
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
    """What each effect explains, shared and in each throw, and the errors of the principal moments
    as effects are added.
    """
    figure, cells = style.grid(
        7.4, 2, 2, left=2.0, right=0.25, top=0.75, bottom=0.5, gap_x=2.1, gap_y=0.75
    )
    known = [r for r in rows if "truth" in r]
    for k, row in enumerate(known[:2]):
        axes = figure.add_axes(cells[k])
        gains = {c["effect"]: 0.0 for c in row["candidates"] if c["shared"]}
        names = sorted(
            gains, key=lambda n: max(c["explained"] for c in row["candidates"] if c["effect"] == n)
        )[-7:]
        for shared, height, colour, hatch in (
            (True, 0.2, style.BLUE, ""),
            (False, -0.2, style.ORANGE, "///"),
        ):
            values = [
                next(
                    c["explained"]
                    for c in row["candidates"]
                    if c["effect"] == n and c["shared"] == shared
                )
                for n in names
            ]
            label = "one for all throws" if shared else "different in each throw"
            axes.barh(
                np.arange(len(names)) + height,
                100 * np.array(values),
                0.38,
                color=colour,
                hatch=hatch,
                edgecolor="white",
                label=label,
            )
        axes.set_yticks(range(len(names)), [n.replace("_", " ").replace("@", "\n") for n in names])
        axes.set(xlabel="misfit explained by this effect alone [%]", xlim=(0, 100))
        axes.set_title(f"{row['configuration']}, {row['throws']} throws")
        if k == 0:
            axes.legend(loc="lower right")
        axes = figure.add_axes(cells[2 + k])
        errors = np.array([_error(row, f) for f in row["fits"]])
        labels = [f["fit"].replace("_", " ") for f in row["fits"]]
        sd = 100 * np.array([f["robust_sd"] for f in row["fits"]]) / np.array(row["truth"])
        axes.axvspan(-1.0, 1.0, color=style.PALE, alpha=0.6, lw=0)
        axes.axvline(0.0, color=style.MUTED, lw=0.7)
        for i in range(3):
            at = np.arange(len(labels)) + 0.2 * (i - 1)
            axes.errorbar(
                errors[:, i],
                at,
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
        if k == 0:
            grey = Patch(fc=style.PALE, alpha=0.6, label="known to 1 %")
            axes.legend(
                handles=[*axes.get_legend_handles_labels()[0], grey],
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


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--data", type=Path, default=HERE.parents[1] / "shared" / "data" / "delft")
    parser.add_argument("--only", choices=CONFIGURATIONS)
    parser.add_argument("--draw", action="store_true", help="draw again what is in the results")
    arguments = parser.parse_args()
    if not arguments.data.is_dir():
        print("the throws are not here: skipped")
        return
    path = HERE / "results" / "throws_diagnosis.json"
    rows = json.loads(path.read_text()) if path.is_file() else []
    for name in () if arguments.draw else (arguments.only,) if arguments.only else CONFIGURATIONS:
        if not (arguments.data / name).is_dir():
            continue
        row = diagnose_configuration(arguments.data / name)
        rows = sorted(
            [r for r in rows if r["configuration"] != name] + [row],
            key=lambda r: CONFIGURATIONS.index(r["configuration"]),
        )
        write_atomically(path, json.dumps(rows, indent=1) + "\n")
        print(report([row]), flush=True)
    write_atomically(path.with_suffix(".md"), report(rows))
    picture(rows).savefig(HERE.parent / "figures" / "throws_diagnosis.png", dpi=130)


if __name__ == "__main__":
    main()
