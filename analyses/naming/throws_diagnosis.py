"""What disturbs the thrown bodies? Each effect of the library, judged on throws held out.

    python -m analyses.naming.throws_diagnosis [--data ../shared/data/delft] [--only NAME] [--draw]
    python -m analyses.naming.throws_diagnosis --command [--only NAME]
    python -m analyses.naming.throws_diagnosis --halves [--only NAME]

writes `results/naming/throws_diagnosis.md` and `.json` and `figures/throws_diagnosis.png`.

The plain model misses these data (TU Delft, arXiv 2503.13137) by far more than the gyro's noise.
Every configuration is fitted with the likelihood discounted by each throw's dispersion and
linearised there. Each candidate effect is added with one set of parameters for all throws, or one
for each. Two numbers judge it (`throws_linear`):

- the share of the misfit that its best amplitudes explain, of the squared residuals of ALL throws:
  that can only grow;
- the predictive gain: how much more probable each throw becomes when everything shared is learnt
  from the OTHER throws, and its own unknowns are averaged over their prior. That falls where an
  effect is not real or not shared.

The best are then fitted in full, one after the other. A flexible mode's frequency is chosen with
all throws: its gain is too large by a few units. At the lowest frequency tried (two periods a
throw) it is no ringing but stands for anything slow.

With `--command` the command itself is run on each configuration (`throws_command`); the page begins
with what it says. With `--halves` each half of the throws is diagnosed alone (`throws_halves`).
"""

from __future__ import annotations

import argparse
import json
from dataclasses import replace
from pathlib import Path

import numpy as np

from analyses import results_of
from analyses.naming.throws_command import command_row
from analyses.naming.throws_halves import halves_of
from analyses.naming.throws_linear import LinearThrows, Term, scores, search
from analyses.naming.throws_page import picture, report
from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.reader import read_campaign
from bayes_inertia.diagnosis.candidates import (
    FlexibleModeCandidate,
    best_flexible_mode,
    frequencies,
    theta_with_mode,
)
from bayes_inertia.diagnosis.torque_response import torque_response
from bayes_inertia.files import write_atomically
from bayes_inertia.inference import optimizer
from bayes_inertia.inference.laplace import Estimate, principal_sd
from bayes_inertia.inference.linearised_fit import LinearisedFit
from bayes_inertia.maths.inertia_tensor import principal_moments
from bayes_inertia.physics.effect import Effect
from bayes_inertia.physics.effects import LIBRARY, EachSlew, FlexibleMode
from bayes_inertia.physics.forward_model import Model

ROOT = Path(__file__).parents[2]
CONFIGURATIONS = ("config_empty", "config_a", "proof_body", "device_only")
FLEXIBLE = "flexible_mode"


def best_mode(estimate: Estimate, fit: LinearisedFit) -> tuple[FlexibleModeCandidate, str]:
    """The flexible mode that the residuals show best, and what the tables call it."""
    flexible, response = next(e for e in LIBRARY if e.name == FLEXIBLE), torque_response(estimate)
    prior = flexible.parameters(estimate.model.campaign)[0].priors[0]
    mode = best_flexible_mode(FLEXIBLE, response, fit, prior.sd**2)
    lowest = np.isclose(mode.frequency, frequencies(response)[0])
    return mode, f"{FLEXIBLE}@{mode.frequency:.3g} Hz{', lowest' if lowest else ''}"


def candidates(
    estimate: Estimate, fit: LinearisedFit, mode: FlexibleModeCandidate, label: str
) -> list[Term]:
    """Every effect that leaves a trace here, shared and different in each throw."""
    space, terms = estimate.model.space, []
    for effect in estimate.model.effects:
        part = space.slice_of(effect.name)
        columns = fit.parameters[..., part] * space.sd[part]
        if columns.size and np.abs(columns).max() > 1e-6:
            terms += [Term(effect.name, shared, columns) for shared in (True, False)]
    return terms + [Term(label, shared, mode.products) for shared in (True, False)]


