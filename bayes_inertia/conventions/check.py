"""The whole check: a campaign as stated, what its data say of it, and which change mends it.

Keys that were written in the same wrong unit as a mended one: noises, and the prior's products.

No law shows them. A stated noise that agrees with the noise of the readings while both are read in
the wrong unit was written in that unit too, and must be mended with it.
"""

from __future__ import annotations

import tomllib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Literal

import numpy as np

from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.description import Description
from bayes_inertia.campaign.hardware import DirectionSensor
from bayes_inertia.campaign.inspection import with_dirt_masked
from bayes_inertia.campaign.parsed_description import parse_description
from bayes_inertia.campaign.reader import read_unmasked
from bayes_inertia.campaign.schema import UNITS
from bayes_inertia.campaign.sensors import BY_KEY, SensorStream
from bayes_inertia.conventions import wording
from bayes_inertia.conventions.candidates import mistakes
from bayes_inertia.conventions.clocks import (
    Clocks,
    clocks,
    known_offsets,
    shifted_misfit,
    streams_apart,
)
from bayes_inertia.conventions.columns import copied_commands, faulty_columns, without_sign
from bayes_inertia.conventions.devices import device_mistakes
from bayes_inertia.conventions.doubts import (
    Factors,
    broken_limits,
    dirt_of,
    doubtful_places,
    factors,
)
from bayes_inertia.conventions.laws import (
    DIRECTION,
    DRIVE,
    Misfits,
    misfits_of,
    noise_ratios,
    worst,
)
from bayes_inertia.conventions.limits import LIMITS
from bayes_inertia.conventions.reading import (
    LIKE_THE_FIRST,
    Columns,
    KeyChange,
    Mistake,
    Reading,
    Teller,
    ToldTorques,
    as_written,
    description_for,
    in_place_of_the_first,
    in_words,
    of_wheels,
    readings_of,
    stated_columns,
    untold,
)
from bayes_inertia.conventions.search import Judgement, Remedy, judged
from bayes_inertia.conventions.wording import invisible
from bayes_inertia.errors import CampaignError
from bayes_inertia.files import description_path, read_bytes, text_of
from bayes_inertia.maths.blas_threads import on_one_blas_thread
from bayes_inertia.maths.values import json_ready


def what_mends(
    misfits: Misfits,
    judgement: Judgement,
    singles: Sequence[Mistake],
    columns: Columns,
    differ: Factors | None,
) -> tuple[tuple[Remedy, ...], Clocks]:
    """All that makes the data consistent, the best first, and what is said of the clocks."""
    mending, clock = judgement.remedies, Clocks()
    if not mending:
        clock = clocks(misfits, judgement.reading, columns)
        mending = tuple(
            remedy
            for remedy in clock.remedies
            if shifted_misfit(misfits, judgement.reading, remedy) < LIMITS.ordinary
        )
    # Two mistakes at once are less likely than one in a stream.
    first = mending[0].mistake if mending else None
    if first is None or (len(first.changes) > 1 and first not in singles):
        return _of_streams(misfits, judgement.reading, columns, differ) or mending, clock
    exact = _of_factor(misfits, judgement.reading, columns, differ)
    better = [remedy for remedy in exact if remedy.after < LIMITS.clearly * mending[0].after]
    return (*mending, *better), clock


def _of_streams(
    misfits: Misfits, reading: Reading, columns: Columns, differ: Factors | None
) -> tuple[Remedy, ...]:
    """Faults of one stream: its factor, its signs, or its clock by a known offset."""
    if exact := _of_factor(misfits, reading, columns, differ):
        return exact
    before = worst(misfits.of(reading))
    if before <= LIMITS.impossible:
        return ()
    unsigned = without_sign(misfits, reading, before)
    return known_offsets(misfits, reading, columns) if unsigned is None else (unsigned,)


