"""What the report says, as pure functions of numbers: every sentence a reader acts on is made (and tested) here."""

# Printed text has typographic signs on purpose.
from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from bayes_inertia.inference.posterior import OBSERVABLE_ABOVE
from bayes_inertia.inference.residual_tests import REJECT_BELOW

# Nine tenths of the prior variance gone: the data, not the prior, make the number.
DETERMINED_ABOVE = 0.9
STRONG_CORRELATION = 0.9


@dataclass(frozen=True)
class Verdict:
    """The answer to "can I trust it?": `level` is "good", "caution" or "bad"; `title` one line; `sentences` why and what to do."""

    level: str
    title: str
    sentences: tuple[str, ...]


@dataclass(frozen=True)
class Quoted:
    """The uncertainty to use: the larger of the model's sd and the robust sd; `source` is "sd" or "robust sd"."""

    sd: float
    source: str


def quoted(sd: float, robust_sd: float | None) -> Quoted:
    """The uncertainty to quote.

    >>> quoted(1.0, 2.0), quoted(1.0, None)
    (Quoted(sd=2.0, source='robust sd'), Quoted(sd=1.0, source='sd'))
    """
    return (
        Quoted(robust_sd, "robust sd")
        if robust_sd is not None and robust_sd > sd
        else Quoted(sd, "sd")
    )


def contraction(sd: float, prior_sd: float) -> float:
    """Share of the prior variance that the data removed, not below zero.

    >>> contraction(0.5, 1.0), contraction(1.2, 1.0)
    (0.75, 0.0)
    """
    return max(0.0, 1.0 - (sd / prior_sd) ** 2)


def contraction_text(value: float) -> str:
    """Contraction as printed, rounded down so that it never seems to reach a threshold it misses.

    >>> contraction_text(0.9999977), contraction_text(0.541), contraction_text(0.98765)
    ('> 0.9999', '0.54', '0.987')
    """
    if value > 0.9999:
        return "> 0.9999"
    decimals = 2 if value < DETERMINED_ABOVE else 3 if value < 0.99 else 4
    return f"{math.floor(value * 10**decimals) / 10**decimals:.{decimals}f}"


def determined(value: float) -> str:
    """How far the campaign determines a parameter, from its contraction.

    >>> determined(0.99), determined(0.6), determined(0.2)
    ('determined', 'partly determined', 'not determined')
    """
    return (
        "determined"
        if value >= DETERMINED_ABOVE
        else "partly determined"
        if value > OBSERVABLE_ABOVE
        else "not determined"
    )


def interval_90(q05: float, q50: float, q95: float, sd: float, used: Quoted) -> tuple[float, float]:
    """90 % interval that belongs to the quoted uncertainty: the posterior's, widened about its median where the robust sd is larger.

    >>> interval_90(-1.6, 0.0, 1.7, 1.0, Quoted(2.0, "robust sd"))
    (-3.2, 3.4)
    """
    factor = used.sd / sd if sd > 0 else 1.0
    return q50 + factor * (q05 - q50), q50 + factor * (q95 - q50)


def exponent(mean: float, sd: float) -> int:
    """Power of ten factored out of a number in print, a multiple of three; 0 for ordinary numbers.

    >>> exponent(3.3, 1e-4), exponent(1.6e-3, 1e-5), exponent(2e-6, 1e-5)
    (0, -3, -6)
    """
    size = max(abs(mean), sd)
    return 0 if size == 0 or 5e-3 <= size < 1e4 else 3 * math.floor(math.log10(size) / 3.0 + 1e-9)


def number(value: float, sd: float, power: int = 0) -> str:
    """A value rounded where its uncertainty `sd` has its second digit, in units of 10^power.

    >>> number(3.3311733, 0.000196), number(0.0016886, 1.4e-5, -3), number(1234.5, 200.0)
    ('3.33117', '1.689', '1230')
    """
    if not (math.isfinite(value) and sd > 0 and math.isfinite(sd)):
        return f"{value / 10.0**power:.4g}"
    decimals = 1 - math.floor(math.log10(sd / 10.0**power))
    shown = round(value / 10.0**power, decimals)
    return f"{shown:.{max(0, decimals)}f}".replace("-", "−")


