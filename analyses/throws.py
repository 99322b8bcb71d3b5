"""Real hardware: bodies of known inertia thrown by hand, without an attitude reference.

    python analyses/throws.py [--data ../shared/data/delft]

writes `analyses/results/throws.md` and `throws.json`.

The telemetry of gyro and one reaction wheel (TU Delft, arXiv 2503.13137) is read where it lies
beside the project and is not part of it. Every configuration is fitted jointly over its throws from
its rough prior. Principal moments are compared with the truth (CAD and calibration, about 1 %) and
with the authors' per-throw errors. The model does not explain these data: the result says so, and
the robust uncertainty is what counts.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np

from bayes_inertia.campaign.reader import read_campaign
from bayes_inertia.files import write_atomically
from bayes_inertia.inference import optimizer
from bayes_inertia.inference.laplace import principal_sd
from bayes_inertia.maths.inertia_tensor import principal_moments
from bayes_inertia.physics.forward_model import Model

HERE = Path(__file__).parent
_HEADINGS = (
    "configuration",
    "throws",
    "reduced chi²",
    "explained",
    "moment",
    "prior",
    "estimate",
    "sd",
    "robust sd",
    "truth",
    "error",
    "in robust sd",
    "authors, mean per throw",
)
CONFIGURATIONS = ("config_empty", "config_a", "proof_body", "device_only")


def fit_configuration(folder: Path) -> dict:
    """Joint fit of one configuration: principal moments with both uncertainties.

    And the truth where it is known.
    """
    model = Model(read_campaign(folder), (), "measured")
    estimate = optimizer.estimate(model)
    row = {
        "configuration": folder.name,
        "throws": model.n_slews,
        "starts_agreeing": list(estimate.starts),
        "reduced_chi2": estimate.tests["rate"].reduced_chi2,
        "explained": not any(test.too_large for test in estimate.tests.values()),
        "principal_moments": principal_moments(estimate.theta[:6]).tolist(),
        "sd": principal_sd(estimate, estimate.covariance).tolist(),
        "robust_sd": principal_sd(estimate, estimate.robust_covariance).tolist(),
        "prior_principal_moments": np.linalg.eigvalsh(model.campaign.inertia.tensor).tolist(),
    }
    if (folder / "truth.json").is_file():
        truth = json.loads((folder / "truth.json").read_text())
        row |= {
            "truth": truth["principal_moments_kgm2"],
            "authors_percent": truth["authors_mean_principal_error_percent"],
        }
    return row


def report(rows: list[dict]) -> str:
    """The table, in Markdown."""
    lines = [
        "# Bodies thrown by hand: one fit of all throws",
        "",
        "Principal moments in 10⁻⁶ kg m². The error is against a truth that is itself known to "
        "about 1 %; sigmas count the robust sd alone.",
        "",
        "| " + " | ".join(_HEADINGS) + " |",
        "|" + "---|" * len(_HEADINGS),
    ]
    for row in rows:
        lines += [_moment_row(row, i) for i in range(len(row["principal_moments"]))]
    known = [r for r in rows if "truth" in r]
    for row in known:
        mean = np.mean(np.abs(np.array(row["principal_moments"]) / np.array(row["truth"]) - 1.0))
        lines += [
            "",
            f"{row['configuration']}: mean error of the three principal moments {100 * mean:.2f} % "
            f"(authors, per throw: {row['authors_percent']} %).",
        ]
    return "\n".join(lines) + "\n"


def _moment_row(row: dict, i: int) -> str:
    """Principal moment i of a configuration; the first row says what holds for all three."""
    known, first = "truth" in row, i == 0
    common = [
        row["configuration"],
        str(row["throws"]),
        f"{row['reduced_chi2']:.1f}",
        "yes" if row["explained"] else "no",
    ]
    against_truth = ["–"] * 3
    if known:
        error = row["principal_moments"][i] - row["truth"][i]
        against_truth = [
            f"{1e6 * row['truth'][i]:.1f}",
            f"{100 * error / row['truth'][i]:+.2f} %",
            f"{error / row['robust_sd'][i]:+.1f}",
        ]
    cells = [
        *(common if first else [""] * len(common)),
        f"I{i + 1}",
        *(f"{1e6 * row[key][i]:.1f}" for key in ("prior_principal_moments", "principal_moments")),
        *(f"{1e6 * row[key][i]:.2f}" for key in ("sd", "robust_sd")),
        *against_truth,
        f"{row['authors_percent']} %" if known and first else "",
    ]
    return "| " + " | ".join(cells) + " |"


def main() -> None:
    """Fit all configurations; write rows and page."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--data", type=Path, default=HERE.parents[1] / "shared" / "data" / "delft")
    folder = parser.parse_args().data
    if not folder.is_dir():
        print("the throws are not here: skipped")
        return
    rows = [fit_configuration(folder / name) for name in CONFIGURATIONS if (folder / name).is_dir()]
    write_atomically(HERE / "results" / "throws.json", json.dumps(rows, indent=1) + "\n")
    write_atomically(HERE / "results" / "throws.md", report(rows))
    print(report(rows))


if __name__ == "__main__":
    main()