def _of_factor(
    misfits: Misfits, reading: Reading, columns: Columns, differ: Factors | None
) -> tuple[Remedy, ...]:
    """Spin inertias that are wrong by the factor between commands and tachometers."""
    mistake = None if differ is None else differ.mistake(misfits.campaign, columns)
    if mistake is None:
        return ()
    before, after = (worst(misfits.of(r)) for r in (reading, mistake.mend(reading)))
    mends = after < min(LIMITS.pair_ordinary, before / LIMITS.improvement)
    return (Remedy(mistake, before, after),) if mends else ()


FORMAT = "bayes-inertia-doctor/1"
Verdict = Literal["consistent", "doubtful", "wrong"]


@dataclass(frozen=True)
class ConventionChange:
    """One key of campaign.toml that should be changed, or might be.

    Parameters
    ----------
    key : str
        Path of the key, such as "columns.rate.unit" or "wheels.x.axis".
    stated, mended : object
        Its value as written, and the value that it should have.
    sigma_before, sigma_after : float
        Worst misfit of all laws, as stated and with the whole proposal [sd].
    proposal : int
        Changes with the same number belong together; 1 is proposed, the data hold the others equal.
    words : str
        What the proposal means, as the end of a sentence that begins with "It looks as if".
    """

    key: str
    stated: Any
    mended: Any
    sigma_before: float
    sigma_after: float
    proposal: int
    words: str


@dataclass(frozen=True)
class ConventionsCheck:
    """Whether a campaign's conventions are those of its data.

    Parameters
    ----------
    campaign : str
        Name of the campaign.
    verdict : {"consistent", "doubtful", "wrong"}
        Whether the data agree with the stated conventions. Doubtful: a law fails that no change of
        convention mends, a column is dead or stands for two, or a limit is far exceeded.
    sentence : str
        The verdict in words.
    misfits : dict of str to float
        Misfit of each law that the telemetry could be held against, in standard deviations of what
        noise and undisclosed physics may leave.
    changes : tuple of ConventionChange
        What makes the data consistent, the proposal first.
    edits : tuple of str
        The lines of campaign.toml that the proposal changes, as "line 12: old -> new".
    cannot_show : tuple of str
        Conventions that this telemetry says nothing about.
    remarks : tuple of str
        What is physical although it looks like a wrong convention.
    doubts : tuple of str
        What is doubtful, and where: channel, axis or wheel, slew, sds.
    dirt : tuple of dict
        Faults of the telemetry, as `Dirt.json` writes them.
    """

    campaign: str
    verdict: Verdict
    sentence: str
    misfits: dict[str, float]
    changes: tuple[ConventionChange, ...] = ()
    edits: tuple[str, ...] = ()
    cannot_show: tuple[str, ...] = ()
    remarks: tuple[str, ...] = ()
    doubts: tuple[str, ...] = ()
    dirt: tuple[dict[str, Any], ...] = ()

    def doubting(self, doubts: Sequence[str]) -> ConventionsCheck:
        """The same with more doubts.

        Parameters
        ----------
        doubts : sequence of str
            What is doubtful, and where.

        Returns
        -------
        ConventionsCheck
            Doubtful, unless it is wrong; the same where a change mends it.
        """
        if not doubts or self.changes:
            return self
        every = (*doubts, *self.doubts)
        verdict: Verdict = "wrong" if self.verdict == "wrong" else "doubtful"
        said = wording.verdict_in_words(self.misfits, (), verdict, (), every)
        return replace(self, verdict=verdict, sentence=said, doubts=every)

    def json(self) -> dict[str, Any]:
        """The check as `doctor CAMPAIGN --json` prints it.

        Returns
        -------
        dict
            With the keys format, verdict, changes, cannot_show, dirt, and more.
        """
        content = asdict(self)
        names = {"stated": "from", "mended": "to"}
        content["changes"] = [
            {names.get(key, key): value for key, value in change.items()}
            for change in content["changes"]
        ]
        return json_ready({"format": FORMAT, **content})


@dataclass(frozen=True)
class _Case:
    """A campaign, the same with nothing masked, its campaign.toml if it has one, told torques."""

    campaign: Campaign
    written: Campaign
    quick: bool
    torques: ToldTorques
    text: str = ""
    description: Description | None = None