def unit_text(unit: str, power: int = 0) -> str:
    """A unit with a power of ten.

    >>> unit_text("kg m^2", -3), unit_text("")
    ('10⁻³ kg m²', '–')
    """
    exponents = str(power).translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))
    parts = [f"10{exponents}" if power else "", unit.replace("^2", "²").replace("^3", "³")]
    return " ".join(p for p in parts if p) or "–"


def listed(items: Sequence[str]) -> str:
    """Items as a list in a sentence.

    >>> listed(["a", "b", "c"]), listed(["a"])
    ('a, b and c', 'a')
    """
    return " and ".join([", ".join(items[:-1]), items[-1]] if len(items) > 1 else list(items))


def verdict(summary: Mapping[str, Any], n_slews: int) -> Verdict:
    """Can the result be trusted, why, and which uncertainty to use.

    Parameters
    ----------
    summary : see `Posterior.summary`. n_slews : slews of the campaign.
    """
    passed = {gate["name"]: gate["passed"] for gate in summary["gates"]}
    rows, fit = summary["parameters"], summary["fit"]
    has_robust = any(row["robust_sd"] is not None for row in rows.values())
    sentences = [*_sampler(passed.get("converged", True), summary["diagnostics"])]
    explained = passed.get("explained", True)
    misfit, small = _misfits(fit) if not explained else ([], [])
    if not explained:
        sentences += _unexplained(misfit, small, has_robust)
    else:
        says = next(
            (gate["says"] for gate in summary["gates"] if gate["name"] == "explained"),
            "the residuals are as predicted",
        )
        sentences.append(f"The model explains the data: {printed(says)}.")
    other = [
        printed(gate["says"])
        for gate in summary["gates"]
        if not gate["passed"] and gate["name"] not in ("converged", "explained")
    ]
    sentences += [f"{text[0].upper()}{text[1:]}." for text in other]
    sentences += _starts(fit["starts_agreeing"])
    if explained and not other:
        sentences += _uncertainty(rows, n_slews, has_robust)
    sentences += _undetermined(rows)
    return Verdict(
        *_headline(passed, misfit, bool(other), rows, fit["starts_agreeing"]), tuple(sentences)
    )


def _headline(
    passed: Mapping[str, bool],
    misfit: list[str],
    other: bool,
    rows: Mapping[str, Any],
    starts: Sequence[int],
) -> tuple[str, str]:
    converged, explained = passed.get("converged", True), passed.get("explained", True)
    if not converged and not explained:
        return (
            "bad",
            "Do not use these numbers yet: the sampler has not converged, and the model does not explain the data.",
        )
    if not converged:
        return "bad", "Do not use these numbers yet: the sampler has not converged."
    if not explained and misfit:
        return (
            "bad",
            "Use with care: the model does not explain the data, something is missing from it.",
        )
    if not explained:
        return (
            "caution",
            "Usable, but the stated noise is wrong: the residuals are smaller than it predicts.",
        )
    if other:
        return "bad", "Do not use these numbers yet: a gate failed."
    if starts[0] < starts[1]:
        return "caution", "Usable with care: not every start of the optimizer led to this solution."
    if any(_level(row) == "not determined" for row in rows.values()):
        return (
            "caution",
            "The fit can be trusted, but this campaign does not determine every parameter.",
        )
    return "good", "Yes, these numbers can be trusted."


