"""What the report says about a diagnosis, as pure functions of the content of diagnosis.json."""

# Printed text has typographic signs on purpose.
from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from bayes_inertia.diagnosis.search import Rules
from bayes_inertia.report.wording import Verdict, exponent, listed, number, unit_text

CHANNEL_NAMES = {
    "rate": "rate sensor",
    "attitude": "star tracker",
    "momentum": "wheel momentum",
    "total": "all channels",
}
_LEVELS = {"consistent": "good", "named": "good", "ambiguous": "caution", "unknown": "bad"}


def plain(name: str) -> str:
    """An effect's name as printed.

    >>> plain("wheel_command_lag")
    'wheel command lag'
    """
    return name.replace("_", " ")


def verdict(content: Mapping[str, Any]) -> Verdict:
    """What is missing, and what that means."""
    title = headline(content)
    sentences = [*_where(content), *_what(content)]
    if content["verdict"] == "unknown":
        sentences.append(
            "The fit below is the base model's: what is missing may shift J and K by more than their sd."
        )
    elif content["steps"]:
        if content.get("alternatives"):
            sentences.append(
                f"The fit below includes {listed([plain(step['added']) for step in content['steps']])}. {whichever_text(content)}"
            )
        else:
            sentences.append(
                "The fit below includes the named effects: J and K are estimated together with them."
            )
        if any(step["added"] == "inertia_change" for step in content["steps"]):
            sentences.append(
                "J is the tensor before its change: for the next slew add the change, element by element."
            )
    else:
        sentences.append("The fit below is the base model's.")
    if content["verdict"] != "unknown" and (doubt := nameless(content)):
        sentences.append(doubt)
    if content.get("could_hide"):
        sentences.append(hidden_text(content["could_hide"]))
    return Verdict(_LEVELS[content["verdict"]], title, tuple(sentences))


def headline(content: Mapping[str, Any]) -> str:
    """The verdict in one line.

    >>> headline({"verdict": "consistent", "named": [], "ambiguous_with": []})
    'Nothing is missing: the model explains the data.'
    """
    kind = content["verdict"]
    if kind == "consistent":
        return "Nothing is missing: the model explains the data."
    if kind == "unknown":
        return "Something is missing that no candidate explains."
    names = [plain(n) for n in content["named"]]
    if kind == "ambiguous":
        sets = [f"{listed_or([plain(n) for n in group])}" for group in content["ambiguous_with"]]
        sure = [
            plain(n)
            for n in content["named"]
            if not any(n in group for group in content["ambiguous_with"])
        ]
        also = f" Besides: {listed(sure)}." if sure else ""
        return (
            f"Something is missing: {'; and '.join(sets)}. This campaign cannot tell which.{also}"
        )
    if content["named"] == ["noise_level"]:
        return "No effect is missing, but the noise is larger than stated."
    return f"Found what is missing: {listed(names)}."


def added(content: Mapping[str, Any]) -> str:
    """What the pictures "after" are made with.

    >>> added({"steps": [], "verdict": "named"}), added({"steps": [{}], "verdict": "unknown"})
    ('with the noise as measured', 'with the effects that were tried')
    """
    if not content["steps"]:
        return "with the noise as measured"
    return (
        "with the effects that were tried"
        if content["verdict"] == "unknown"
        else "with the named effects"
    )


def listed_or(items: Sequence[str]) -> str:
    """Alternatives in a sentence.

    >>> listed_or(["a", "b", "c"])
    'either a, b or c'
    """
    return f"either {', '.join(items[:-1])} or {items[-1]}" if len(items) > 1 else "".join(items)


def probabilities(content: Mapping[str, Any]) -> list[tuple[str, float]]:
    """What of the sets may be true and how probable it is, the effects named first.

    >>> probabilities({"alternatives": [{"effect": "wheel_friction", "instead_of": "viscous_torque", "probability": 0.25}]})
    [('viscous torque', 0.75), ('wheel friction', 0.25)]
    """
    others = content["alternatives"]
    named = listed([plain(name) for name in dict.fromkeys(a["instead_of"] for a in others)])
    several = len({a["instead_of"] for a in others}) > 1
    rows = [
        (
            f"{plain(a['effect'])}{' instead of ' + plain(a['instead_of']) if several else ''}",
            a["probability"],
        )
        for a in others
    ]
    return [(named, 1.0 - sum(p for _, p in rows)), *rows]


