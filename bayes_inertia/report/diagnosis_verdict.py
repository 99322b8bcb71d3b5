"""What is missing from the model? The verdict on the content of diagnosis.json.

Which slew to fly next after a diagnosis, and what becomes of its correction, in words.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from bayes_inertia.campaign.sensors import CHANNELS
from bayes_inertia.inference.settings import NOTHING, OPEN_VERDICTS
from bayes_inertia.report.answer_wording import beyond_prior_text, probabilities_text
from bayes_inertia.report.diagnosis_wording import (
    averaging_text,
    could_hide_text,
    formula_texts,
    nameless_signal,
    nameless_text,
    step_text,
    window_text,
)
from bayes_inertia.report.dirt_wording import dirt_sentences
from bayes_inertia.report.formatting import (
    arcsec_text,
    channel_name,
    either_or,
    listed,
    plain,
    probability,
    vector_text,
)
from bayes_inertia.report.layout import LAYOUT
from bayes_inertia.report.verdict import Level, Verdict

_LEVELS: dict[str, Level] = {
    "consistent": "good",
    "named": "good",
    "ambiguous": "caution",
    "formula": "caution",
    "partial": "caution",
    "unknown": "bad",
}


def diagnosis_verdict(content: Mapping[str, Any]) -> Verdict:
    """What is missing, and what that means.

    Returns: the answer first, then where, how much, what to fly next, and what remains open.
    """
    sentences = [
        _on_disagreement(content),
        *_on_block_means(content),
        *dirt_sentences(content.get("dirt", [])),
        *_on_named_effects(content),
        *_on_probabilities(content),
        *_on_noise(content),
        *_on_next_slews(content),
        *_on_what_is_unknown(content),
        *formula_texts(content),
        *_on_skipped(content),
        *_on_the_fit_below(content),
    ]
    # Of an ambiguous set, what has no name is a member.
    if content["verdict"] == "named" and (doubt := nameless_text(content)):
        sentences.append(doubt)
    if content.get("could_hide"):
        sentences.append(could_hide_text(content["could_hide"]))
    return Verdict(_LEVELS[content["verdict"]], headline(content), tuple(sentences))


def in_brief(content: Mapping[str, Any]) -> list[str]:
    """What of a diagnosis a terminal shows: where, how much, what to fly next. The page has all."""
    sentences = [
        _on_disagreement(content),
        *_on_named_effects(content),
        *_on_probabilities(content),
        *_on_noise(content),
        *(separating_text(slew) for slew in content.get("separating", [])[:1]),
        *_on_what_is_unknown(content),
        *formula_texts(content),
    ]
    if content["verdict"] == "named" and (doubt := nameless_text(content)):
        sentences.append(doubt)
    if content.get("could_hide"):
        sentences.append(could_hide_text(content["could_hide"]))
    return sentences


def headline(content: Mapping[str, Any]) -> str:
    """The verdict of a diagnosis in one line.

    Examples
    --------
    >>> headline({"verdict": "consistent", "named": [], "ambiguous_with": []})
    'Nothing is missing that these slews show: the model explains the data.'
    """
    verdict, named, sets = content["verdict"], content["named"], content["ambiguous_with"]
    if verdict == "consistent":
        treated = any(d["treated"] != "ignored" for d in content.get("dirt", []))
        dirt = "without the dirt in the telemetry " if treated else ""
        return f"Nothing is missing that these slews show: {dirt}the model explains the data."
    if verdict == "unknown":
        return "Something is missing that no candidate explains."
    if verdict == "partial":
        names = listed([plain(name) for name in named])
        return f"Found a part of what is missing: {names}. Beside it something has no name."
    if verdict == "ambiguous":
        choices = "; and ".join(either_or([plain(name) for name in names]) for names in sets)
        sure = [plain(name) for name in named if not any(name in names for names in sets)]
        besides = f" Besides: {listed(sure)}." if sure else ""
        is_missing = "may be" if not sure and all(NOTHING in names for names in sets) else "is"
        return f"Something {is_missing} missing: {choices}. This campaign cannot tell.{besides}"
    found = listed([plain(name) for name in named])
    if verdict == "formula":
        return f"Something is missing that no effect of the library is. Its formula: {found}."
    return f"Found what is missing: {found}."


def _on_disagreement(content: Mapping[str, Any]) -> str:
    """Where the base model disagrees with the data."""
    windows = content["disagreement"]
    if not windows:
        searched = (
            "The residuals of the base model were searched in every channel, slew and time window: "
        )
        if content["steps"]:
            return f"{searched}no stretch alone exceeds the noise, all together do."
        return f"{searched}nowhere are they more than noise explains."
    worst = windows[0]
    place = window_text(worst, content.get("slew_start", {}).get(worst["slew"], 0.0))
    p_value = worst["p_value"]
    if content["verdict"] == "consistent":
        often = (
            f"one campaign of {round(1.0 / p_value)}"
            if p_value > LAYOUT.rare_p_value
            else "fewer than one campaign of 1000"
        )
        return (
            f"The most conspicuous stretch of the residuals is {place}. "
            f"Noise alone makes one like it in {often}, and no candidate explains it."
        )
    hit = {window["channel"] for window in windows}
    sensors = listed(
        [channel_name(c) for c in dict.fromkeys((*CHANNELS, *sorted(hit))) if c in hit]
    )
    n_slews = len({window["slew"] for window in windows})
    return (
        f"The base model disagrees with {sensors} "
        f"in {n_slews} slew{'s' if n_slews > 1 else ''}, most in {place} "
        f"({probability(p_value)})."
    )


def _on_named_effects(content: Mapping[str, Any]) -> list[str]:
    if content["verdict"] == "unknown":
        return []
    steps = [step_text(step, content["candidates"]) for step in content["steps"]]
    return steps + [beyond_prior_text(row) for row in content.get("beyond_prior", [])]


def _on_probabilities(content: Mapping[str, Any]) -> list[str]:
    """How probable each answer is."""
    rows = content.get("hypotheses", [])
    return [probabilities_text(rows)] if rows else []


def _on_noise(content: Mapping[str, Any]) -> list[str]:
    """Sensors that are louder than stated."""
    louder = {channel_name(c): factor for c, factor in content["noise"].items() if factor > 1.0}
    if content["verdict"] in OPEN_VERDICTS:
        # What is fast and unexplained passes for noise.
        return [
            f"From sample to sample the {sensor} scatters {factor:.2f} times as much "
            "as campaign.toml states; what is missing may be part of that."
            for sensor, factor in louder.items()
        ]
    return [
        f"The noise of the {sensor} is {factor:.2f} times what campaign.toml states "
        "(of its loudest axis, if they differ). Correct it there; the fit below takes it so."
        for sensor, factor in louder.items()
    ]


def _on_next_slews(content: Mapping[str, Any]) -> list[str]:
    """The next correction slew, and the slews that would settle what is ambiguous."""
    sentences = []
    if content.get("correction_slew"):
        sentences.append(correction_text(content["correction_slew"]))
    for names in content["ambiguous_with"]:
        effects = [plain(name) for name in names if name != NOTHING]
        if len(effects) > 1:
            sentences.append(
                f"{listed(effects).capitalize()} would look so alike "
                "in this campaign that naming one of them would be a guess."
            )
        if NOTHING in names:
            sentences.append(f"Noise alone may look like {effects[0]} here.")
    return sentences + [separating_text(slew) for slew in content.get("separating", [])]


def _on_what_is_unknown(content: Mapping[str, Any]) -> list[str]:
    if content["verdict"] == "partial":
        return _on_a_part(content)
    if content["verdict"] != "unknown":
        return []
    if content.get("why_unknown") == "imitation":
        tried = listed([plain(step["added"]) for step in content["steps"]])
        sentences = [
            f"Adding {tried} would bring the residuals down to the noise, but "
            f"{nameless_signal(content)} explains them better: the name would be an imitation."
        ]
    else:
        n_tried = sum(candidate["p_value"] is not None for candidate in content["candidates"])
        sentences = [
            f"None of the {n_tried} candidates brings the residuals down to the noise, "
            "so none is named."
        ]
    if content["unknown"]:
        sentences.append(f"What is left looks like this: {content['unknown']['description']}.")
    return sentences


def _on_a_part(content: Mapping[str, Any]) -> list[str]:
    """What share of the misfit the names explain, and what is left."""
    sentences = [
        f"Of the misfit, {plain(step['added'])} explains {100.0 * step['share']:.0f} %."
        for step in content["steps"]
    ]
    if content["unknown"]:
        sentences.append(f"What is left looks like this: {content['unknown']['description']}.")
    return sentences


def _on_block_means(content: Mapping[str, Any]) -> list[str]:
    readings = content.get("readings_a_mean", 1)
    if readings == 1:
        return []
    return [
        f"Rates are means of {readings} readings each, which hold all that a rigid body's motion "
        "shows: ringing faster than a quarter of their rate was not looked for. "
        "Rows with faults are counted in these means."
    ]


def _on_skipped(content: Mapping[str, Any]) -> list[str]:
    skipped = [plain(candidate["effect"]) for candidate in content["skipped"]]
    return [f"Not tried for lack of columns: {listed(skipped)}."] if skipped else []


def _on_the_fit_below(content: Mapping[str, Any]) -> list[str]:
    """Which model the numbers further down the page are of."""
    steps = content["steps"]
    if content["verdict"] in OPEN_VERDICTS:
        # The fit's own gate says what was fitted along, and what that does not hold.
        return []
    if not steps:
        return ["The fit below is the base model's."]
    if content.get("alternatives"):
        effects = listed([plain(step["added"]) for step in steps])
        sentences = [f"The fit below includes {effects}. {averaging_text(content)}"]
    else:
        sentences = [
            "The fit below includes the named effects: J and K are estimated together with them."
        ]
    if any(step["added"] == "inertia_change" for step in steps):
        sentences.append(
            "J is the tensor before its change. "
            "For the next slew add the change, element by element."
        )
    return sentences


def separating_text(slew: Mapping[str, Any]) -> str:
    """The slew that would tell two effects apart.

    Examples
    --------
    >>> change = {"before": 10, "after": 40}
    >>> separating_text({"effects": ["a", "b"], "axis": [0.0, 0.6, -0.8], "angle_deg": 60.0,
    ...     "rate_deg_s": 1.0, "correlation_before": 0.97, "correlation_after": 0.5,
    ...     "noncentrality": {"a": change, "b": change}})[:63]
    'To tell a from b, fly a slew of 60° about (0.00, 0.60, −0.80) i'
    """
    first, second = (plain(name) for name in slew["effects"])
    least_gain = min(
        power["after"] / max(power["before"], 1e-12) for power in slew["noncentrality"].values()
    )
    return (
        f"To tell {first} from {second}, fly a slew of {slew['angle_deg']:.3g}° "
        f"about ({vector_text(slew['axis'])}) in body axes, up to {slew['rate_deg_s']:.2g} deg/s: "
        "what is seen of one and not of the other "
        f"grows {least_gain:.2g} times in χ² or more "
        f"(correlation of the two {slew['correlation_before']:.2f} before, "
        f"{slew['correlation_after']:.2f} after)."
    )


def correction_text(forecast: Mapping[str, Any]) -> str:
    """What becomes of the next correction slew.

    Examples
    --------
    >>> correction_text({"axis": "x", "angle_deg": 60.0, "promised": [8e-5, 2e-4],
    ...     "expected": [8.5e-4, 1e-3], "updated": [1e-4, 2.2e-4]})[:65]
    'A slew of 60° about x, flown with J and K of the base model, shou'
    """
    promised, expected, updated = (
        f"{arcsec_text(middle)} arcsec (95 %: below {arcsec_text(most)})"
        for middle, most in (forecast[key] for key in ("promised", "expected", "updated"))
    )
    return (
        f"A slew of {forecast['angle_deg']:.0f}° about {forecast['axis']}, flown with J and K "
        f"of the base model, should need a correction of {promised}; "
        f"with what was found it will need {expected}, "
        f"and {updated} when flown with the new J and K."
    )
