"""Monte Carlo of Basilisk over what a fit left open: every run flies with a draw of its posterior.

    python docs/how_to/basilisk_dispersion.py RUN SCENARIO 1000

RUN is the folder of a finished fit; SCENARIO, a Python file, defines `create()`, which returns the
simulation, and `execute(simulation)`, as Basilisk's Monte Carlo controller asks. The spacecraft
must be the first model of the first task; else change HUB.
"""

from __future__ import annotations

import runpy
import sys
from pathlib import Path

import numpy as np

import bayes_inertia as bi

HUB = "TaskList[0].TaskModels[0].hub.IHubPntBc_B"
# Jxx, Jyy, Jzz, Jxy, Jxz, Jyz as a matrix.
PLACES = [[0, 3, 4], [3, 1, 5], [4, 5, 2]]


def hub_tensors(run: Path) -> np.ndarray:
    """Draws of J_locked (n, 3, 3) [kg m^2], which the hub is given; as wide as sds are quoted."""
    posterior = bi.Posterior.load(run / "posterior.nc")
    campaign = bi.read_campaign(run / "campaign")
    if posterior.quoted_factor is None:
        sys.exit(f"{run}: the result is not trusted, so nothing says how far J may be off")
    J = posterior.averaged_samples[:, PLACES]
    J = J.mean(0) + posterior.quoted_factor * (J - J.mean(0))
    if not campaign.inertia.includes_wheel_spin:
        J = J + sum(w.spin_inertia * np.outer(w.axis_B, w.axis_B) for w in campaign.wheels)
    moments = np.linalg.eigvalsh(J)  # In ascending order.
    return J[(moments[:, 0] > 0.0) & (moments[:, 0] + moments[:, 1] > moments[:, 2])]


class PosteriorDispersion:
    """The tensor of a run, as Basilisk asks a dispersion for it; the controller sets the seed."""

    def __init__(self, tensors: np.ndarray, name: str = HUB):
        self.tensors, self.name, self.drawn = tensors, name, 0

    def getName(self) -> str:
        return self.name

    def generate(self, sim: object = None) -> np.ndarray:
        self.drawn = np.random.randint(len(self.tensors))
        return self.tensors[self.drawn]

    def generateString(self, sim: object) -> str:
        return str(self.generate(sim).tolist())

    def generateMagString(self) -> str:
        return f"[draw {self.drawn}]"


def main(run: str, scenario: str, runs: str) -> None:
    """Fly the scenario."""
    try:
        from Basilisk.utilities.MonteCarlo.Controller import Controller
    except ImportError as error:
        sys.exit(f"Basilisk is not installed here ({error}): run this where your scenario runs")

    flown = runpy.run_path(scenario)
    controller = Controller()
    controller.setSimulationFunction(flown["create"])
    controller.setExecutionFunction(flown["execute"])
    controller.setExecutionCount(int(runs))
    controller.addDispersion(PosteriorDispersion(hub_tensors(Path(run))))
    controller.executeSimulations()


if __name__ == "__main__":
    if len(sys.argv) != 4:
        sys.exit(__doc__)
    main(*sys.argv[1:])