def whichever_text(content: Mapping[str, Any]) -> str:
    """That J and K are averaged over the sets, and how far they lie apart in them."""
    moved = content["steps"][-1]["shift"]
    gaps = [
        (abs(mean - moved[name]["after"]) / moved[name]["sd_after"], name, plain(a["effect"]))
        for a in content["alternatives"]
        for name, mean in zip(a["names"], a["mean"], strict=True)
    ]
    most, name, effect = max(gaps)
    shares = ", ".join(f"{what} {100.0 * p:.0f} %" for what, p in probabilities(content))
    said = (
        f"J and K are averaged over what may be true ({shares}), so that they hold whichever it is"
    )
    if most < 0.1:
        return f"{said}; it makes no difference to them."
    return f"{said}: if it is {effect}, {name} is {most:.1f} sd from where the first has it."


def nameless(content: Mapping[str, Any]) -> str:
    """That something outside the library could be the cause as well; empty where the names explain the data clearly better.

    >>> nameless({"nameless_lead": 1.5}), nameless({"nameless_lead": -20.0})
    ('Something without a name (a torque or sensor error ...) explains the data about as well: what is named is likely, not proven.', '')
    """
    lead = content.get("nameless_lead")
    if lead is None or lead < -Rules.margin:
        return ""
    what = "a torque or sensor error of free shape, or in proportion to a rate, momentum, field or time"
    return f"Something without a name ({what}) explains the data about as well: what is named is likely, not proven."


def hidden_text(rows: Sequence[Mapping[str, Any]]) -> str:
    """How far what is too weak to be found could have moved J and K, at most.

    >>> hidden_text([{"parameter": "Jxx", "shift": 6e-4, "sd": 2e-4, "effect": "wheel_friction"}])
    'An effect too weak to be found could still have moved J and K: most of all Jxx, by up to 3.0 of its sd (wheel friction).'
    """
    worst = max(rows, key=lambda row: row["shift"] / row["sd"])
    said = f"most of all {worst['parameter']}, by up to {worst['shift'] / worst['sd']:.1f} of its sd ({plain(worst['effect'])})"
    return f"An effect too weak to be found could still have moved J and K: {said}."


def _where(content: Mapping[str, Any]) -> list[str]:
    windows = content["disagreement"]
    if not windows and content["steps"]:
        return [
            "The residuals of the base model were searched in every channel, slew and time window: no stretch alone exceeds the noise, all together do."
        ]
    if not windows:
        return [
            "The residuals of the base model were searched in every channel, slew and time window: nowhere are they more than noise explains."
        ]
    channels = [
        CHANNEL_NAMES[c]
        for c in ("rate", "attitude", "momentum")
        if any(w["channel"] == c for w in windows)
    ]
    slews = sorted({w["slew"] for w in windows})
    worst = windows[0]
    place = window_text(worst, content.get("slew_start", {}).get(worst["slew"], 0.0))
    if content["verdict"] == "consistent":
        often = (
            f"one campaign of {round(1.0 / worst['p_value'])}"
            if worst["p_value"] > 1e-3
            else "fewer than one campaign of 1000"
        )
        return [
            f"The most conspicuous stretch of the residuals is {place}. Noise alone makes one like it in {often}, and no candidate explains it."
        ]
    return [
        f"The base model disagrees with the data of the {listed(channels)} in {len(slews)} slew{'s' if len(slews) > 1 else ''}, "
        f"most clearly in {place} ({probability(worst['p_value'])} by chance anywhere in the campaign)."
    ]


