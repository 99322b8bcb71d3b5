"""Which mistake, undone, makes the data consistent: single ones first, then pairs.

A rate sensor along axes that are no permutation of the stated ones: its frame is estimated.

From fixes: where the true rate is R times the stated one with a constant rotation R, the rotation
between two fixes is exactly R times the rotation that the stated rates integrate to, so that R is a
problem of Wahba's. Without fixes R follows from conservation of momentum: its free matrix of
inertia, F = J R, has R as its rotational part.

A stated rate bias that is stale: the bias that telemetry itself tells, under any conventions.

The bias is linear in every law (`laws`), but a stale one turns the integrated rate by more than a
linear law bears. So it is estimated, taken off the readings, and estimated again (Gauss-Newton),
first from closure and directions, then, with what these leave of its sd, from conservation of
momentum.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from bayes_inertia.conventions import laws
from bayes_inertia.conventions.candidates import axes_mistake
from bayes_inertia.conventions.law_data import LinearFit, rms_rate
from bayes_inertia.conventions.limits import LIMITS
from bayes_inertia.conventions.motion import nearest_rotation, turn_between, without_mean
from bayes_inertia.conventions.reading import Mistake, Reading, Stated, both


@dataclass(frozen=True)
class Remedy:
    """A mistake whose mending makes the data consistent."""

    mistake: Mistake  # What to mend
    # before, after: worst misfit of the laws that it concerns, as stated and mended [sd]
    before: float
    after: float


def judged(
    misfits: laws.Misfits, stated: Reading, singles: Sequence[Mistake], keys: Stated
) -> tuple[tuple[Remedy, ...], Reading]:
    """Causes that make inconsistent data consistent: nothing, a stale bias, mistakes, or both.

    Returns: the mistakes, the best first, with what the data hold equal; the conventions as stated,
    with the bias that the telemetry tells where the stated one is stale.
    """
    before = laws.worst(misfits.of(stated))
    if before <= LIMITS.suspicious:
        return (), stated
    own = with_own_bias(misfits, stated)
    reading = own if _is_stale(misfits, stated, own) else stated
    biased = laws.worst(misfits.of(reading))
    search = _Search(misfits, stated, before, keys)
    if before <= LIMITS.impossible:
        return _surely(search, singles, reading, biased), reading
    return _impossible(search, singles, biased), reading


def without_broken_laws(
    misfits: laws.Misfits, reading: Reading, singles: Sequence[Mistake], keys: Stated
) -> tuple[Remedy, ...]:
    """Mistakes that explain the other laws, where physics breaks one that no mistake mends."""
    before = misfits.of(reading)
    if laws.worst(before) <= LIMITS.impossible:
        return ()
    broken = _broken(before)
    for mistake in singles:
        if misfits.may_mend(mended := mistake.mend(reading), LIMITS.ordinary):
            broken &= _broken(misfits.of(mended))
    others = replace(misfits, not_asked=broken)
    found = laws.worst(others.of(reading)) > LIMITS.impossible
    return judged(others, reading, singles, keys)[0] if broken and found else ()


def _is_stale(misfits: laws.Misfits, stated: Reading, own: Reading) -> bool:
    """Whether another bias explains the data much better, closure among them where fixes are."""
    before, after = misfits.of(stated), misfits.of(own)
    pairs = [(laws.worst(before), laws.worst(after))]
    if laws.CLOSURE in before:
        pairs.append((before[laws.CLOSURE].worst, after[laws.CLOSURE].worst))
    return all(then < now / LIMITS.stale_improvement for now, then in pairs)


@dataclass(frozen=True, eq=False)
class _Search:
    """Laws, stated conventions and their misfit, by which mistakes are judged."""

    misfits: laws.Misfits
    stated: Reading
    before: float
    keys: Stated

    def alone(self, singles: Sequence[Mistake]) -> list[Mistake]:
        return [*singles, *turned_sensor(self.misfits, self.stated, self.keys)]

    def beside_bias(self, singles: Sequence[Mistake]) -> list[Mistake]:
        turned = turned_beside_bias(self.misfits, self.stated, self.keys)
        return [beside_stale_bias(self.misfits, mistake) for mistake in (*singles, *turned)]

    def ranked(self, tried: Sequence[Mistake], ordinary: float) -> tuple[Remedy, ...]:
        """Those that mend, cut to the best and its equals, the most common mistake first."""
        mending = []
        limit = min(ordinary, self.before / LIMITS.improvement)
        for mistake in tried:
            mended = mistake.mend(self.stated)
            if self.misfits.mends(mended, limit):
                mending.append(Remedy(mistake, self.before, laws.worst(self.misfits.of(mended))))
        best = min((remedy.after for remedy in mending), default=0.0)
        equals = [remedy for remedy in mending if remedy.after <= alike(best)]
        equals.sort(key=lambda remedy: (remedy.mistake.rarity, remedy.after))
        # Two roads to one proposal are one.
        proposals = {
            repr(sorted((change.key, change.mended) for change in remedy.mistake.changes)): remedy
            for remedy in reversed(equals)
        }
        return tuple(proposals.values())[::-1]


def _surely(
    search: _Search, singles: Sequence[Mistake], reading: Reading, biased: float
) -> tuple[Remedy, ...]:
    """Mistakes that explain data that are possible as stated, but much better."""
    tried, left = search.alone(singles), search.before
    if reading is not search.stated:
        tried, left = search.beside_bias(singles), biased
    return search.ranked(tried, left / LIMITS.sure_improvement) if left > LIMITS.suspicious else ()


def _impossible(search: _Search, singles: Sequence[Mistake], biased: float) -> tuple[Remedy, ...]:
    """Mistakes that explain impossible data; none where a stale bias explains them as well."""
    alone = search.ranked(search.alone(singles), LIMITS.ordinary)
    if alone and alone[0].after < LIMITS.clear:
        return alone
    explained = biased < min(LIMITS.ordinary, search.before / LIMITS.improvement)
    if explained and not _as_good(alone, biased):
        return ()
    beside = search.ranked(search.beside_bias(singles), LIMITS.pair_ordinary)
    if alone and (not beside or _as_good(alone, beside[0].after)):
        return alone
    if search.before < LIMITS.pair_impossible or (beside and beside[0].after < LIMITS.clear):
        return beside
    pairs = search.ranked(_pairs(search.misfits, search.stated, singles), LIMITS.pair_ordinary)
    return beside if beside and not _as_good(pairs, beside[0].after) else pairs


def _as_good(remedies: Sequence[Remedy], other: float) -> bool:
    """Whether a remedy mends as well as another explanation does, or better."""
    return bool(remedies) and min(remedy.after for remedy in remedies) <= alike(other)


def alike(misfit: float) -> float:
    """The misfit below which the data hold two explanations equal."""
    return LIMITS.equal_factor * misfit + LIMITS.equal_misfit


def _pairs(misfits: laws.Misfits, stated: Reading, singles: Sequence[Mistake]) -> list[Mistake]:
    """Pairs of mistakes in different keys: of each that mends a law alone, and of common ones."""
    broken = _broken(misfits.of(stated))
    helpful = [
        m
        for m in singles
        if misfits.may_mend(mended := m.mend(stated), LIMITS.ordinary)
        and _broken(misfits.of(mended)) < broken
    ]
    pairs = {
        frozenset((id(a), id(b))): both(a, b) for a in helpful for b in singles if _differ(a, b)
    }
    if not any(misfits.mends(pair.mend(stated), LIMITS.pair_ordinary) for pair in pairs.values()):
        for i, a in enumerate(singles):
            for b in singles[:i]:
                if _may_meet(a, b):
                    pairs.setdefault(frozenset((id(a), id(b))), both(a, b))
    return list(pairs.values())


def _broken(fits: dict[str, LinearFit]) -> frozenset[str]:
    return frozenset(law for law, fit in fits.items() if fit.worst > LIMITS.ordinary)


def _differ(first: Mistake, second: Mistake) -> bool:
    keys = {change.key for change in first.changes}
    return not keys & {change.key for change in second.changes}


def _may_meet(first: Mistake, second: Mistake) -> bool:
    """Whether two mistakes of which neither mends a law alone are tried together."""
    common = first.rarity + second.rarity <= LIMITS.rarest_pair
    return common and _differ(first, second) and not (_scales(first) and _scales(second))


def _scales(mistake: Mistake) -> bool:
    """Whether a mistake is one of scale; two of these in different quantities may compensate."""
    return any(
        isinstance(c.stated, str) and c.key.endswith(".unit") and not c.key.endswith("time.unit")
        for c in mistake.changes
    ) or any(c.key.endswith((".spin_inertia", "inertia.tensor")) for c in mistake.changes)


def turned_sensor(misfits: laws.Misfits, reading: Reading, keys: Stated) -> list[Mistake]:
    """Rotations of the rate sensor's frame that fixes, and wheel momentum, propose."""
    axes = reading.rate_axes_B
    words = "the rates are along other axes"
    found = (_from_fixes, _from_momentum) if len(axes) else ()
    told = (tell(misfits, reading) for tell in found)
    turned = [axes @ r.T for r in told if r is not None and not _whole(r)]
    proposed = [np.round(x, LIMITS.axis_decimals) for x in turned if not _whole(x)]
    return [axes_mistake(keys, axes, x, LIMITS.sensor_rarity, words) for x in proposed]


