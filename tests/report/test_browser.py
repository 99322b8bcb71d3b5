"""The page in a real browser: quiet, safe, narrow enough, and its script works."""

from __future__ import annotations

import base64
import re

import numpy as np
import pytest
from support.chromium import BROWSER, Chromium

from bayes_inertia.report.comparison_sections import comparison_page
from bayes_inertia.report.page import write_report
from bayes_inertia.report.residual_sections import residual_channels
from bayes_inertia.report.run_comparison import ComparedRun, compare_runs
from bayes_inertia.report.verdict import with_verdict_sentence

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not BROWSER.exists(), reason=f"no browser at {BROWSER}"),
]
INJECTED = "<script>window.injected = 1</script></body>"


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    chromium = Chromium(tmp_path_factory.mktemp("browser"))
    yield chromium
    chromium.close()


@pytest.fixture(scope="module")
def pages_of(hostile, tmp_path_factory):
    """Files of the two kinds of page, with hostile names."""
    folder = tmp_path_factory.mktemp("pages")
    summary = with_verdict_sentence(hostile.summary())
    settings = {"campaign": summary["campaign"], "seed": "1"}
    moved = summary | {"parameters": dict(summary["parameters"])}
    row = moved["parameters"]["Jxx"]
    moved["parameters"]["Jxx"] = row | {"mean": row["mean"] + 10.0 * row["quoted_sd"]}
    runs = [
        ComparedRun(name, name, content, settings | {"seed": name})
        for name, content in ((summary["campaign"], summary), ("after", moved))
    ]
    comparison = folder / "comparison.html"
    comparison.write_text(comparison_page(compare_runs(*runs)), encoding="utf-8")
    return {"run": write_report(hostile, folder / "run.html"), "comparison": comparison}


@pytest.mark.parametrize("kind", ["run", "comparison"])
def test_hostile_names_are_text_and_nothing_is_asked_for(browser, pages_of, hostile, kind):
    browser.open(pages_of[kind])
    assert browser.complaints() == []
    assert browser.requests() == []
    assert browser.value("window.hacked === undefined")
    assert hostile.attributes["campaign"] in browser.value("document.body.textContent")


@pytest.mark.parametrize("width", [390, 800, 1300])
@pytest.mark.parametrize("kind", ["run", "comparison"])
def test_nothing_is_wider_than_the_window(browser, pages_of, kind, width):
    browser.size(width)
    browser.open(pages_of[kind])
    assert browser.value("document.documentElement.scrollWidth") <= width
    wide = "[...document.querySelectorAll('.wide')].filter(e => e.scrollWidth > e.clientWidth)"
    assert browser.value(f"{wide}.length") == 0


def test_a_script_that_is_not_the_pages_own_does_not_run(browser, pages_of, tmp_path):
    page = pages_of["run"].read_text(encoding="utf-8").replace("</body>", INJECTED)
    policy = re.search(r"<meta http-equiv[^>]*>", page)[0]
    for name, text, runs in (("kept", page, False), ("without", page.replace(policy, ""), True)):
        path = tmp_path / f"{name}.html"
        path.write_text(text, encoding="utf-8")
        browser.open(path)
        assert browser.value("window.injected === 1") == runs
        assert any("Content Security Policy" in c for c in browser.complaints()) != runs


def test_residuals_can_be_chosen_enlarged_and_read(browser, pages_of, hostile):
    browser.size(1300)
    browser.open(pages_of["run"])
    channel = residual_channels(hostile)[2]
    choose = "(n, v) => { const e = document.querySelector(`[name=${n}]`); e.value = v;"
    choose += " e.dispatchEvent(new Event('change')); }"
    browser.value(f"({choose})('channel', 2); ({choose})('slew', 1)")
    options = "[...document.querySelector('[name=slew]').options].map(o => o.text)"
    assert [text.split(" (χ²")[0] for text in browser.value(options)] == channel.slews
    assert f"All {len(channel.time[1])} rows" in browser.value(
        "document.querySelector('.shown').textContent"
    )
    where = "document.querySelector('canvas')"
    browser.value(f"{where}.scrollIntoView({{block: 'center'}})")
    box = browser.value(f"{where}.getBoundingClientRect().toJSON()")
    left, middle = box["x"] + 0.3 * box["width"], box["y"] + 0.5 * box["height"]
    browser.mouse("mouseMoved", left, middle)
    said = browser.value("document.querySelector('.reading').textContent")
    time = float(re.search(r"t = ([\d.]+) s", said)[1])
    row = int(np.argmin(np.abs(channel.time[1] - time)))
    expected = [f"{'−' if v < 0 else '+'}{abs(v):.2f} σ" for v in channel.residual[1][row]]
    assert re.findall(r"[+−][\d.]+ σ", said) == expected
    browser.mouse("mousePressed", left, middle)
    browser.mouse("mouseMoved", left + 100, middle)
    browser.mouse("mouseReleased", left + 100, middle)
    browser.mouse("mouseMoved", box["x"] + box["width"] - 11, middle)
    closer = browser.value("document.querySelector('.reading').textContent")
    last = float(re.search(r"t = ([\d.]+) s", closer)[1])
    assert time < last < 0.5 * channel.time[1][-1]
    assert browser.complaints() == []


def test_readers_without_scripts_get_pictures_and_paper_only_what_is_not_folded(browser, pages_of):
    shown = "getComputedStyle(document.querySelector('{}')).display !== 'none'"
    explorer, picture = shown.format(".explorer"), shown.format(".instead-of-script")
    folded = shown.format("details")
    browser.open(pages_of["run"])
    assert browser.value(f"[{explorer}, {picture}, {folded}]") == [True, False, True]
    browser.media(medium="print")
    assert browser.value(f"[{explorer}, {picture}, {folded}]") == [False, False, False]
    browser.media()
    browser.command("Emulation.setScriptExecutionDisabled", value=True)
    browser.open(pages_of["run"])
    browser.command("Emulation.setScriptExecutionDisabled", value=False)
    assert browser.value(f"[{explorer}, {picture}]") == [False, True]
    paper = base64.b64decode(browser.command("Page.printToPDF")["data"])
    assert paper.startswith(b"%PDF")
    assert 2 <= paper.count(b"/Type /Page\n") <= 5


def test_nothing_is_green_in_a_refused_report(browser, pages, tmp_path):
    colors = "[...document.querySelectorAll('body *')].map(e => getComputedStyle(e).color)"
    green = "getComputedStyle(document.documentElement).getPropertyValue('--good')"
    as_color = f"(() => {{ const e = document.createElement('i'); e.style.color = {green};"
    as_color += " document.body.append(e); return getComputedStyle(e).color; })()"
    found = {}
    for kind in ("good", "thrown"):
        path = tmp_path / f"{kind}.html"
        path.write_text(pages[kind], encoding="utf-8")
        browser.open(path)
        seen = browser.value(colors)
        found[kind] = browser.value(as_color) in seen
    assert found == {"good": True, "thrown": False}


def test_dark_pages_are_dark(browser, pages_of):
    def brightness() -> list[int]:
        color = browser.value("getComputedStyle(document.body).backgroundColor")
        return [int(n) for n in re.findall(r"\d+", color)]

    browser.media(dark=True)
    browser.open(pages_of["run"])
    assert max(brightness()) < 60
    browser.media()
    assert min(brightness()) > 200