def diagnose_configuration(folder: Path) -> dict:
    """Scores of every candidate, the forward selection, and full fits along it."""
    campaign = read_campaign(folder)
    plain = optimizer.estimate(Model(campaign, (), "measured"))
    usable = tuple(e for e in LIBRARY if e.name != FLEXIBLE and not e.needs)
    with_effects = optimizer.move_to(plain, Model(campaign, usable, "measured"))
    fit = with_effects.linearised()
    mode, label = best_mode(with_effects, fit)
    linear, terms = LinearThrows.of(with_effects, fit), candidates(with_effects, fit, mode, label)
    steps = search(linear, terms)
    row = {
        "configuration": folder.name,
        "throws": len(campaign.slews),
        "candidates": scores(linear, terms),
        "steps": steps,
        "fits": [_fitted("plain model", plain), *_full_fits(campaign, plain, steps, mode)],
    }
    if (folder / "truth.json").is_file():
        truth = json.loads((folder / "truth.json").read_text())
        row |= {
            "truth": truth["principal_moments_kgm2"],
            "authors_percent": truth["authors_mean_principal_error_percent"],
        }
    return row


def _full_fits(
    campaign: Campaign, plain: Estimate, steps: list[dict], mode: FlexibleModeCandidate
) -> list[dict]:
    """Fits with the chosen effects added one after the other, each from the one before."""
    library = {e.name: e for e in LIBRARY}
    fits: list[dict] = []
    effects: tuple[Effect, ...] = ()
    estimate = plain
    for step in steps:
        effect = library[step["effect"].partition("@")[0]]
        if isinstance(effect, FlexibleMode):
            if not step["shared"]:
                break  # ten modes of ten frequencies: the linear gain says what they could bring
            effect = replace(effect, frequency=mode.frequency)
        effects = (*effects, effect if step["shared"] else EachSlew.of(effect, campaign))
        moved = optimizer.move_to(estimate, Model(campaign, effects, "measured"))
        start = theta_with_mode(moved, mode) if effect.name == FLEXIBLE else moved.theta
        estimate = optimizer.estimate(moved.model, start=start)
        fits.append(_fitted("+ " + step["added"], estimate))
    return fits


def _fitted(label: str, estimate: Estimate) -> dict:
    return {
        "fit": label,
        "reduced_chi2": estimate.tests["rate"].reduced_chi2,
        "explained": not any(t.too_large for t in estimate.tests.values()),
        "principal_moments": principal_moments(estimate.theta[:6]).tolist(),
        "robust_sd": principal_sd(estimate, estimate.robust_covariance).tolist(),
    }


def main() -> None:
    """Diagnose what is asked for; write rows, page and picture."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--data", type=Path, default=ROOT.parent / "shared" / "data" / "delft")
    parser.add_argument("--only", choices=CONFIGURATIONS)
    parser.add_argument("--command", action="store_true", help="run the command on each body")
    parser.add_argument("--halves", action="store_true", help="diagnose halves of the throws")
    parser.add_argument("--draw", action="store_true", help="draw again what is in the results")
    arguments = parser.parse_args()
    if not arguments.data.is_dir():
        print("the throws are not here: skipped")
        return
    path = results_of(__file__) / "throws_diagnosis.json"
    rows = json.loads(path.read_text()) if path.is_file() else []
    known = {row["configuration"]: row for row in rows}
    wanted = (arguments.only,) if arguments.only else CONFIGURATIONS
    for name in () if arguments.draw else wanted:
        folder = arguments.data / name
        if not folder.is_dir():
            continue
        row = known.get(name, {})
        if arguments.command and row:
            row["command"] = command_row(folder)
        elif arguments.halves and row:
            row["halves"] = halves_of(folder)
        else:
            kept = {key: row[key] for key in ("command", "halves") if key in row}
            row = diagnose_configuration(folder) | kept
        known[name] = row
        rows = [known[n] for n in CONFIGURATIONS if n in known]
        write_atomically(path, json.dumps(rows, indent=1) + "\n")
        print(report([row]), flush=True)
    write_atomically(path.with_suffix(".md"), report(rows))
    picture(rows).savefig(ROOT / "figures" / "throws_diagnosis.png", dpi=130)


if __name__ == "__main__":
    main()