def window_text(window: Mapping[str, Any], start: float = 0.0) -> str:
    """A window in words, its times [s] counted from `start`, the slew's first row.

    >>> window_text({"channel": "rate", "slew": "slew 2", "component": "axis 1", "t_start": 103.25, "t_end": 140.0}, 100.0)
    'slew 2, rate sensor axis 1, 3.25 to 40 s'
    """
    begin, end = window["t_start"] - start, window["t_end"] - start
    return f"{window['slew']}, {CHANNEL_NAMES[window['channel']]} {window['component']}, {begin:.4g} to {end:.4g} s"


def probability(p: float) -> str:
    """A p-value in words.

    >>> probability(0.03), probability(1e-300), probability(2.3e-7)
    ('p = 0.03', 'p < 1e-100', 'p = 2e-07')
    """
    return "p < 1e-100" if p < 1e-100 else f"p = {p:.1g}"


def _what(content: Mapping[str, Any]) -> list[str]:
    said = (
        [_step(step, content) for step in content["steps"]]
        if content["verdict"] != "unknown"
        else []
    )
    louder = {CHANNEL_NAMES[c]: f for c, f in content["noise"].items() if f > 1.0}
    if content["verdict"] == "unknown":
        # What is fast and unexplained passes for noise.
        said += [
            f"From sample to sample the {name} scatters {f:.2f} times as much as campaign.toml states; what is missing may be part of that."
            for name, f in louder.items()
        ]
    else:
        said += [
            f"The noise of the {name} is {f:.2f} times what campaign.toml states (of its loudest axis, if they differ): correct it there; "
            "the fit below takes it so."
            for name, f in louder.items()
        ]
    if content.get("correction_slew"):
        said.append(correction_text(content["correction_slew"]))
    for group in content["ambiguous_with"]:
        said.append(
            f"{listed([plain(n) for n in group]).capitalize()} would look so alike in this campaign that naming one of them would be a guess."
        )
    said += [separating_text(slew) for slew in content.get("separating", [])]
    if content["verdict"] == "unknown":
        tried = sum(c["p_value"] is not None for c in content["candidates"])
        stack = listed([plain(step["added"]) for step in content["steps"]])
        if content.get("why_unknown") == "imitation":
            said.append(
                f"Adding {stack} would bring the residuals down to the noise, but something without a name explains them better "
                "(a signal of free shape, or in proportion to a rate, momentum, field or time): "
                "what is named would be an imitation of something that is not among the candidates."
            )
        else:
            said.append(
                f"None of the {tried} candidates brings the residuals down to the noise, so none is named."
            )
        if content["unknown"]:
            said.append(f"What is left looks like this: {content['unknown']['description']}.")
    missing = [plain(s["effect"]) for s in content["skipped"]]
    if missing:
        said.append(f"Not tried for lack of columns: {listed(missing)}.")
    return said


def _step(step: Mapping[str, Any], content: Mapping[str, Any]) -> str:
    before, after = step["reduced_chi2_before"]["total"], step["reduced_chi2_after"]["total"]
    text = f"Adding {plain(step['added'])} takes the reduced χ² from {before:.4g} to {after:.4g}"
    if step["held_out_before"] is not None:
        text += f", and of slews left out of the fit from {step['held_out_before']:.4g} to {step['held_out_after']:.4g}"
    values = next(
        (
            c["parameters"]
            for c in content["candidates"]
            if c["effect"] == step["added"] and c["parameters"]
        ),
        None,
    )
    return f"{text}. {parameters_text(values)}" if values else f"{text}."


