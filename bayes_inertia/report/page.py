"""The page: sections, style sheet, scripts and pictures in one offline HTML file.

Cells that know their column: a narrow screen shows rows as cards, each number with its name.
"""

from __future__ import annotations

import base64
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from jinja2 import Environment
from markupsafe import Markup

from bayes_inertia.errors import SettingsError, members
from bayes_inertia.files import write_atomically
from bayes_inertia.inference.posterior import Posterior
from bayes_inertia.report.fit_sections import require_posterior, standard_sections
from bayes_inertia.report.section import Section, data_uri, packaged
from bayes_inertia.report.words import templates_in
from bayes_inertia.sealing import sha256_of

_MISSION_KEYS = ("name", "spacecraft", "operator", "document", "epoch")


def render(
    posterior: Posterior,
    sections: Sequence[Section] | None = None,
    origin: Mapping[str, str] | None = None,
) -> str:
    """The report of a fit as one HTML page that needs nothing from outside.

    The same posterior always gives the same bytes.
    """
    usual = standard_sections(posterior) if sections is None else sections
    chosen = members(usual, Section, "sections", error=SettingsError)
    attributes = posterior.attributes
    facts = page_facts(
        attributes.get("mission", {}),
        sha256=attributes.get("campaign_sha256"),
        version=attributes["versions"].get("bayes-inertia", ""),
        origin=origin,
    )
    return render_page(str(attributes["campaign"]), chosen, facts)


def page_facts(
    mission: Mapping[str, str],
    *,
    sha256: str | None = None,
    version: str = "",
    origin: Mapping[str, str] | None = None,
) -> dict[str, str]:
    """Origin of a page, for its head; unknown facts are left out.

    `mission` [mission]. `origin`: date of the result, and folder of the data.

    >>> page_facts({"operator": "UTIAS", "name": "MOST"}, sha256="ab" * 32, version="0.5.0")
    {'mission': 'MOST', 'operator': 'UTIAS', 'SHA-256': 'abababababab', 'bayes-inertia': ...}
    """
    stated = {"mission" if key == "name" else key: mission.get(key, "") for key in _MISSION_KEYS}
    made = {"SHA-256": (sha256 or "")[:12], "bayes-inertia": version}
    return {name: value for name, value in (stated | dict(origin or {}) | made).items() if value}


def render_page(
    title: str, sections: Sequence[Section], facts: Mapping[str, str] | None = None
) -> str:
    """Sections as one HTML page that needs nothing from outside.

    Only the page's own style sheet and scripts may act on it: a content security policy names
    their hashes.
    """
    environment = templates_in("", autoescape=True)
    environment.filters["uri"] = data_uri
    css = packaged("report.css") + packaged("phone_and_paper.css")
    scripts = list(dict.fromkeys(section.script for section in sections if section.script))
    return environment.from_string(packaged("page.html")).render(
        title=title,
        facts=facts or {},
        css=Markup(css),
        css_hash=_policy_hash(css),
        scripts=[Markup(script) for script in scripts],
        script_hashes=[_policy_hash(script) for script in scripts],
        sections=[_rendered(environment, section) for section in sections],
    )


def _policy_hash(text: str) -> str:
    """Hash of an inline style sheet or script, as a content security policy names it."""
    digest = base64.b64encode(bytes.fromhex(sha256_of(text))).decode("ascii")
    return f"sha256-{digest}"


def _rendered(environment: Environment, section: Section) -> dict[str, Any]:
    body = environment.from_string(section.template).render(**section.context)
    return {
        "title": section.title,
        "id": re.sub(r"\W+", "-", section.title.lower()).strip("-"),
        "body": Markup(with_column_labels(body)),
        "pictures": section.pictures,
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
    require_posterior(posterior)
    return write_atomically(path, render(posterior, sections))


_TABLE = re.compile(r"<table.*?</table>", re.S)
_HEADING = re.compile(r'<th scope="col"[^>]*>(.*?)</th>', re.S)
_CELL = re.compile(r"<td(?=[\s>])")
_TAG = re.compile(r"<[^>]*>")


def with_column_labels(html: str) -> str:
    """A section's body whose cells carry the heading of their column.

    `html`: with tables: a row of `<th scope="col">`, then rows of one `<th scope="row">` and cells.
    Returns: the same with `data-label` at each cell; tables without such headings are left as they
    are.

    >>> head = '<tr><th scope="col">name</th><th scope="col">sd</th></tr>'
    >>> row = '<tr><th scope="row">Jxx</th><td>1</td></tr>'
    >>> with_column_labels(f"<table>{head}{row}</table>")[-39:]
    '<td data-label="sd">1</td></tr></table>'
    """
    return _TABLE.sub(lambda table: _labelled(table[0]), html)


def _labelled(table: str) -> str:
    headings = [
        _TAG.sub(" ", heading).strip().replace('"', "&quot;") for heading in _HEADING.findall(table)
    ][1:]
    if not headings:
        return table
    rows = table.split("<tr")
    return "<tr".join(_labelled_row(row, headings) for row in rows)


def _labelled_row(row: str, headings: list[str]) -> str:
    labels = iter(headings)
    return _CELL.sub(lambda _: f'<td data-label="{next(labels, "")}"', row)
