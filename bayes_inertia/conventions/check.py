"""The whole check: a campaign as stated, what its data say of it, and which change mends it.

Keys that were written in the same wrong unit as a mended one: noises, and the prior's products.

No law shows them. A stated noise that agrees with the noise of the readings while both are read in
the wrong unit was written in that unit too, and must be mended with it.
"""

from __future__ import annotations

import tomllib
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any, Literal

import numpy as np

from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.description import Entry
from bayes_inertia.campaign.hardware import DirectionSensor
from bayes_inertia.campaign.inspection import with_dirt_masked
from bayes_inertia.campaign.parsed_description import parse_description
from bayes_inertia.campaign.reader import read_unmasked, with_fewest_cuts
from bayes_inertia.campaign.schema import UNITS
from bayes_inertia.campaign.sensors import ATTITUDE, BY_KEY, KINDS, MOMENTUM, RATE, SensorStream
from bayes_inertia.conventions import wording
from bayes_inertia.conventions.candidates import mistakes
from bayes_inertia.conventions.clocks import clocks, known_offsets, streams_apart
from bayes_inertia.conventions.columns import copied_commands, faulty_columns, without_sign
from bayes_inertia.conventions.doubts import (
    Factors,
    broken_limits,
    dirt_of,
    doubtful_places,
    factors,
    field_of_no_orbit,
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
    TORQUE,
    KeyChange,
    Mistake,
    Reading,
    Stated,
    Teller,
    ToldTorques,
    further_sensors,
    stated_by,
    untold,
)
from bayes_inertia.conventions.search import Remedy, alike, judged, without_broken_laws
from bayes_inertia.conventions.wording import invisible
from bayes_inertia.errors import CampaignError
from bayes_inertia.files import description_path, read_bytes, text_of
from bayes_inertia.maths.blas_threads import on_one_blas_thread
from bayes_inertia.maths.values import json_ready


def what_mends(
    misfits: Misfits,
    mending: tuple[Remedy, ...],
    reading: Reading,
    singles: Sequence[Mistake],
    stated: Stated,
    differ: Factors | None,
) -> tuple[tuple[Remedy, ...], tuple[str, ...]]:
    """All that makes the data consistent beside mistakes that do, the best first; and remarks."""
    remarks: tuple[str, ...] = ()
    if not mending:
        mending, remarks = clocks(misfits, reading, stated)
    exact = _of_factor(misfits, reading, stated, differ)
    # Two mistakes at once are less likely than one in a stream.
    first = mending[0].mistake if mending else None
    if first is None or (len(first.changes) > 1 and first not in singles):
        found = exact or _of_streams(misfits, reading, stated) or mending
        return found or without_broken_laws(misfits, reading, singles, stated), remarks
    said = _commands_to_tachometers(mending[0].mistake.mend(reading))
    more = [
        remedy
        for remedy in exact
        if remedy.after <= alike(mending[0].after)
        and not np.allclose(
            _commands_to_tachometers(remedy.mistake.mend(reading)), said, LIMITS.one_factor, 0.0
        )
    ]
    return (*mending, *more), remarks


def _commands_to_tachometers(reading: Reading) -> np.ndarray:
    """What tachometers read of commands (k, k), physics apart; alike where a unit is the factor."""
    wheels = reading.axes_B.shape[1]
    return reading.matrix(MOMENTUM.field, wheels) @ np.linalg.inv(reading.matrix(TORQUE, wheels))


def _of_streams(misfits: Misfits, reading: Reading, stated: Stated) -> tuple[Remedy, ...]:
    """Faults of one stream: its signs, or its clock by a known offset."""
    before = worst(misfits.of(reading))
    if before <= LIMITS.impossible:
        return ()
    unsigned = without_sign(misfits, reading, before)
    return known_offsets(misfits, reading, stated) if unsigned is None else (unsigned,)


def _of_factor(
    misfits: Misfits, reading: Reading, stated: Stated, differ: Factors | None
) -> tuple[Remedy, ...]:
    """Spin inertias that are wrong by the factor between commands and tachometers."""
    mistake = None if differ is None else differ.mistake(misfits.campaign, stated)
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
    stated: Stated
    text: str = ""