def _sampler(converged: bool, about: Mapping[str, Any]) -> list[str]:
    effective = min(about["ess_bulk_min"], about["ess_tail_min"])
    if converged:
        numbers = f"nested R-hat {about['nested_rhat_max']:.4f}, at least {effective:,.0f} effective samples of every parameter"
        return [f"The sampler has converged: independently started ensembles agree ({numbers})."]
    kept = about["steps"] - about["discarded"]
    reasons = [
        (
            about["nested_rhat_max"] >= 1.01,
            f"its ensembles disagree (nested R-hat {about['nested_rhat_max']:.3f}, wanted below 1.01)",
        ),
        (
            effective < 400.0,
            f"it has only {effective:,.0f} effective samples of the worst parameter (wanted 400)",
        ),
        (
            kept < 20.0 * about["tau_max"],
            f"{kept} kept steps are too few for an autocorrelation time of {about['tau_max']:.1f} steps (wanted 20 times it)",
        ),
    ]
    said = listed([text for failed, text in reasons if failed]) or "its gate failed"
    return [
        f"The sampler has not converged: {said}. Run it for more steps before using any number below."
    ]


def _misfits(fit: Mapping[str, Any]) -> tuple[list[str], list[str]]:
    """Channels with residuals too large or structured, and channels with residuals that are only too small."""
    large, small = [], []
    for name in ("rate", "attitude", "momentum"):
        verdict = channel_verdict(
            fit["reduced_chi2"][name], fit["interval_99"][name], fit["p_white"][name]
        )
        if verdict.startswith(("too large", "structured")):
            large.append(name)
        elif verdict.startswith("smaller"):
            small.append(name)
    total = fit["reduced_chi2"]["total"]
    if not large and not small and total is not None:
        (large if total > 1.0 else small).append("all channels together")
    return large, small


def _unexplained(large: list[str], small: list[str], has_robust: bool) -> list[str]:
    said = []
    if large:
        said.append(
            f"The residuals ({listed(large)}) are larger, or more structured, than the model and the stated noise predict: an effect is missing."
        )
        if has_robust:
            said.append(
                "Use the robust sd, which is what the slews themselves support, and do not read the model's sd as the uncertainty."
            )
        else:
            said.append(
                "With too few slews for a robust sd, no uncertainty below can be defended: treat the sd as a lower limit."
            )
        said.append(
            "Run “bayes-inertia diagnose” to find the missing effect; a bias of the estimate that all slews share shows in neither sd."
        )
    elif small:
        said.append(
            f"The residuals ({listed(small)}) are smaller than the stated noise: the sd is probably too large, not too small."
        )
        said.append("Correct the stated sigma of that sensor in campaign.toml and fit again.")
    return said


def _starts(agreeing: Sequence[int]) -> list[str]:
    if agreeing[0] >= agreeing[1]:
        return []
    return [
        f"Only {agreeing[0]} of {agreeing[1]} starts of the optimizer reached this solution: "
        "the others ended in worse ones, so check the signs and units of the telemetry."
    ]


def _uncertainty(rows: Mapping[str, Any], n_slews: int, has_robust: bool) -> list[str]:
    """Which uncertainty to use where the model explains the data."""
    if not has_robust:
        plural = f"{n_slews} slews are" if n_slews != 1 else "One slew is"
        return [
            f"{plural} too few for a robust sd: the quoted sd is the model's own and rests on the model and the stated noise being right."
        ]
    own = 1.0 / math.sqrt(
        2.0 * max(n_slews - 1, 1)
    )  # relative error of a standard deviation from n values
    wide = [
        name
        for name, row in rows.items()
        if row["robust_sd"] is not None and row["robust_sd"] > (1.0 + 2.0 * own) * row["sd"]
    ]
    spread = f"a robust sd from {n_slews} slews is itself uncertain by about {100.0 * own:.0f} %"
    if wide:
        return [
            f"The slews scatter more than the model's sd for {listed(wide)}: use the quoted (larger) uncertainty, and mind that {spread}."
        ]
    return [
        f"Use the quoted uncertainty, the larger of the two in each row; the model's sd and what the slews support agree ({spread})."
    ]


def _level(row: Mapping[str, Any]) -> str:
    return determined(contraction(quoted(row["sd"], row["robust_sd"]).sd, row["prior_sd"]))