def turned_beside_bias(misfits: laws.Misfits, reading: Reading, keys: Stated) -> list[Mistake]:
    """The rotation that the data propose where the rate bias is stale as well, by turns."""
    best: list[Mistake] = []
    for _ in range(LIMITS.sensor_rounds):
        proposed = turned_sensor(misfits, reading, keys)
        if not proposed:
            break
        mended = [with_own_bias(misfits, mistake.mend(reading)) for mistake in proposed]
        k = int(np.argmin([laws.worst(misfits.of(m)) for m in mended]))
        best = [proposed[k]]
        back = reading.axes_to_body[:, : misfits.own_axes] @ mended[k].rate_axes_B
        reading = replace(reading, bias_B=back @ mended[k].bias_B)
    return best


def _whole(rotation: np.ndarray) -> bool:
    """Whether a rotation is a signed permutation but for a misalignment; those are tried anyway."""
    return bool(np.abs(rotation - np.round(rotation)).max() < LIMITS.misaligned_axes)


def _from_fixes(misfits: laws.Misfits, reading: Reading) -> np.ndarray | None:
    slews = misfits.slews
    some = np.flatnonzero(slews.with_two_fixes)
    if not len(some):
        return None
    seen, told = (
        [
            turn_between(q[slew, rows[:1]], q[slew, rows[1:]]) / len(rows) ** 0.5
            for slew in some
            for rows in [np.flatnonzero(slews.fixes[slew])]
        ]
        for q in (slews.seen(reading), misfits.motion(reading).path)
    )
    products = np.concatenate(seen).T @ np.concatenate(told)
    sizes = np.linalg.svd(products, compute_uv=False)
    if sizes[1] <= LIMITS.second_direction**2 * sizes[0]:
        return None
    return nearest_rotation(products)