def check_conventions(
    campaign: Campaign | str | Path, told: Teller = untold, *, quick: bool = False
) -> ConventionsCheck:
    """The check; `told`: what effects, but for wheels, do to the body by name of the slew."""
    if isinstance(campaign, Campaign):
        torques, stated = ToldTorques(campaign, told), stated_by(campaign)
        return _checked(_Case(campaign, campaign, quick, torques, stated))
    path = description_path(campaign)
    text = text_of(read_bytes(path), str(path))
    # Its files are read once, with commands that have gaps and without.
    written_by = cache(lambda keep: read_unmasked(path, keep_commands=keep))
    written = written_by(False)
    masked = with_dirt_masked(written)
    if any(dirt.kind == "gap" and dirt.channel == "torque" for dirt in masked.dirt):
        # A fit needs no commands where tachometers are; here both are held against each other.
        written = written_by(True)
        kept, used = with_dirt_masked(written), with_fewest_cuts(written_by).has_commands
        masked = kept if used else replace(kept, dirt=masked.dirt)
    stated = stated_by(masked, parse_description(text, str(path)))
    case = _Case(masked, written, quick, ToldTorques(masked, told), stated, text)
    if _suspect(written, masked):
        # Readings that are impossible in numbers are in a wrong unit, or marks for missing values:
        # no limit is believed.
        sensor = written.rate_sensor
        free = sensor if sensor is None else replace(sensor, range=None)
        check = _checked(replace(case, campaign=replace(written, rate_sensor=free)))
        if check.changes:
            return check
    return _checked(case)


def _suspect(written: Campaign, masked: Campaign) -> bool:
    """Whether so many readings are unbelievable that their unit may be to blame."""
    for stream in (RATE, MOMENTUM):
        pairs = zip(written.slews, masked.slews, strict=True)
        given = [(before, after) for before, after in pairs if stream.of(before) is not None]
        sizes = np.concatenate([[], *(np.abs(stream.values(x)).ravel() for x, _ in given)])
        believed = sum(int(stream.valid(masked, after).sum()) for _, after in given)
        few = believed < LIMITS.believable_share * np.isfinite(sizes).sum()
        if few and np.nanmax(sizes, initial=0.0) < LIMITS.largest_number:
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
    written = dict(further_sensors(case.written))
    for sensor, alone in further_sensors(case.campaign):
        own, stated = written[sensor], case.stated.by(sensor)
        other = _of_first_sensors(
            replace(case, campaign=alone, written=own, quick=True, stated=stated)
        )
        if other.verdict == "wrong":
            return replace(other, sentence=f"With the sensor {sensor.name}: {other.sentence}")
        check = check.doubting([d for d in other.doubts if d not in check.doubts])
    said = [
        f"{name}: no law is held against it; the laws here are those of rate sensors, star "
        "trackers and direction sensors in slews of a turn or less"
        for name, hardware in case.campaign.more_sensors
        if not getattr(KINDS.get(type(hardware)), "first", "")
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
    kept = [k for k, wheel in enumerate(case.written.wheels) if wheel.state != "locked"]
    return replace(case, campaign=running, written=written, stated=case.stated.of_wheels(kept))


def _of_first_sensors(case: _Case) -> ConventionsCheck:
    """The same by the first rate sensor and the first star tracker."""
    campaign, written, stated = case.campaign, case.written, case.stated
    # Numbers whose squares overflow break every law, infinitely.
    with np.errstate(over="ignore", invalid="ignore"):
        faults = faulty_columns(written, stated)
        misfits = misfits_of(campaign, case.torques)
        if misfits is None:  # The streams do not meet.
            apart = streams_apart(written, stated)
            doubts = (*faults, *apart, *broken_limits(written, stated, {}))
            verdict: Verdict = "doubtful" if doubts else "consistent"
            said = wording.verdict_in_words({}, (), verdict, (), doubts)
            return ConventionsCheck(campaign.name, verdict, said, {}, doubts=doubts)
        return _held_against_laws(case, misfits, faults)


def _held_against_laws(case: _Case, misfits: Misfits, faults: tuple[str, ...]) -> ConventionsCheck:
    campaign, keys, stated = case.campaign, case.stated, misfits.stated()
    directions = misfits.fit(DIRECTION, stated) is not None
    singles = mistakes(campaign, keys, misfits.own_axes, directions)
    remedies, reading = judged(misfits, stated, singles, keys)
    differ = None if faults else factors(misfits, reading)
    # What a column that is no reading makes wrong is no convention.
    mending: tuple[Remedy, ...] = ()
    remarks: tuple[str, ...] = ()
    if not faults:
        mending, remarks = what_mends(misfits, remedies, reading, singles, keys, differ)
    if misfits.smoothed:
        mending = tuple(r for r in mending if _is_told(r.mistake, misfits.own_axes))
    wrong = bool(mending) or worst(misfits.of(reading)) > LIMITS.hopeless
    if mending:
        reading = mending[0].mistake.mend(stated if mending[0] in remedies else reading)
        mending = (_completed(mending[0], case), *mending[1:])
    doubts = faults + _doubts(case, misfits, reading, differ, bool(mending))
    verdict: Verdict = "wrong" if wrong else "doubtful" if doubts else "consistent"
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
        cannot_show=() if case.quick else invisible(misfits, reading, singles * (not wrong), keys),
        remarks=remarks,
        doubts=doubts,
        dirt=() if case.quick else dirt_of(campaign, misfits, stated, reading),
    )


