"""The section of a report that says how to make the same result again."""

from __future__ import annotations

from bayes_inertia.inference.posterior import Posterior
from bayes_inertia.report.formatting import listed
from bayes_inertia.report.pictures.posterior_data import n_ensembles, n_slews
from bayes_inertia.report.section import Section, packaged

_DRIVE_TEXT = {
    "commanded": "commanded: torque commands are the input",
    "measured": "measured: wheel momentum is the input",
}


def settings_section(posterior: Posterior) -> Section:
    """Settings that make the same result again."""
    return Section("Settings", packaged("settings.html"), {"rows": settings_rows(posterior)})


def settings_rows(posterior: Posterior) -> list[tuple[str, str]]:
    """Inputs and settings of a fit."""
    attributes, chains = posterior.attributes, posterior.tree["posterior"].sizes["chain"]
    diagnostics, ensembles = attributes["diagnostics"], n_ensembles(posterior)
    names = [tie["device"] for tie in attributes.get("scale_of_J", []) if tie["device"] != "wheels"]
    devices = [("devices beside wheels", listed(names))] if names else []
    if reference := attributes.get("frame_reference"):
        devices.append(("reference of frames", f"{reference}: its axes are the body's"))
    walkers = attributes.get("walkers") or chains // ensembles
    versions = (f"{name} {version}" for name, version in attributes["versions"].items())
    return [
        ("campaign", attributes["campaign"]),
        ("campaign digest (SHA-256)", attributes["campaign_sha256"] or "not recorded"),
        (
            "slews, data",
            f"{n_slews(posterior)} slews, {attributes['fit']['n_data']:,} numbers",
        ),
        ("drive", _DRIVE_TEXT[attributes["drive"]]),
        *devices,
        ("effects fitted along", listed(attributes["effects"]) or "none"),
        ("seed", str(attributes["seed"])),
        (
            "sampler",
            f"{ensembles} ensembles of {walkers} walkers, "
            f"{diagnostics['steps']} steps, the first {diagnostics['discarded']} discarded",
        ),
        ("versions", ", ".join(versions)),
    ]