def check_conventions(
    campaign: Campaign | str | Path, told: Teller = untold, *, quick: bool = False
) -> ConventionsCheck:
    """The check; `told`: what effects, but for wheels, do to the body by name of the slew."""
    if isinstance(campaign, Campaign):
        return _checked(_Case(campaign, campaign, quick, ToldTorques(campaign, told)))
    path = description_path(campaign)
    text = text_of(read_bytes(path), str(path))
    written = read_unmasked(campaign)
    masked = with_dirt_masked(written)
    if any(dirt.kind == "gap" and dirt.channel == "torque" for dirt in masked.dirt):
        # A fit needs no commands where tachometers are; here both are held against each other.
        written = read_unmasked(campaign, keep_commands=True)
        masked = replace(with_dirt_masked(written), dirt=masked.dirt)
    description = parse_description(text, str(path))
    case = _Case(masked, written, quick, ToldTorques(masked, told), text, description)
    if _suspect(written, masked):
        # Readings that are impossible in numbers are in a wrong unit, or marks for missing values.
        check = _checked(replace(case, campaign=written))
        if check.changes:
            return check
    return _checked(case)


def _suspect(written: Campaign, masked: Campaign) -> bool:
    """Whether so many readings are unbelievable that their unit may be to blame."""
    for channel in ("rate", "wheel_momentum"):
        before, after = (
            np.concatenate([np.zeros(0), *map(np.ravel, readings_of(c, channel))])
            for c in (written, masked)
        )
        count = np.isfinite(before).sum()
        few = np.isfinite(after).sum() < LIMITS.believable_share * count
        if few and np.nanmax(np.abs(before)) < LIMITS.largest_number:
            return True
    return False


def refuse_impossible(campaign: Campaign | str | Path, told: Teller = untold) -> ConventionsCheck:
    """Raise an error if data are impossible as stated; quick where they are not."""
    check = check_conventions(campaign, told, quick=True)
    if check.verdict == "wrong":
        where = "" if isinstance(campaign, Campaign) else str(description_path(campaign))
        what = f"{check.sentence}\nMend the description"
        advice = "`bayes-inertia doctor CAMPAIGN` says more, --anyway goes on nevertheless"
        raise CampaignError(what, where=where, advice=advice)
    return check


@on_one_blas_thread
def _checked(case: _Case) -> ConventionsCheck:
    """The check of a campaign: by its first sensors, then by each further one in their place."""
    case = _without_locked_wheels(case)
    check = _of_first_sensors(case)
    if check.changes:
        return check
    written = dict(in_place_of_the_first(case.written))
    for name, alone in in_place_of_the_first(case.campaign):
        description = description_for(case.description, name)
        other = _of_first_sensors(
            _Case(alone, written[name], True, case.torques, case.text, description)
        )
        if other.verdict == "wrong":
            return replace(other, sentence=f"With the sensor {name}: {other.sentence}")
        check = check.doubting([d for d in other.doubts if d not in check.doubts])
    said = [
        f"{name}: no law is held against it; the laws here are those of rate sensors, star "
        "trackers and direction sensors in slews of a turn or less"
        for name, hardware in case.campaign.more_sensors
        if type(hardware) not in LIKE_THE_FIRST
        and not (isinstance(hardware, DirectionSensor) and DIRECTION in check.misfits)
    ]
    return replace(check, cannot_show=(*check.cannot_show, *said))


def _without_locked_wheels(case: _Case) -> _Case:
    """The case without wheels that are said to be locked: nothing that they read counts."""
    written = case.written.without_locked_wheels()
    if written is case.written:
        return case
    # Others that rest are locked by the reader, and read zero.
    running = replace(case.campaign, wheels=case.written.wheels).without_locked_wheels()
    description = case.description
    if description is not None:
        description = of_wheels(description, [wheel.name for wheel in written.wheels])
    return replace(case, campaign=running, written=written, description=description)


