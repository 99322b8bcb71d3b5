"""The section of a fit's report that shows effects without a fixed shape over time."""

from __future__ import annotations

import numpy as np

from bayes_inertia.inference.posterior import Posterior
from bayes_inertia.report.formatting import plain
from bayes_inertia.report.pictures.equivalent_signal import draw_signal
from bayes_inertia.report.pictures.posterior_data import values_of
from bayes_inertia.report.section import Picture, Section

_TEMPLATE = (
    "<p>These have no fixed shape: in each slew they are free to be what the data ask for. "
    "What they may have done is taken from the information on J and K. "
    "Where a band holds zero, nothing is missing there.</p>"
)


def signals_section(posterior: Posterior) -> Section | None:
    """Torques and errors of free shape over time, slew by slew.

    Parameters
    ----------
    posterior : Posterior
        A finished fit.

    Returns
    -------
    Section or None
        One picture an effect; None where all effects have a fixed shape.
    """
    if "signal" not in posterior.tree:
        return None
    pictures = tuple(_picture(posterior, str(name)) for name in posterior.tree["signal"].data_vars)
    return Section("What has no fixed shape", _TEMPLATE, {}, pictures)


def _picture(posterior: Posterior, name: str) -> Picture:
    """One effect: mean and band over time."""
    draws = values_of(posterior, "signal", name)
    variable = posterior.tree["signal"][name]
    # Files of version 0.3 and before do not name their signals.
    title = variable.attrs.get("long_name", plain(name))
    signal = {
        "time": values_of(posterior, "constant_data", "signal_time"),
        "mean": draws.mean((0, 1)),
        "sd": draws.std((0, 1)),
        "slews": [str(slew) for slew in values_of(posterior, "estimate", "slew")],
        "components": [str(c) for c in np.asarray(variable[f"{name}_component"])],
        "unit": variable.attrs["units"],
        "source": variable.attrs.get("quantity", plain(name)),
    }
    caption = (
        f"{title[0].upper()}{title[1:]}: mean (lines) and ±2 sd (bands) of the posterior, "
        "sizes included that the data leave open."
    )
    figure = draw_signal(signal, whole_band=True)
    return Picture(figure, caption, f"{title} over time, slew by slew")
