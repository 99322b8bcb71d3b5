"""What the first pages show: the example fitted, and a hidden dipole found.

    python analyses/first_screen.py [--work FOLDER]

runs `fit` on the example campaign, `fit` and `diagnose` on `tests/data/hidden_dipole` (three slews
of another simulator, Basilisk, with a magnetic dipole that the campaign does not state), and writes
`results/first_screen.json` and `figures/hidden_dipole.svg`. Some minutes. Without runs,
`--picture` draws from the result that is there.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from page_figures import save_svg

from bayes_inertia.files import write_atomically
from bayes_inertia.report.pictures import style

ROOT = Path(__file__).parents[1]
RESULT = ROOT / "analyses" / "results" / "first_screen.json"
EXAMPLE, HIDDEN = ROOT / "bayes_inertia" / "example", ROOT / "tests" / "data" / "hidden_dipole"
NAMES = ("Jxx", "Jyy", "Jzz", "Jxy", "Jxz", "Jyz", "K1", "K2", "K3")


def run(command: str, campaign: Path, out: Path) -> str:
    """Run a command as a user does, unless its run is there; what it prints."""
    said = out.with_suffix(".txt")
    if not said.is_file():
        words = [sys.executable, "-c", "from bayes_inertia.app.cli import main; main()", command]
        words += [str(campaign), "-o", str(out), "--seed", "1"]
        done = subprocess.run(words, capture_output=True, text=True)
        if done.returncode not in (0, 3):
            raise RuntimeError(done.stderr)
        said.write_text(done.stdout, encoding="utf-8")
    return said.read_text(encoding="utf-8")


def truth_of(campaign: Path) -> np.ndarray:
    """J (six elements) and K of `truth.json`."""
    truth = json.loads((campaign / "truth.json").read_text())
    J = np.array(truth["J_kgm2"])
    return np.array([*J.diagonal(), J[0, 1], J[0, 2], J[1, 2], *truth["K"]])


def fit_of(out: Path, truth: np.ndarray) -> dict:
    """Errors and sds of J and K, and how well the model explains the data."""
    summary = json.loads((out / "summary.json").read_text())
    parameters = [summary["parameters"][name] for name in NAMES]
    return {
        "trusted": summary["trusted"],
        "error": [p["mean"] - t for p, t in zip(parameters, truth, strict=True)],
        "sd": [p["quoted_sd"] or p["sd"] for p in parameters],
        "quoted_sd": [p["quoted_sd"] for p in parameters],
        "reduced_chi2": summary["fit"]["reduced_chi2"]["total"],
    }


def residuals(diagnosis: dict) -> dict:
    """Mean residuals of the rate sensor in short bins, of the slew and axis that misfit most."""
    channels = {k: diagnosis["pictures"][k]["channels"]["rate"] for k in ("before", "after")}
    shift = {key: np.array(of["shift"], dtype=float) for key, of in channels.items()}
    misfit = np.mean(shift["before"] ** 2, axis=2)
    slew, axis = np.unravel_index(np.argmax(misfit), misfit.shape)
    return {
        "slew": diagnosis["pictures"]["before"]["slews"][slew],
        "axis": "xyz"[axis],
        "edges": channels["before"]["edges"][slew],
        "before": shift["before"][slew, axis].tolist(),
        "after": shift["after"][slew, axis].tolist(),
    }


def excerpt(said: str) -> str:
    """What a command prints, without the details of its gates and the name of its folder."""
    lines = [line.rstrip() for line in said.splitlines()]
    return "\n".join(line.split(" in /")[0] for line in lines).strip()


def hidden_result(work: Path) -> dict:
    """Both fits of the campaign that hides a dipole, and what the diagnosis says."""
    run("fit", HIDDEN, work / "fit")
    terminal = run("diagnose", HIDDEN, work / "diagnosis")
    diagnosis = json.loads((work / "diagnosis" / "diagnosis.json").read_text())
    truth = truth_of(HIDDEN)
    return {
        "named": diagnosis["named"],
        "probability": diagnosis["hypotheses"][0]["probability"],
        "before": fit_of(work / "fit", truth),
        "after": fit_of(work / "diagnosis", truth),
        "correction_slew": diagnosis["correction_slew"],
        "residuals": residuals(diagnosis),
        "terminal": excerpt(terminal),
    }


@style.styled
def picture(hidden: dict) -> Figure:
    """Residuals of one axis, and the errors of J, before and after the dipole is named."""
    figure = Figure(figsize=(7.0, 3.0), layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=(1.15, 1.0))
    _draw_residuals(left, hidden["residuals"])
    _draw_errors(right, hidden["before"], hidden["after"])
    right.legend(*left.get_legend_handles_labels(), loc="lower right")
    return figure


def _draw_residuals(axes, found: dict) -> None:
    edges = np.array(found["edges"])
    middle = 0.5 * (edges[1:] + edges[:-1])
    axes.axhspan(-2, 2, color=style.PALE, alpha=0.6, lw=0)
    for key, (label, color, marker) in _LOOKS.items():
        axes.plot(middle, found[key], color=color, marker=marker, ms=3.5, label=label)
    axes.set(xlabel="time in the slew [s]", ylabel=f"residual, axis {found['axis']} [sd]")
    axes.set_title(f"Rate sensor, {found['slew']} (grey: noise)")


def _draw_errors(axes, before: dict, after: dict) -> None:
    places = np.arange(6)
    axes.axhline(0.0, color=style.INK, lw=0.8)
    for shift, fit, key in ((-0.13, before, "before"), (0.13, after, "after")):
        _, color, marker = _LOOKS[key]
        error, sd = (1e3 * np.array(fit[name][:6]) for name in ("error", "sd"))
        axes.errorbar(places + shift, error, 1.645 * sd, fmt=marker, color=color, ms=4.5, capsize=2)
    axes.set_xticks(places, NAMES[:6])
    axes.set_ylabel("estimate − truth [10⁻³ kg m²]")
    axes.set_title("J, 90 % intervals")


_LOOKS = {
    "before": ("without the dipole", style.VERMILLION, "s"),
    "after": ("with the dipole", style.BLUE, "o"),
}


def main() -> None:
    """Run the commands, write the result, draw."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--work", type=Path, help="keep runs here, and take those that are there")
    parser.add_argument("--picture", action="store_true", help="draw the result that is there")
    options = parser.parse_args()
    if not options.picture:
        with tempfile.TemporaryDirectory() as scratch:
            work = options.work or Path(scratch)
            terminal = excerpt(run("fit", EXAMPLE, work / "example"))
            example = fit_of(work / "example", truth_of(EXAMPLE)) | {"terminal": terminal}
            result = {"example": example, "hidden": hidden_result(work)}
        write_atomically(RESULT, json.dumps(result, indent=1, ensure_ascii=False) + "\n")
    save_svg(picture(json.loads(RESULT.read_text(encoding="utf-8"))["hidden"]), "hidden_dipole")


if __name__ == "__main__":
    main()