def _of_first_sensors(case: _Case) -> ConventionsCheck:
    """The same by the first rate sensor and the first star tracker."""
    check = _in_keys_of_format_1(case)
    told = partial(in_words, description=case.description)
    lists = ("cannot_show", "remarks", "doubts")
    said: dict[str, Any] = {name: tuple(map(told, getattr(check, name))) for name in lists}
    return replace(check, sentence=told(check.sentence), **said)


def _in_keys_of_format_1(case: _Case) -> ConventionsCheck:
    """The same, whose changes alone have the keys of the campaign's own format."""
    campaign, written = case.campaign, case.written
    columns = stated_columns(campaign, case.description)
    # Numbers whose squares overflow break every law, infinitely.
    with np.errstate(over="ignore", invalid="ignore"):
        faults = faulty_columns(written, columns)
        misfits = misfits_of(campaign)
        if misfits is None:  # The streams do not meet.
            doubts = (*faults, *streams_apart(written, columns), *broken_limits(written, {}))
            verdict: Verdict = "doubtful" if doubts else "consistent"
            said = wording.verdict_in_words({}, (), verdict, (), doubts)
            return ConventionsCheck(campaign.name, verdict, said, {}, doubts=doubts)
        if not misfits.own_axes:
            columns = {key: entry for key, entry in columns.items() if key != "rate"}
        if misfits.fit(DIRECTION, misfits.stated()) is None:
            columns = {key: e for key, e in columns.items() if not key.startswith("sensors.")}
        return _held_against_laws(case, misfits, columns, faults)


def _held_against_laws(
    case: _Case, misfits: Misfits, columns: Columns, faults: tuple[str, ...]
) -> ConventionsCheck:
    campaign, stated = case.campaign, misfits.stated(case.torques)
    of_devices = device_mistakes(case.torques, columns, case.description)
    singles = sorted((*mistakes(campaign, columns), *of_devices), key=lambda m: m.rarity)
    judgement = judged(misfits, stated, singles)
    reading = judgement.reading
    differ = None if faults else factors(misfits, reading)
    # What a column that is no reading makes wrong is no convention.
    mending: tuple[Remedy, ...] = ()
    clock = Clocks()
    if not faults:
        mending, clock = what_mends(misfits, judgement, singles, columns, differ)
    if misfits.smoothed:  # Rates that all sensors tell have no clock, and signs of the wheels'.
        mending, clock = tuple(r for r in mending if not _needs_rates(r)), Clocks()
    wrong = bool(mending) or worst(misfits.of(reading)) > LIMITS.hopeless
    doubts = faults + _doubts(case, misfits, columns, reading, differ, bool(mending))
    verdict: Verdict = "wrong" if wrong else "doubtful" if doubts else "consistent"
    if mending:
        reading = mending[0].mistake.mend(stated if mending[0] in judgement.remedies else reading)
        mending = _completed(mending, case)
    edits = wording.edited_lines(case.text, mending[0].mistake) if mending else ()
    fits = misfits.of(stated if wrong else reading)
    by_law = {law: round(fit.worst, 3) for law, fit in fits.items()}
    stale = not np.array_equal(reading.bias_B, stated.bias_B)
    return ConventionsCheck(
        campaign=campaign.name,
        verdict=verdict,
        sentence=wording.verdict_in_words(by_law, mending, verdict, edits, doubts, stale),
        misfits=by_law,
        changes=_changes(mending),
        edits=tuple(edits),
        cannot_show=() if case.quick else invisible(misfits, reading, () if wrong else singles),
        remarks=clock.remarks,
        doubts=doubts,
        dirt=() if case.quick else dirt_of(campaign, misfits, stated, reading),
    )


def _needs_rates(remedy: Remedy) -> bool:
    """Whether a remedy rests on rates that a sensor reads: one of a clock, or of no key."""
    keys = [change.key for change in remedy.mistake.changes]
    return not keys or any(key.endswith(".offset_s") for key in keys)


