"""The page: complete, safe, the same every time, and what it says."""

import base64
import hashlib
import re

import pytest

from bayes_inertia.report.criteria import exponents_of
from bayes_inertia.report.fit_sections import standard_sections
from bayes_inertia.report.formatting import NOT_GIVEN, number
from bayes_inertia.report.page import render, write_report
from bayes_inertia.report.section import Section
from bayes_inertia.report.verdict import verdict_sentence

# The other kinds of pages are drawn with the slow tests.
KINDS = (
    "good",
    "one_slew",
    *(pytest.param(kind, marks=pytest.mark.slow) for kind in ("thrown", "many_effects")),
)


def text_of(page: str) -> str:
    """What a reader reads: without pictures, styles and tags."""
    page = re.sub(r"<(style|script)\b.*?</\1>", "", page, flags=re.S)
    return re.sub(r"\s+", " ", re.sub(r"<[^>]*>", " ", page))


@pytest.mark.parametrize("kind", KINDS)
def test_pages_are_complete_safe_and_ask_for_nothing(pages, posteriors, kind):
    page = pages[kind]
    assert (
        page.count("<section")
        == len(standard_sections(posteriors[kind]))
        == page.count("</section>")
    )
    assert len(page) < 1e6
    assert "Content-Security-Policy" in page
    assert "default-src 'none'" in page
    assert not re.search(r"https?://", page)
    assert set(re.findall(r'(?:src|href)="(.)', page)) <= {"d", "#"}
    assert "a campaign &lt;of slews&gt; &amp; more" in page
    for kind_, payload in re.findall(r'src="data:image/([a-z+]+);base64,([^"]+)"', page):
        content = base64.b64decode(payload)
        assert content.startswith(b"\x89PNG" if kind_ == "png" else b"<?xml")
        addresses = set(re.findall(rb"https?://[^\"'< ]+", content)) if kind_ != "png" else set()
        assert all(
            a.startswith(
                (b"http://www.w3.org/", b"http://creativecommons.org/", b"http://purl.org/")
            )
            for a in addresses
        )


@pytest.mark.parametrize("kind", ["style", "script"])
def test_style_and_script_are_those_that_the_policy_allows(pages, kind):
    text = re.search(rf"<{kind}>(.*?)</{kind}>", pages["good"], re.S).group(1)
    allowed = re.search(rf"{kind}-src 'sha256-([^']+)'", pages["good"]).group(1)
    assert base64.b64encode(hashlib.sha256(text.encode()).digest()).decode() == allowed
    assert "style=" not in re.sub(r'src="[^"]*"', "", pages["good"])
    assert "unsafe" not in re.search(r'Policy" content="([^"]*)"', pages["good"]).group(1)


def test_the_verdict_in_one_sentence_stands_first(pages, posteriors):
    summary = posteriors["good"].summary()
    first = text_of(pages["good"]).split(" Result ")[1].strip()
    assert first.startswith(f"Trusted {verdict_sentence(summary)}")


@pytest.mark.slow
def test_rendering_again_gives_the_same_bytes(made, pages, tmp_path):
    path = write_report(made("good"), tmp_path / "report.html")
    assert path.read_text(encoding="utf-8") == pages["good"]


@pytest.mark.parametrize(
    ("kind", "says", "says_not"),
    [
        (
            "good",
            [
                "Yes, these numbers can be trusted",
                "Jxx and K1 are hard to tell apart (correlation −0.9",
            ],
            ["weight", "diagnose”"],
        ),
        (
            "one_slew",
            ["does not determine every parameter", "One slew is checked by no other"],
            ["No sd is quoted"],
        ),
        (
            "thrown",
            [
                "Do not use these numbers yet",
                "an effect is missing",
                "No sd is quoted",
                "1/9",
                "no star-tracker fixes",
                "9 of 15 slews",
            ],
            ["chi^2", "`"],
        ),
        (
            "many_effects",
            ["wheel friction: coulomb8", "Only the 16 most correlated of 17 parameters"],
            [],
        ),
    ],
)
def test_pages_say_what_is_so(pages, kind, says, says_not):
    text = text_of(pages[kind])
    assert "common gain of all wheels cannot be told apart" in text
    assert [s for s in says if s not in text] == []
    assert [s for s in says_not if s in text] == []


def test_the_quoted_sd_stands_in_its_column_and_a_refused_result_has_none(made, pages):
    rows = made("good").summary()["parameters"]
    powers = exponents_of(rows)
    expected = [
        number(row["quoted_sd"], row["quoted_sd"], powers[name]) for name, row in rows.items()
    ]
    cells = re.findall(r'<td[^>]* class="n strong">([^<]*)</td>', pages["good"])
    assert cells[1:18:2] == expected
    assert all(row["quoted_sd"] is None for row in made("thrown").summary()["parameters"].values())
    refused = re.findall(r'<td[^>]* class="n strong">([^<]*)</td>', pages["thrown"])
    assert set(refused[1:18:2]) == {NOT_GIVEN}
    assert 'class="tag determined"' not in pages["thrown"]


@pytest.mark.slow
def test_own_sections_can_be_added(posteriors):
    own = Section("My own <remarks>", "<p>{{ what }}</p>", {"what": "1 < 2"})
    sections = [*standard_sections(posteriors["good"]), own]
    page = render(posteriors["good"], sections)
    assert render(posteriors["good"], iter(sections)) == page
    assert "My own &lt;remarks&gt;" in page
    assert "<p>1 &lt; 2</p>" in page


@pytest.mark.long
@pytest.mark.slow
def test_a_real_fit_can_be_reported(made, flying, setup_type):
    """The made-up posteriors above have the groups that a fit has."""
    from bayes_inertia.app.fit_campaign import fit
    from bayes_inertia.inference.settings import Settings

    campaign = flying(
        1, setup_type(turns=((0.6, 0.1, 0.0), (0.1, 0.5, 0.5)), rows=48, dt=2.0)
    ).campaign
    posterior = fit(campaign, settings=Settings(ensembles=2, walkers=24, steps=40, max_steps=40))
    pictures = sum(len(section.pictures) for section in standard_sections(posterior))
    assert pictures >= 6
    assert render(posterior).count("<figure") == pictures
    assert set(posterior.tree.children) >= set(made("good").tree.children)