def _is_told(mistake: Mistake, own_axes: int) -> bool:
    """Whether a mistake shows where rates are smoothed, and so follow fixes and signs of wheels."""
    moved = set(mistake.shifts)
    return bool(mistake.changes) and (not moved or (own_axes > 0 and ATTITUDE.field not in moved))


def _completed(remedy: Remedy, case: _Case) -> Remedy:
    """A remedy with the keys of campaign.toml that share its wrong unit."""
    mistake = remedy.mistake
    more = [change for mended in mistake.changes for change in _companions(mended, case)]
    if not more:
        return remedy
    names = ", ".join(dict.fromkeys(change.key for change in more))
    words = f"{mistake.words}, and so is {names}"
    return replace(remedy, mistake=replace(mistake, changes=(*mistake.changes, *more), words=words))


def _doubts(
    case: _Case,
    misfits: Misfits,
    reading: Reading,
    differ: Factors | None,
    mended: bool,
) -> tuple[str, ...]:
    """Doubtful channels and places; of mended data factors, and laws that stay broken."""
    factor = () if differ is None else differ.words()
    if mended:
        return (*factor, *doubtful_places(misfits, reading))
    written, stated = case.written, case.stated
    holds = {law: fit.worst < LIMITS.ordinary for law, fit in misfits.of(reading).items()}
    return (
        *(() if holds.get(DRIVE, True) else copied_commands(written, stated)),
        *doubtful_places(misfits, reading),
        *factor,
        *streams_apart(written, stated),
        *broken_limits(written, stated, holds),
        *field_of_no_orbit(written, stated),
    )


def _changes(mending: Sequence[Remedy]) -> tuple[ConventionChange, ...]:
    """The keys to change; none where the first cause is in no key."""
    if mending and not mending[0].mistake.changes:
        return ()
    return tuple(
        ConventionChange(c.key, c.stated, c.mended, r.before, r.after, number, r.mistake.words)
        for number, r in enumerate(mending, 1)
        for c in r.mistake.changes
    )


def _companions(mended: KeyChange, case: _Case) -> Iterator[KeyChange]:
    campaign, stated = case.campaign, case.stated
    path, _, word = mended.key.rpartition(".")
    entry = next((e for e in stated.held if word == "unit" and path == e.path), None)
    # A speed's noise is one of momentum.
    of_noise = entry is not None and entry.key in (RATE.keys[0], MOMENTUM.keys[0])
    if entry is not None and of_noise and _in_one_unit(campaign, BY_KEY[entry.key]):
        units = UNITS[entry.key]
        for key, sigma in _stated_noise(case, entry).items():
            if sigma is not None:
                factor = units[mended.mended] / units[mended.stated]
                yield KeyChange(key, sigma, _times(sigma, factor))
    if mended.key == "inertia.tensor":
        factor = float(np.trace(mended.mended) / np.trace(mended.stated))
        products = campaign.inertia.product_sigma
        # No product of inertia is larger than the moments: this sd is in the tensor's own unit.
        if factor < 0.1 and products > np.trace(mended.mended):
            yield KeyChange("inertia.product_sigma", products, _times(products, factor))


def _stated_noise(case: _Case, entry: Entry) -> dict[str, Any]:
    """The noise of the readings of some columns, by its keys."""
    key = case.stated.key
    if entry.key in RATE.keys:
        written = tomllib.loads(case.text).get(RATE.first, {}) if case.text else {}
        return {key(RATE.first, "sigma"): written.get("sigma", list(case.campaign.gyro.sigma))}
    # It stands beside the columns of the tachometers, or among the wheel's own keys.
    beside = entry.columns.sigma is not None
    wheels = [case.campaign.wheels[k] for k in entry.wheels]
    return {
        f"{path}.sigma" if beside else key("wheels", w.name, "momentum_sigma"): w.momentum_sigma
        for path, w in zip(entry.paths, wheels, strict=True)
    }


def _in_one_unit(campaign: Campaign, stream: SensorStream) -> bool:
    """Whether the noise of a channel agrees with what is stated, as both are read now."""
    ratio = noise_ratios(campaign, stream)
    known = ratio[np.isfinite(ratio) & (ratio > 0.0)]
    return len(known) > 0 and bool(np.all(np.abs(np.log(known)) < np.log(LIMITS.one_unit)))


def _times(value: Any, factor: float) -> Any:
    """Numbers times a factor, with six digits."""
    if isinstance(value, list):
        return [_times(item, factor) for item in value]
    return float(f"{value * factor:.6g}")