def _from_momentum(misfits: laws.Misfits, reading: Reading) -> np.ndarray | None:
    """R by turns: estimate F = J R with the path of the last R, and take the rotation in F."""
    slews = misfits.slews
    stored = laws.wheel_momentum_B(misfits.told(reading))
    if stored is None or not reading.axes_B.shape[1]:
        return None
    rotation = np.eye(3)
    for _ in range(LIMITS.sensor_rounds):
        turned = replace(reading, rate_axes_B=reading.rate_axes_B @ rotation.T)
        moving = misfits.motion(turned)
        rate = np.einsum("snij,snj->sni", moving.to_start, moving.rate_B)
        columns = np.einsum("snia,snb->sniab", moving.to_start, moving.rate_B)
        columns = columns.reshape(*rate.shape, 9)
        target = -np.einsum("snij,snj->sni", moving.to_start, stored)
        columns = without_mean(columns, slews.valid).reshape(-1, 9)
        target = without_mean(target, slews.valid).reshape(-1)
        normal = columns.T @ columns
        if not normal.any():
            return None
        ridge = 1e-6 * np.trace(normal) / 9.0 * np.eye(9)
        prior = reading.inertia.ravel()
        free = prior + np.linalg.solve(normal + ridge, columns.T @ (target - columns @ prior))
        rotation = nearest_rotation(np.linalg.solve(reading.inertia, free.reshape(3, 3))) @ rotation
    return rotation


# Bias along body axes and its sd [rad/s].
_Told = tuple[np.ndarray, np.ndarray]


def with_own_bias(misfits: laws.Misfits, reading: Reading) -> Reading:
    """A reading with the constant rate bias that the telemetry tells under it, if one agrees."""
    if not misfits.own_axes or not misfits.may_mend(reading, LIMITS.ordinary):
        return reading
    drive = misfits.fit(laws.DRIVE, reading)
    if drive is not None and drive.worst > LIMITS.ordinary:
        return reading
    rms = rms_rate(misfits.told(reading))
    told: _Told = (reading.bias_B, np.full(3, LIMITS.stale_share * rms))
    for law in (laws.CLOSURE, laws.DIRECTION, laws.CONSERVATION):
        make, sent = partial(_told_by, misfits, law, reading, told), (x.tobytes() for x in told)
        fields = misfits.parts_of(law)
        more: _Told | None = misfits.kept_for(f"bias by {law}", fields, reading, make, *sent)
        if more is None:
            return reading
        told = more
    off = np.sqrt(((told[0] - reading.bias_B) ** 2).sum())
    return replace(reading, bias_B=told[0]) if off < LIMITS.stalest_share * rms else reading


def _told_by(misfits: laws.Misfits, law: str, reading: Reading, before: _Told) -> _Told | None:
    """Bias and sd as a law tells them; None if it is broken whatever the bias is."""
    bias_B, sd = before
    last = 2.0 * LIMITS.hopeless
    for _ in range(LIMITS.stale_bias_rounds):
        data = misfits.law(law, replace(reading, bias_B=bias_B), sd)
        if data is None:
            return before
        fit = data.fit()
        misfit = float(fit.misfit.max(initial=0.0))
        if misfit > max(LIMITS.ordinary, 0.5 * last):
            return None
        which = slice(data.bias_from, data.bias_from + 3)
        step = sd * fit.values[which]
        bias_B, last = bias_B + step, misfit
        if np.abs(step).max() < LIMITS.bias_converged * sd.max():
            break
    return bias_B, sd * fit.sds[which]


def beside_stale_bias(misfits: laws.Misfits, mistake: Mistake) -> Mistake:
    """A mistake in a campaign whose stated rate bias is stale as well."""
    return replace(
        mistake,
        mend=lambda reading: with_own_bias(misfits, mistake.mend(reading)),
        words=f"{mistake.words}, and the stated rate bias is stale",
    )
