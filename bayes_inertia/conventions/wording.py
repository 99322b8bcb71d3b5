"""Sentences of the check: verdict, proposal, and what the data cannot show."""

from __future__ import annotations

import difflib
import re
from collections.abc import Mapping, Sequence
from typing import Any

from bayes_inertia.campaign.sensors import ATTITUDE, RATE
from bayes_inertia.conventions.clocks import fixes_in_motion
from bayes_inertia.conventions.doubts import LAWS_IN_WORDS
from bayes_inertia.conventions.laws import CLOSURE, CONSERVATION, DIRECTION, DRIVE, Misfits, worst
from bayes_inertia.conventions.limits import LIMITS
from bayes_inertia.conventions.reading import Mistake, Reading, Stated, path_of
from bayes_inertia.conventions.search import Remedy, alike
from bayes_inertia.files import vocabulary

_WORDS: Mapping[str, Any] = vocabulary("conventions")
_NATURE: Mapping[str, Mapping[str, str]] = _WORDS["nature"]
_AS_CONTENT = ": the data would be as content if "


def invisible(
    misfits: Misfits, stated: Reading, singles: Sequence[Mistake], keys: Stated
) -> tuple[str, ...]:
    """Conventions that the data cannot show, and mistakes that leave them as consistent."""
    laws = misfits.of(stated)
    said = [*_by_nature(misfits, keys), *_without_telemetry(misfits, set(laws), keys)]
    largest = min(alike(worst(laws)), LIMITS.ordinary)
    for mistake in singles:
        if misfits.mends(mistake.mend(stated), largest):
            named = _each_once([change.key for change in mistake.changes])
            said.append(f"{', '.join(named)}{_AS_CONTENT}{mistake.words}")
    return tuple(dict.fromkeys(said))


def invisible_in_brief(cannot_show: Sequence[str]) -> list[str]:
    """The same in a few lines: equal keys together, with how many other values they could have.

    >>> alike = "columns.time.unit: the data would be as content if time is in "
    >>> invisible_in_brief([f"{alike}ms, not in s", f"{alike}us, not in s", "no fixes"])
    ['no fixes', 'other values would do as well: columns.time.unit (2)']
    >>> alike = f"actuators.wheel 1.axis, actuators.wheel 2.axis{_AS_CONTENT}"
    >>> invisible_in_brief([f"{alike}they are exchanged"])
    ['other values would do as well: actuators.*.axis (they are exchanged)']
    """
    brief = {_reason(line): s for lines in _NATURE.values() for line, s in lines.items()}
    nature = [
        short if " " in short else line.partition(":")[0]
        for line in cannot_show
        if (short := brief.get(_reason(line)))
    ]
    lines: list[str] = []
    others: dict[str, list[str]] = {}
    for line in cannot_show:
        keys, alike, words = line.partition(_AS_CONTENT)
        if alike:
            others.setdefault(_any_wheel(keys), []).append(words)
        elif _reason(line) not in brief:
            lines.append(line)
    if others:
        counted = [
            f"{keys} ({words[0] if len(words) == 1 else len(words)})"
            for keys, words in others.items()
        ]
        lines.append(f"other values would do as well: {', '.join(counted)}")
    return [*lines, f"as no campaign can: {'; '.join(nature)}"] if nature else lines


def _each_once(paths: Sequence[str]) -> list[str]:
    """Keys of which those of columns of several wheels are one."""
    ends = [path.split(".")[-2:] for path in paths]
    alike = (
        f"actuators.*.{'.'.join(end)}" if ends.count(end) > 1 and path.count(".") > 2 else path
        for path, end in zip(paths, ends, strict=True)
    )
    return list(dict.fromkeys(alike))


def _reason(line: str) -> str:
    """What follows the key of a line, where it has one."""
    return line.partition(": ")[2] or line


def _any_wheel(keys: str) -> str:
    """Keys of which those of several wheels are one."""
    wheel = r"^(wheels)\..*\.|^(actuators)\..*\.(?=axis$)"
    named = (
        re.sub(wheel, lambda part: f"{part[1] or part[2]}.*.", key) for key in keys.split(", ")
    )
    return " with ".join(dict.fromkeys(named))


def _by_nature(misfits: Misfits, keys: Stated) -> list[str]:
    """Conventions that no campaign of this kind can show."""
    campaign = misfits.campaign
    said = list(_NATURE["tensor"])
    if campaign.wheels:
        said += _NATURE["wheels"]
    if misfits.slews.fixes.any():
        tracker = f"{keys.key(ATTITUDE.first)}."
        said += [line.replace(f"{ATTITUDE.first}.", tracker) for line in _NATURE["tracker"]]
        if not fixes_in_motion(misfits):
            said.append(f"{_clock(keys, ATTITUDE.field)}: {_WORDS['fixes_at_rest']}")
    return said


def _clock(keys: Stated, stream: str) -> str:
    """The key of a stream's offset."""
    entries = keys.of(stream)
    return f"{path_of(entries[0]) if entries else f'columns.{stream}'}.offset_s"