def _completed(mending: tuple[Remedy, ...], case: _Case) -> tuple[Remedy, ...]:
    """Remedies in the keys of the description, the first with the keys that share its unit."""
    keys = tomllib.loads(case.text) if case.text else {}
    first = with_companions(mending[0].mistake, case.campaign, keys)
    mending = (replace(mending[0], mistake=first), *mending[1:])
    return tuple(replace(r, mistake=as_written(r.mistake, case.description)) for r in mending)


def _doubts(
    case: _Case,
    misfits: Misfits,
    columns: Columns,
    reading: Reading,
    differ: Factors | None,
    mended: bool,
) -> tuple[str, ...]:
    """Doubtful channels and places; of mended data only where commands and tachometers differ."""
    factor = () if differ is None else differ.words()
    if mended:
        return factor
    written = case.written
    holds = {law: fit.worst < LIMITS.ordinary for law, fit in misfits.of(reading).items()}
    return (
        *(() if holds.get(DRIVE, True) else copied_commands(written, columns)),
        *doubtful_places(misfits, reading),
        *factor,
        *streams_apart(written, columns),
        *broken_limits(written, holds),
    )


def _changes(mending: Sequence[Remedy]) -> tuple[ConventionChange, ...]:
    """The keys to change; none where the first cause is in no key."""
    if mending and not mending[0].mistake.changes:
        return ()
    return tuple(
        ConventionChange(
            change.key,
            change.stated,
            change.mended,
            remedy.before,
            remedy.after,
            number,
            remedy.mistake.words,
        )
        for number, remedy in enumerate(mending, 1)
        for change in remedy.mistake.changes
    )


def with_companions(mistake: Mistake, campaign: Campaign, written: Mapping[str, Any]) -> Mistake:
    """A mistake with the keys of campaign.toml (`written`) that share its wrong unit."""
    more = [
        change for mended in mistake.changes for change in _companions(mended, campaign, written)
    ]
    if not more:
        return mistake
    names = ", ".join(dict.fromkeys(change.key for change in more))
    words = f"{mistake.words}, and so is {names}"
    return replace(mistake, changes=(*mistake.changes, *more), words=words)


def _companions(
    mended: KeyChange, campaign: Campaign, written: Mapping[str, Any]
) -> Iterator[KeyChange]:
    quantity = mended.key.removeprefix("columns.").removesuffix(".unit")
    if quantity in ("rate", "wheel_momentum") and _in_one_unit(campaign, BY_KEY[quantity]):
        factor = UNITS[quantity][mended.mended] / UNITS[quantity][mended.stated]
        sigmas = {f"wheels.{w.name}.momentum_sigma": w.momentum_sigma for w in campaign.wheels}
        if quantity == "rate":
            sigma = written.get("rate_sensor", {}).get("sigma", list(campaign.gyro.sigma))
            sigmas = {"rate_sensor.sigma": sigma}
        for key, sigma in sigmas.items():
            if sigma is not None:
                yield KeyChange(key, sigma, _times(sigma, factor))
    if mended.key == "inertia.tensor":
        factor = float(np.trace(mended.mended) / np.trace(mended.stated))
        products = campaign.inertia.product_sigma
        # No product of inertia is larger than the moments: this sd is in the tensor's own unit.
        if factor < 0.1 and products > np.trace(mended.mended):
            yield KeyChange("inertia.product_sigma", products, _times(products, factor))


def _in_one_unit(campaign: Campaign, stream: SensorStream) -> bool:
    """Whether the noise of a channel agrees with what is stated, as both are read now."""
    ratio = noise_ratios(campaign, stream)
    known = ratio[np.isfinite(ratio) & (ratio > 0.0)]
    if not len(known):
        return False
    return bool(np.all(np.abs(np.log(known)) < np.log(LIMITS.one_unit)))


def _times(value: Any, factor: float) -> Any:
    """Numbers times a factor, with six digits."""
    if isinstance(value, list):
        return [_times(item, factor) for item in value]
    return float(f"{value * factor:.6g}")