def _undetermined(rows: Mapping[str, Any]) -> list[str]:
    names = [name for name, row in rows.items() if _level(row) == "not determined"]
    if not names:
        return []
    return [
        f"Not determined by this campaign: {listed(names)}; what is printed for {'it' if len(names) == 1 else 'them'} is mostly the prior."
    ]


def channel_verdict(
    reduced: float | None, interval: Sequence[float] | None, p_white: float | None
) -> str:
    """One channel's fit in words.

    Parameters
    ----------
    reduced : reduced chi^2. interval : its 99 % interval if the model is right. p_white : of no autocorrelation. None: not tested.

    >>> channel_verdict(1.0, (0.9, 1.1), 0.5)
    'as predicted'
    """
    if reduced is None or interval is None:
        return "no data"
    coloured = p_white is not None and p_white < REJECT_BELOW
    # Just outside a 99 % interval happens once in a hundred; the gate rejects at one in a thousand.
    slack = 0.28 * (interval[1] - interval[0]) / 2.0
    if reduced > interval[1] + slack:
        return "too large" + (" and structured in time" if coloured else "")
    if coloured:
        return "structured in time"
    if reduced < interval[0] - slack:
        return "smaller than the stated noise"
    return "as predicted" if interval[0] <= reduced <= interval[1] else "borderline"


def whiteness_text(p_white: float | None) -> str:
    """The whiteness test in words.

    >>> whiteness_text(None), whiteness_text(0.0), whiteness_text(0.39)
    ('not tested', 'no (p < 1e-6)', 'yes (p = 0.39)')
    """
    if p_white is None:
        return "not tested"
    p = "p < 1e-6" if p_white < 1e-6 else f"p = {p_white:.2g}"
    return f"{'no' if p_white < REJECT_BELOW else 'yes'} ({p})"


def correlations(names: Sequence[str], matrix: Sequence[Sequence[float]]) -> list[str]:
    """Sentences on pairs of parameters that the data determine only together, strongest first.

    >>> correlations(["Jxx", "K1"], [[1.0, -0.95], [-0.95, 1.0]])
    ['Jxx and K1 are hard to tell apart (correlation −0.95): raising one while lowering the other fits nearly as well.']
    """
    found = [
        (matrix[i][j], a, names[j])
        for i, a in enumerate(names)
        for j in range(i)
        if abs(matrix[i][j]) > STRONG_CORRELATION
    ]
    said = []
    for r, a, b in sorted(found, key=lambda f: -abs(f[0])):
        trade = (
            "raising one while lowering the other" if r < 0 else "raising or lowering both together"
        )
        size = "beyond 0.999" if abs(r) > 0.999 else f"{abs(r):.{2 if abs(r) < 0.985 else 3}f}"
        sign = "−" if r < 0 else "+"
        shown = size.replace("0.999", f"{sign}0.999") if abs(r) > 0.999 else sign + size
        said.append(
            f"{b} and {a} are hard to tell apart (correlation {shown}): {trade} fits nearly as well."
        )
    return said


def groups(rows: Mapping[str, Any]) -> dict[str, list[str]]:
    """Parameter names by how far they are determined (contraction of the quoted uncertainty)."""
    found: dict[str, list[str]] = {"determined": [], "partly determined": [], "not determined": []}
    for name, row in rows.items():
        found[_level(row)].append(name)
    return found