def _without_telemetry(misfits: Misfits, laws: set[str], keys: Stated) -> list[str]:
    """Conventions that are invisible because telemetry is missing."""
    said = []
    if not laws & {CLOSURE, DIRECTION}:
        said.append("no two star-tracker fixes in a slew: nothing checks the rates' closure")
    if CONSERVATION not in laws:
        what = "neither wheel momentum often enough nor commands"
        said.append(f"{what}: nothing checks the rates against torques")
    if DRIVE not in laws and misfits.campaign.wheels:
        both = "torque commands and tachometers are not both there for every wheel"
        said.append(f"{both}: neither checks the other")
    if misfits.smoothed:
        unread = "rates that no sensor reads check no clock"
        if fixes_in_motion(misfits):
            said.append(f"{_clock(keys, ATTITUDE.field)}: {unread}")
        if misfits.own_axes and CONSERVATION not in laws:
            said.append(f"{_clock(keys, RATE.field)}: {unread}")
    return said


def verdict_in_words(
    misfits: Mapping[str, float],
    remedies: Sequence[Remedy],
    verdict: str,
    edits: Sequence[str],
    doubts: Sequence[str] = (),
    stale: bool = False,
) -> str:
    """The verdict in short sentences; `stale`: misfits [sd] are those of another rate bias."""
    places = [f"  - {doubt}" for doubt in doubts]
    if not misfits and not doubts:
        return "The telemetry holds nothing that the conventions could be checked against."
    largest = f"{max(misfits.values(), default=0.0):.2g} sd, {_WORDS['sd']}"
    size = f" (largest misfit {largest})" if misfits else ""
    if verdict == "consistent":
        agree = f"The conventions agree with the data{size}."
        return f"{agree} But the stated rate bias is stale." if stale else agree
    if verdict == "doubtful":
        begin = f"The data are doubtful under the stated conventions{size}:"
        return "\n".join([begin, *places, _WORDS["look_there"]])
    if not remedies:
        return "\n".join([_impossible(misfits), *places, _unmended(misfits, doubts)])
    best = remedies[0]
    # Noises that share a wrong unit only follow.
    keys = sum(not change.key.endswith("sigma") for change in best.mistake.changes)
    if not keys:
        cause = f"{best.mistake.words} ({best.before:.3g} -> {best.after:.2g} sd)"
        return f"{_impossible(misfits)}\nNo key of campaign.toml mends it: {cause}."
    what = "One change mends it" if keys == 1 else f"These {keys} changes together mend it"
    lines = edits or [f"{c.key} from {c.stated!r} to {c.mended!r}" for c in best.mistake.changes]
    late = all(change.key.endswith("offset_s") for change in best.mistake.changes)
    said = [
        _WORDS["clocks"].format(best.before) if late else _impossible(misfits),
        f"{what} ({best.before:.3g} -> {best.after:.2g} sd); it looks as if {best.mistake.words}:",
        *(f"  {line}" for line in lines),
        *places,
    ]
    if len(remedies) > 1:
        others = ", or if ".join(remedy.mistake.words for remedy in remedies[1:4])
        said.append(f"The data would be as content if {others}.")
    return "\n".join(said)


_OF_LAWS = tuple(LAWS_IN_WORDS.values())


def _unmended(misfits: Mapping[str, float], doubts: Sequence[str]) -> str:
    """Where to look if no change mends the laws that fail."""
    if any(not doubt.startswith(_OF_LAWS) for doubt in doubts):
        return str(_WORDS["advice"])
    fail = [law for law, misfit in misfits.items() if misfit > LIMITS.impossible]
    words = _WORDS["unmended"]
    return str(words["said"].format("; and for ".join(words[law] for law in fail)))


def _impossible(misfits: Mapping[str, float]) -> str:
    broken = max(misfits, key=lambda law: misfits[law])
    law, size = LAWS_IN_WORDS[broken], f"{misfits[broken]:.3g} sd ({_WORDS['sd']})."
    if misfits[broken] <= LIMITS.impossible:
        return f"The data hardly agree with the stated conventions: {law} is off by {size}"
    return f"The data are impossible under the stated conventions: {law} fails by {size}"


def edited_lines(text: str, mistake: Mistake) -> list[str]:
    """The lines of campaign.toml that a mistake's mending changes, as 'line 46: a = 1 -> a = 2'."""
    if not text:
        return []
    import tomlkit

    document: Any = tomlkit.parse(text)
    for change in mistake.changes:
        part, last = _place(document, change.key)
        part[last] = change.mended
    old, new = text.splitlines(), tomlkit.dumps(document).splitlines()
    said = []
    for tag, a, b, c, d in difflib.SequenceMatcher(None, old, new, autojunk=False).get_opcodes():
        if tag != "equal":
            before = " / ".join(line.strip() for line in old[a:b]) or "(nothing)"
            after = " / ".join(line.strip() for line in new[c:d])
            said.append(f"line {a + 1}: {before}  ->  {after}")
    return said


def _place(document: Any, key: str) -> tuple[Any, str]:
    """The table of campaign.toml that holds a key, and the key's last word; names may have dots."""
    part, rest = document, key
    while True:
        if isinstance(part, list):
            # Only parts of the environment may have no name: they are called as their type.
            named = {entry.get("name", str(entry.get("type")).replace("_", " ")): entry
                     for entry in part}  # fmt: skip
            word = max((name for name in named if rest.startswith(f"{name}.")), key=len)
            part, rest = named[word], rest.removeprefix(f"{word}.")
        word, _, left = rest.partition(".")
        if not left:
            return part, word
        part, rest = part[word], left
