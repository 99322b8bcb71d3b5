"""What the check says: the verdict, the proposal, and the lines of campaign.toml it changes."""

from __future__ import annotations

import difflib
from collections.abc import Mapping, Sequence
from typing import Any

from bayes_inertia.conventions import limits
from bayes_inertia.conventions.doubts import LAWS_IN_WORDS
from bayes_inertia.conventions.hypothesis import Mistake
from bayes_inertia.conventions.search import Remedy


def verdict_in_words(
    misfits: Mapping[str, float],
    remedies: Sequence[Remedy],
    verdict: str,
    edits: Sequence[str],
    doubts: Sequence[str] = (),
    stale: bool = False,
) -> str:
    """The verdict in a few short sentences.

    `misfits` [sd]. `stale`: whether the misfits are those of another rate bias than the stated one.
    """
    places = [f"  - {doubt}" for doubt in doubts]
    if not misfits and not doubts:
        return "The telemetry holds nothing that the conventions could be checked against."
    largest = max(misfits.values(), default=0.0)
    if verdict == "consistent":
        agree = f"The conventions agree with the data (largest misfit {largest:.2g} sd, {_SD})."
        return f"{agree} But the stated rate bias is stale." if stale else agree
    if verdict == "doubtful":
        size = f" (largest misfit {largest:.2g} sd, {_SD})" if misfits else ""
        begin = f"The data are doubtful under the stated conventions{size}:"
        return "\n".join([begin, *places, _LOOK])
    if not remedies:
        advice = _NOTHING_MENDS if all(doubt.startswith(_OF_LAWS) for doubt in doubts) else _CAUSE
        return "\n".join([_impossible(misfits), *places, advice])
    best = remedies[0]
    keys = len(best.mistake.changes) - best.mistake.companions
    if not keys:
        cause = f"{best.mistake.words} ({best.before:.3g} -> {best.after:.2g} sd)"
        return f"{_impossible(misfits)}\nNo key of campaign.toml mends it: {cause}."
    what = "One change mends it" if keys == 1 else f"These {keys} changes together mend it"
    lines = edits or _change_in_words(best.mistake)
    said = [
        _clocks(best) if _late(best) else _impossible(misfits),
        f"{what} ({best.before:.3g} -> {best.after:.2g} sd); it looks as if {best.mistake.words}:",
        *(f"  {line}" for line in lines),
        *places,
    ]
    if len(remedies) > 1:
        others = ", or if ".join(remedy.mistake.words for remedy in remedies[1:4])
        said.append(f"The data would be as content if {others}.")
    return "\n".join(said)


_OF_LAWS = tuple(LAWS_IN_WORDS.values())
_NOTHING_MENDS = (
    "No single change of a unit, sign, order, frame or clock mends it, and no pair that was tried: "
    "look for a torque that the telemetry does not tell, or for an inertia tensor that is wrong "
    "by more than a factor of two."
)
_LOOK = "Look there before you fit."
_CAUSE = "No change of a convention mends it: mend what is said above, and ask again."
_SD = "in sds of what noise, a wrong J of 30 % and physical effects can make"


def _impossible(misfits: Mapping[str, float]) -> str:
    broken = max(misfits, key=lambda law: misfits[law])
    if misfits[broken] <= limits.IMPOSSIBLE:
        return (
            f"The data hardly agree with the stated conventions: {LAWS_IN_WORDS[broken]} is off by "
            f"{misfits[broken]:.3g} sd ({_SD})."
        )
    return (
        f"The data are impossible under the stated conventions: {LAWS_IN_WORDS[broken]} fails by "
        f"{misfits[broken]:.3g} sd ({_SD})."
    )


def _late(remedy: Remedy) -> bool:
    return all(change.key.endswith("offset_s") for change in remedy.mistake.changes)


def _clocks(remedy: Remedy) -> str:
    return (
        "The clocks of the streams do not agree, by more than any sensor is late "
        f"({remedy.before:.3g} sd of the sensors' noise)."
    )


def _change_in_words(mistake: Mistake) -> list[str]:
    return [f"{c.key} from {c.stated!r} to {c.mended!r}" for c in mistake.changes]


def edited_lines(text: str, mistake: Mistake) -> list[str]:
    """The lines of campaign.toml that a mistake's mending changes.

    Returns: such as 'line 46: a = 1 -> a = 2'; empty without text.
    """
    if not text:
        return []
    import tomlkit

    document: Any = tomlkit.parse(text)
    for change in mistake.changes:
        *path, last = change.key.split(".")
        part: Any = document
        for key in path:
            if isinstance(part, list):
                part = next(entry for entry in part if entry["name"] == key)
            else:
                part = part[key]
        part[last] = change.mended
    old, new = text.splitlines(), tomlkit.dumps(document).splitlines()
    said = []
    for tag, a, b, c, d in difflib.SequenceMatcher(None, old, new, autojunk=False).get_opcodes():
        if tag != "equal":
            before = " / ".join(line.strip() for line in old[a:b]) or "(nothing)"
            after = " / ".join(line.strip() for line in new[c:d])
            said.append(f"line {a + 1}: {before}  ->  {after}")
    return said