def limits(
    *, drive: str, effects: Sequence[str], channels: Sequence[str], wheels: int, n_slews: int
) -> list[str]:
    """What no fit of this campaign can tell, whatever its numbers say.

    Parameters
    ----------
    channels : of "attitude" and "momentum" those that were measured and compared. wheels : how many the spacecraft has.
    """
    said = [
        "With wheels as the only torque, the inertia tensor and a common gain of all wheels cannot be told apart: (J, h) and (s J, s h) give the same "
        "telemetry. The absolute size of J is as good as the stated wheel momentum: if that is 1 % wrong, so is J, and no number here shows it."
        if wheels
        else "Nothing of known size turns the body: there are no wheels. A free body shows only the ratios of its moments of inertia; the absolute size of J "
        "is that of the prior, and no number here shows how wrong it is."
    ]
    if "wheel_torque_gain" in effects:
        said.append(
            "Wheel gains are fitted along: the part common to all wheels, and so the absolute size of J, comes from their prior."
        )
    if "inertia_change" in effects:
        said.append(
            "J is the tensor before its change. For slews after it add the change, element by element: that is the tensor to fly with."
        )
    if not wheels:
        pass
    elif drive == "measured":
        said.append(
            "The wheels' measured momentum is the input of the model: errors of commands do not matter, errors of the tachometers do."
        )
    else:
        shows = (
            "shows in its momentum residuals"
            if "momentum" in channels
            else "shows only in the motion of the body: there are no tachometers"
        )
        said.append(
            f"The commanded torques are the input of the model: a wheel that does not do what it is told {shows}."
        )
    if "attitude" not in channels:
        said.append(
            "There are no star-tracker fixes: nothing measures angles independently of the rate sensor, so K rests mostly on its prior and on dynamics."
        )
    if n_slews < 5:
        slews = "slew" if n_slews == 1 else "slews"
        said.append(
            f"The campaign has {n_slews} {slews}: what the slews disagree about can hardly be seen. Five about different axes are a good campaign."
        )
    said.append(
        "J is about the centre of mass, in body axes, and Jxy, Jxz, Jyz are elements of the tensor (not products with the opposite sign). As in the campaign "
        "file, it leaves the wheels' spin inertia out, unless the file says includes_wheel_spin = true."
    )
    return said


def averaged_over(summary: Mapping[str, Any]) -> str:
    """What J and K are averaged over, with its probabilities; empty where they are not.

    >>> averaged_over({"averaged_over": [{"effects": ["rate_bias", "a_b"], "probability": 0.7}, {"effects": ["rate_bias", "c"], "probability": 0.3}]})
    'a b 70 %, c 30 %'
    """
    rows = summary.get("averaged_over", [])
    sure = set.intersection(*(set(row["effects"]) for row in rows)) if rows else set()
    return ", ".join(
        f"{listed([name.replace('_', ' ') for name in row['effects'] if name not in sure])} {100.0 * row['probability']:.0f} %"
        for row in rows
    )


def meaning(name: str) -> str:
    """What a parameter is.

    >>> meaning("Jxy"), meaning("K2"), meaning("wheel_friction.coulomb1")
    ('inertia tensor element xy', 'rate-sensor scale factor, axis 2', 'wheel friction: coulomb1')
    """
    if "." in name:
        effect, parameter = name.split(".", 1)
        return f"{effect.replace('_', ' ')}: {parameter.replace('_', ' ')}"
    if name[:1] == "J" and len(name) == 3:
        return (
            f"moment of inertia, body {name[1]}"
            if name[1] == name[2]
            else f"inertia tensor element {name[1:]}"
        )
    if name[:1] == "K" and name[1:].isdigit():
        return f"rate-sensor scale factor, axis {name[1:]}"
    return name.replace("_", " ")


def printed(text: str) -> str:
    """A sentence written for a terminal, as it is printed.

    >>> printed("reduced chi^2 2.7: use `diagnose` and robust_sd")
    'reduced χ² 2.7: use diagnose and robust sd'
    """
    return text.replace("`", "").replace("chi^2", "χ²").replace("robust_sd", "robust sd")


def discount_text(discount: float) -> str:
    """How much one channel of one slew counts.

    >>> discount_text(1.0), discount_text(0.0026), discount_text(0.5)
    ('full', '1/385', '1/2.0')
    """
    if discount > 0.995:
        return "full"
    return f"1/{1.0 / discount:.1f}" if discount > 0.1 else f"1/{1.0 / discount:.0f}"
