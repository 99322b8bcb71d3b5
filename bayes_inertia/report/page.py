"""The page: sections, style sheet, scripts and pictures in one offline HTML file."""

from __future__ import annotations

import base64
import hashlib
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from jinja2 import Environment, StrictUndefined
from markupsafe import Markup

from bayes_inertia.files import write_atomically
from bayes_inertia.inference.posterior import Posterior
from bayes_inertia.report.column_labels import with_column_labels
from bayes_inertia.report.fit_sections import standard_sections
from bayes_inertia.report.section import Section, data_uri, packaged


def render(posterior: Posterior, sections: Sequence[Section] | None = None) -> str:
    """The report of a fit as one HTML page that needs nothing from outside.

    The same posterior always gives the same bytes.

    Parameters
    ----------
    posterior : Posterior
        A finished fit.
    sections : sequence of Section, optional
        What the page consists of, default `standard_sections(posterior)`.
        Add your own to that list.

    Returns
    -------
    str
        The page.
    """
    chosen = standard_sections(posterior) if sections is None else sections
    return render_page(str(posterior.attributes["campaign"]), chosen)


def render_page(title: str, sections: Sequence[Section]) -> str:
    """Sections as one HTML page that needs nothing from outside.

    Only the page's own style sheet and scripts may act on it: a content security policy names
    their hashes.

    Parameters
    ----------
    title : str
        The page's heading.
    sections : sequence of Section
        What it consists of.

    Returns
    -------
    str
        The page.
    """
    environment = Environment(
        autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    css = packaged("report.css") + packaged("phone_and_paper.css")
    scripts = list(dict.fromkeys(section.script for section in sections if section.script))
    return environment.from_string(packaged("page.html")).render(
        title=title,
        css=Markup(css),
        css_hash=_policy_hash(css),
        scripts=[Markup(script) for script in scripts],
        script_hashes=[_policy_hash(script) for script in scripts],
        sections=[_rendered(environment, section) for section in sections],
    )


def _policy_hash(text: str) -> str:
    """What a content security policy calls an inline style sheet or script by."""
    digest = base64.b64encode(hashlib.sha256(text.encode()).digest()).decode("ascii")
    return f"sha256-{digest}"


def _rendered(environment: Environment, section: Section) -> dict[str, Any]:
    pictures = [
        {
            "uri": data_uri(p),
            "caption": p.caption,
            "alt": p.alt,
            "instead_of_script": p.instead_of_script,
        }
        for p in section.pictures
    ]
    body = environment.from_string(section.template).render(**section.context)
    return {
        "title": section.title,
        "id": re.sub(r"\W+", "-", section.title.lower()).strip("-"),
        "body": Markup(with_column_labels(body)),
        "pictures": pictures,
    }


def write_report(
    posterior: Posterior, path: str | Path, sections: Sequence[Section] | None = None
) -> Path:
    """Write the report of a fit, atomically.

    Parameters
    ----------
    posterior : Posterior
        A finished fit.
    path : str or Path
        Of the HTML file; it is replaced where it exists.
    sections : sequence of Section, optional
        See `render`.

    Returns
    -------
    Path
        The path.

    Raises
    ------
    OutputError
        If the file cannot be written.

    Examples
    --------
    It needs a finished fit, so this is no doctest::

        write_report(Posterior.load("my_run/posterior.nc"), "my_run/report.html")
    """
    return write_atomically(path, render(posterior, sections))