def separating_text(slew: Mapping[str, Any]) -> str:
    """The slew that would tell two effects apart.

    >>> separating_text({"effects": ["a", "b"], "axis": [0.0, 0.6, -0.8], "angle_deg": 60.0, "rate_deg_s": 1.0, "acceleration_deg_s2": 0.05,
    ...     "correlation_before": 0.97, "correlation_after": 0.5, "noncentrality": {"a": {"before": 10, "after": 40}, "b": {"before": 5, "after": 30}}})
    'To tell a from b, fly a slew of 60° about (0.00, 0.60, −0.80) in body axes, up to 1 deg/s: what is seen of one and not of the other ...'
    """
    axis = ", ".join(f"{x:.2f}".replace("-", "−") for x in slew["axis"])
    a, b = (plain(n) for n in slew["effects"])
    least = min(
        value["after"] / max(value["before"], 1e-12) for value in slew["noncentrality"].values()
    )
    return (
        f"To tell {a} from {b}, fly a slew of {slew['angle_deg']:.3g}° about ({axis}) in body axes, up to {slew['rate_deg_s']:.2g} deg/s: "
        f"what is seen of one and not of the other grows {least:.2g} times in χ² or more "
        f"(canonical correlation {slew['correlation_before']:.2f} before, {slew['correlation_after']:.2f} after)."
    )


def correction_text(forecast: Mapping[str, Any]) -> str:
    """What becomes of the next correction slew.

    >>> correction_text({"axis": "x", "angle_deg": 60.0, "promised": [8e-5, 2e-4], "expected": [8.5e-4, 1e-3], "updated": [1e-4, 2.2e-4]})
    'A slew of 60° about x, flown with J and K of the base model, should need a correction of 17 arcsec (95 %: below 41); with what ...'
    """
    arcsec = {
        key: [206264.806 * x for x in forecast[key]] for key in ("promised", "expected", "updated")
    }
    # Whole arc seconds from ten on.
    shown = [[f"{x:.0f}" if x >= 10.0 else f"{x:.2g}" for x in pair] for pair in arcsec.values()]
    promised, expected, updated = (
        f"{middle} arcsec (95 %: below {most})" for middle, most in shown
    )
    return (
        f"A slew of {forecast['angle_deg']:.0f}° about {forecast['axis']}, flown with J and K of the base model, should need a correction of {promised}; "
        f"with what was found it will need {expected}, and {updated} when flown with the new J and K."
    )


def parameters_text(values: Mapping[str, Mapping[str, Any]]) -> str:
    """Parameters with their sd in a sentence.

    >>> parameters_text({"tau": {"mean": 0.0512, "sd": 0.0013, "unit": "s"}})
    'Found: tau = 0.0512 ± 0.0013 s.'
    """
    return f"Found: {'; '.join(f'{plain(name)} = {value_text(v)}' for name, v in values.items())}."


def value_text(v: Mapping[str, Any]) -> str:
    """A value with its sd and unit.

    >>> value_text({"mean": 2.31e-6, "sd": 1.1e-7, "unit": "N m"})
    '(2.31 ± 0.11) 10⁻⁶ N m'
    """
    power = exponent(v["mean"], v["sd"])
    both = f"{number(v['mean'], v['sd'], power)} ± {number(v['sd'], v['sd'], power)}"
    unit = unit_text(v["unit"], power) if v["unit"] or power else ""
    return f"({both}) {unit}" if power else f"{both} {unit}".strip()


def significance(candidate: Mapping[str, Any], threshold: float) -> str:
    """One candidate in a word or two.

    >>> significance({"p_value": 1e-9, "dof": 3, "reason": None}, 1e-3)
    'significant'
    """
    if candidate["p_value"] is None:
        return candidate["reason"]
    if not candidate["dof"]:
        return "cannot be seen in this campaign"
    return "significant" if candidate["p_value"] < threshold else "not significant"


def alike_text(content: Mapping[str, Any], most: int = 8) -> list[str]:
    """Sentences on candidates that this campaign can hardly tell apart."""
    pairs = content["alike"][:most]
    said = [
        f"{plain(p['effects'][0]).capitalize()} and {plain(p['effects'][1])} can imitate each other (canonical correlation {p['correlation']:.2f})."
        for p in pairs
    ]
    if len(content["alike"]) > most:
        said.append(
            f"{len(content['alike']) - most} further pairs correlate beyond 0.6 (see diagnosis.json)."
        )
    return said or [
        "No two candidates can imitate each other beyond a canonical correlation of 0.6."
    ]
