"""The numbers that pages quote, each computed from committed results.

`fill.py` puts them into the pages; a test holds every page against them. A name is that of the
result and what is counted, a value is the text that the page shows.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Sequence
from functools import cache

import numpy as np

from analyses import results_of
from analyses.calibration.quoted_sd_page import CANDIDATES, held
from analyses.calibration.reliability import reliability
from analyses.calibration.unmodelled_disturbance_page import coverage_of
from analyses.data_quality.page import wrong as trusted_and_wrong
from analyses.design.cross_terms_cases import CRAFT, RATES
from analyses.imports.conventions_kinds import is_accused, is_shown
from analyses.imports.conventions_page import DIRTY
from analyses.naming import formulas as law_study
from analyses.naming import table_page
from analyses.naming.throws_halves import agreement

RESULTS = results_of(__file__).parent
_HALF = 1.645  # half width of a 90 % interval [sd]
# Kinds of campaigns whose fits are trusted as a rule, and the way that is quoted.
_TRUSTED = ("clean", "designed", "weak-library", "weak-outside", "dirty")
_QUOTED = CANDIDATES[-1]
_METHODS = ("least squares", "filter", "package", "remainder")


def content(name: str):
    """A committed result."""
    (path,) = RESULTS.rglob(f"{name}.json")
    return json.loads(path.read_text(encoding="utf-8"))


@cache
def rows(pattern: str) -> list[dict]:
    """Rows of all committed files that match."""
    paths = sorted(RESULTS.rglob(f"{pattern}.jsonl"))
    return [json.loads(line) for path in paths for line in path.read_text().splitlines()]


def percent(share: float, digits: int = 0) -> str:
    """A share in per cent, without the sign.

    >>> percent(0.123)
    '12'
    """
    return f"{100.0 * share:.{digits}f}"


def first_screen() -> Iterator[tuple[str, str]]:
    """The example campaign and the one that hides a dipole."""
    result = content("first_screen")
    example, hidden = result["example"], result["hidden"]
    z = [abs(e) / sd for e, sd in zip(example["error"], example["quoted_sd"], strict=True)]
    yield "example.worst_z", f"{max(z):.1f}"
    yield "example.terminal", f"\n```text\n{example['terminal']}\n```\n"
    yield "hidden.terminal", f"\n```text\n{hidden['terminal']}\n```\n"
    for key in ("before", "after"):
        fit = hidden[key]
        yield f"hidden.chi2_{key}", f"{fit['reduced_chi2']:.2f}"
        for name, error, sd in zip(("Jxx", "Jyy", "Jzz"), fit["error"], fit["sd"], strict=False):
            yield f"hidden.{name}_{key}", f"{1e3 * abs(error):.1f}"
            yield f"hidden.{name}_{key}_sd", f"{1e3 * sd:.1f}"
        z = [abs(e) / sd for e, sd in zip(fit["error"], fit["sd"], strict=True)]
        yield f"hidden.worst_z_{key}", f"{max(z):.1f}"
    yield "hidden.probability", percent(hidden["probability"])
    arcsec = 3600.0 * np.degrees([hidden["correction_slew"][k][0] for k in ("expected", "updated")])
    yield "hidden.correction_before", f"{arcsec[0]:.0f}"
    yield "hidden.correction_after", f"{arcsec[1]:.0f}"


def quoted() -> Iterator[tuple[str, str]]:
    """How often 90 % intervals as quoted hold the truth."""
    name, width = _QUOTED
    found = rows("quoted_sd")
    found = [row for row in found if isinstance(row.get("error"), list)]
    shares = {
        (kind, half): held(name, width, own).mean()
        for kind in _TRUSTED
        for half in (True, False)
        if (own := [r for r in found if r["kind"] == kind and r["tachometers"] is half])
    }
    yield "quoted.low", percent(min(shares.values()))
    yield "quoted.high", percent(max(shares.values()))
    yield "quoted.campaigns", f"{sum(row['kind'] in _TRUSTED for row in found)}"
    ratio = np.array([row["quoted_over_promised"] for row in content("quoted_sd_promise")])
    yield "promise.flights", f"{len(ratio)}"
    yield "promise.low", f"{ratio.min():.2f}"
    yield "promise.high", f"{ratio.max():.2f}"


def calibration() -> Iterator[tuple[str, str]]:
    """Ranks of truths among posterior draws."""
    study = content("calibration_study")["right"]
    yield "calibration_study.fits", f"{study['fits']:,}"
    yield "calibration_study.rejected", f"{len(study['rejected'])}"
    settled = content("calibration_settled")
    worst = max(abs(case["sd_wrong_by"]) for case in settled.values())
    yield "settled.worst", percent(worst, 1)
    yield "settled.campaigns", f"{sum(case['campaigns'] for case in settled.values()):,}"


def naming() -> Iterator[tuple[str, str]]:
    """Effects that an ideal test finds in 99 %, and campaigns with none, by the table."""
    clean: list[dict] = []
    for half, name in (("tacho", "tacho"), ("notacho", "no_tacho")):
        single = table_page.read(RESULTS / "naming", "single", half)
        found, alone = (sum(map(f, single)) for f in (table_page.in_the_set, table_page.alone))
        wrong = sum(table_page.wrong_name(r) and not table_page.in_the_set(r) for r in single)
        yield f"naming.{name}.campaigns", f"{len(single)}"
        yield f"naming.{name}.found", f"{found}"
        yield f"naming.{name}.found_percent", percent(found / len(single))
        yield f"naming.{name}.alone_percent", percent(alone / len(single))
        yield f"naming.{name}.several_percent", percent((found - alone) / len(single))
        yield f"naming.{name}.wrong", f"{wrong}"
        clean += table_page.read(RESULTS / "naming", "clean", half)
    yield "naming.clean", f"{len(clean)}"
    yield "naming.clean_named", f"{sum(not table_page.in_the_set(row) for row in clean)}"
    for kind in ("pair", "triple", "random"):
        several = table_page.read(RESULTS / "naming", kind, "tacho")
        yield f"naming.{kind}", f"{len(several)}"
        yield f"naming.{kind}_found", f"{sum(map(table_page.in_the_set, several))}"


def formulas() -> Iterator[tuple[str, str]]:
    """Laws outside the library, as strong as an ideal test finds and three times that."""
    for name, times in (("formulas", 3.0), ("formulas_once", 1.0)):
        found = [law_study.outcome(row) for row in rows("formulas") if row["times"] == times]
        yield f"{name}.laws", f"{len(found)}"
        yield f"{name}.named", f"{sum(x in ('formula', 'equal') for x in found)}"
        yield f"{name}.listed", f"{found.count('may be')}"
        yield f"{name}.wrong", f"{found.count('false formula')}"
        yield f"{name}.imitated", f"{sum(x in ('named', 'ambiguous') for x in found)}"
        yield f"{name}.missed", f"{found.count('nothing')}"


def nearly() -> Iterator[tuple[str, str]]:
    """Strong effects of nearly the library's shapes."""
    found = rows("nearly")
    yield "nearly.right", f"{sum(row['right'] for row in found)}"
    yield "nearly.campaigns", f"{len(found)}"


def strange_noise() -> Iterator[tuple[str, str]]:
    """Campaigns with nothing hidden whose noise is not as stated."""
    verdicts = [row["verdict"] for row in rows("strange_noise") if row["kind"] != "as_stated"]
    yield "strange_noise.campaigns", f"{len(verdicts)}"
    yield "strange_noise.nothing", f"{verdicts.count('consistent')}"
    yield "strange_noise.unknown", f"{verdicts.count('unknown')}"


def outside() -> Iterator[tuple[str, str]]:
    """Disturbances outside the library, and noise that wanders as stated."""
    stated: list[dict] = []
    for half, name in (("tacho", "tacho"), ("notacho", "no_tacho")):
        found = table_page.read(RESULTS / "naming", "outside", half)
        yield f"outside.{name}", f"{len(found)}"
        yield f"outside.{name}_akin", f"{sum(map(table_page.is_open_or_akin, found))}"
        stated += table_page.read(RESULTS / "naming", "stated", half)
    yield "stated.campaigns", f"{len(stated)}"
    yield "stated.named", f"{sum(not table_page.in_the_set(row) for row in stated)}"


def probabilities() -> Iterator[tuple[str, str]]:
    """Statements of about one probability, and how many are true."""
    prior, others = table_page.of_prior_and_others(RESULTS / "naming")
    for name, told in (("prior", prior), ("others", others)):
        yield f"reliability.{name}", f"{len(told)}"
        for k, part in enumerate(reversed(reliability(told)[-3:])):
            yield f"reliability.{name}_{k}_stated", percent(part.stated)
            yield f"reliability.{name}_{k}_count", f"{part.count}"
            yield f"reliability.{name}_{k}_true", percent(part.share)


def unexplained() -> Iterator[tuple[str, str]]:
    """J and K where an unmodelled disturbance is missing."""
    shares = coverage_of(rows("unmodelled_disturbance"))
    yield (
        "remainder.campaigns",
        f"{sum(row['kind'] != 'clean' for row in rows('unmodelled_disturbance'))}",
    )
    for half, name in ((True, "tacho"), (False, "no_tacho")):
        for method, share in shares[half].items():
            yield f"remainder.{name}.{method}", percent(share)
    _, told = table_page.of_prior_and_others(RESULTS / "naming")
    z = np.abs([row["quoted_z"] for row in told if table_page.has_no_name(row)])
    yield "remainder.diagnosed", f"{len(z)}"
    yield "remainder.diagnosed_hold", percent(np.mean(z < _HALF))


def spacecraft() -> Iterator[tuple[str, str]]:
    """Spacecraft of all kinds: trusted, and errors over sds."""
    found = rows("spacecraft")
    z = np.abs(np.concatenate([row["z"] for row in found]))
    yield "spacecraft.campaigns", f"{len(found)}"
    yield "spacecraft.trusted", f"{sum(row['trusted'] for row in found)}"
    yield "spacecraft.kinds", f"{len({row['kind'] for row in found})}"
    yield "spacecraft.held", percent(float(np.mean(z < _HALF)))
    yield "spacecraft.largest", f"{z.max():.1f}"


def conventions() -> Iterator[tuple[str, str]]:
    """Wrong conventions named, right ones left alone."""
    found = content("conventions")
    spoilt = [r for r in found if r["part"] == "wrong" and not r["campaign"].startswith(DIRTY)]
    shown = [row for row in spoilt if row["shown"]]
    yield "conventions.kinds", f"{len({row['convention'] for row in shown})}"
    yield "conventions.shown", f"{len(shown):,}"
    yield "conventions.named", f"{sum(bool(row.get('named')) for row in shown):,}"
    right = [row for row in found if row["part"] == "right"]
    yield "conventions.right", f"{len(right)}"
    yield "conventions.accused", f"{sum(row['verdict'] == 'wrong' for row in right)}"


def conventions_of_kinds() -> Iterator[tuple[str, str]]:
    """Wrong keys of devices, direction sensors and gyros of any axes named; right ones accused."""
    found = rows("conventions_kinds")
    wrong, right = ([row for row in found if bool(row["wrong"]) == is_wrong] for is_wrong in (1, 0))
    shown = [row for row in wrong if is_shown(row)]
    yield "wrong_keys.shown", f"{len(shown)}"
    yield "wrong_keys.named", f"{sum(row['named'] for row in shown)}"
    yield "wrong_keys.right", f"{len(right)}"
    yield "wrong_keys.accused", f"{sum(map(is_accused, right))}"


def dirt() -> Iterator[tuple[str, str]]:
    """Faults of telemetry: trusted, refused, stopped."""
    found = content("telemetry_faults")
    random = found["random"]
    for key, status in (("trusted", "trusted"), ("refused", "untrusted"), ("stopped", "error")):
        yield f"dirt.{key}", f"{sum(row['status'] == status for row in random)}"
    yield "dirt.cases", f"{len(random)}"
    yield "dirt.worst", f"{max(row['z'] for row in random if row['status'] == 'trusted'):.1f}"
    yield "dirt.hidden", f"{len(found['hidden'])}"
    yield "dirt.hidden_wrong", f"{sum(trusted_and_wrong(row) for row in found['hidden'])}"


def distortions() -> Iterator[tuple[str, str]]:
    """Distorted raw logs: trusted, and how far from the truth."""
    found = rows("import_distortions")
    off = [row["off"] for row in found if row.get("fit") == "trusted"]
    yield "distortions.cases", f"{len(found)}"
    yield "distortions.trusted", f"{len(off)}"
    yield "distortions.worst", f"{max(off):.1f}"
    yield "distortions.tracebacks", f"{sum(row['traceback'] for row in found)}"


def sampling() -> Iterator[tuple[str, str]]:
    """Effective samples, warm-up included where that is worse for this package."""
    from analyses.engine.benchmark_page import sampler_ratios
    from analyses.engine.benchmark_samplers import Result

    results = [Result(**row) for row in content("benchmark")["results"]]
    ratios = sampler_ratios(results)
    yield "sampling.per_evaluation", f"{ratios['ess_per_evaluation']:.2f}"
    for name in ("nuts", "stretch", "de"):
        yield f"sampling.{name}", f"{ratios[f'ess_per_second_over_{name}']:.0f}"
    claims = {row["claim"]: row["measured"] for row in content("benchmark")["claims"]}
    by_hand = claims["times those of the do-it-yourself baseline, 32 walkers at once"]
    yield "sampling.by_hand", f"{1000 * round(by_hand / 1000):,}"


def gpu() -> Iterator[tuple[str, str]]:
    """The density at many points at once: times of processor and GPU."""
    processor, gpu = (row["seconds_a_call"] for row in content("accelerator"))
    most = max(gpu, key=int)
    yield "gpu.points", f"{int(most):,}"
    yield "gpu.ms", f"{1e3 * gpu[most]:.0f}"
    yield "gpu.ratio", f"{processor[most] / gpu[most]:.0f}"


def design() -> Iterator[tuple[str, str]]:
    """Designed slews against slews like the paper's."""
    for goal, row in content("design_gains").items():
        yield f"design.{goal}", f"{row['gain']:.1f}"
        yield f"design.{goal}_random", f"{row['paper'] / row['random']['best']:.1f}"
    achieved = content("design_achieved")
    ratio = np.array([row["ratio"] for row in achieved.values()])
    yield "design.ratio_low", f"{ratio.min():.2f}"
    yield "design.ratio_high", f"{ratio.max():.2f}"
    yield "design.campaigns", f"{sum(row['campaigns'] for row in achieved.values()):,}"
    yield "design.seconds", f"{content('design_times')['cold_design']['wall']:.0f}"


def other_methods() -> Iterator[tuple[str, str]]:
    """Other methods on the same telemetry."""
    found = rows("other_methods")
    yield "peers.campaigns", f"{len(found)}"
    for kind in ("clean", "random-torque"):
        own = [row for row in found if row["kind"] == kind]
        for method in _METHODS:
            error = np.array([row[method]["error"] for row in own])
            sd = np.array([row[method]["sd"] for row in own])
            moments = np.array([row["truth"][:3] for row in own])
            rms = 100.0 * np.sqrt(np.mean((error[:, :3] / moments) ** 2))
            name = f"peers.{kind}.{method.replace(' ', '_')}"
            yield f"{name}.moments", f"{rms:.1g}" if rms < 1.0 else f"{rms:.1f}"
            yield f"{name}.held", percent((np.abs(error) < _HALF * sd)[sd > 0.0].mean())


def throws() -> Iterator[tuple[str, str]]:
    """Bodies thrown by hand whose truth is known."""
    for row in content("throws_diagnosis"):
        if not row.get("truth") or "principal_moments" not in row.get("command", {}):
            continue
        truth = np.array(row["truth"])
        for key, fit in (("plain", row["fits"][0]), ("diagnosed", row["command"])):
            error = np.abs(np.array(fit["principal_moments"]) / truth - 1.0).mean()
            yield f"throws.{row['configuration']}.{key}", percent(error, 2)
        error = np.abs(np.array(row["command"]["principal_moments"]) / truth - 1.0)
        worst = int(np.argmax(error / row["command"]["sd"] * truth))
        yield f"throws.{row['configuration']}.worst", percent(error[worst], 1)
        yield (
            f"throws.{row['configuration']}.worst_sd",
            percent(row["command"]["sd"][worst] / truth[worst], 1),
        )
    for row in content("throws_diagnosis"):
        for key in ("plain", "quoted") if "halves" in row else ():
            differ = agreement(row["halves"], key)["rms"]
            yield f"throws.{row['configuration']}.halves_{key}", f"{differ:.2f}"


def machine() -> Iterator[tuple[str, str]]:
    """Damaged files, memory, cost of many fits."""
    faults, memory, engine = content("damaged_files"), content("memory"), content("engine")
    yield "faults.cases", f"{faults['cases']:,}"
    for outcome in ("accepted", "refused"):
        cases = sum(row["cases"] for row in faults["counts"] if row["outcome"] == outcome)
        yield f"faults.{outcome}", f"{cases:,}"
    yield "memory.diagnoses", f"{memory['diagnoses']['count']}"
    yield "memory.peak", f"{np.ceil(memory['diagnoses']['points'][-1][2] / 102.4) / 10.0:.1f}"
    yield "memory.slews_peak", f"{memory['slews']['peak'] / 1000:.1f}"
    yield "engine.fit", f"{engine['fits']['fit']:.0f}"
    yield "engine.first", f"{engine['fits']['first']:.0f}"
    yield "engine.memory", f"{engine['fits']['memory'] / 1e9:.1f}"
    yield "engine.first_diagnosis", f"{engine['diagnoses']['first']:.0f}"
    yield "engine.diagnosis", f"{engine['diagnoses']['diagnosis']:.0f}"
    yield "engine.kills", f"{len(engine['kills']['kills'])}"
    yield "engine.killed_fits", f"{engine['kills']['fits']}"


def series() -> Iterator[tuple[str, str]]:
    """Series of campaigns, and fleets."""
    study = content("series_of_campaigns")
    flown, fleets = study["flown"], study["fleets"]
    yield "series.dated", f"{study['jumped']['right']}"
    yield "series.quiet", f"{study['constant']['right']}"
    yield "series.flown", f"{flown['dated'] + flown['quiet']}"
    yield "series.flown_all", f"{flown['with_jump'] + flown['without_jump']}"
    yield "series.fleet_low", f"{min(row['rms_z'] for row in fleets):.2f}"
    yield "series.fleet_high", f"{max(row['rms_z'] for row in fleets):.2f}"


def walk() -> Iterator[tuple[str, str]]:
    """What `report --plan` says of slews that were designed, simulated and fitted."""
    yield "walk.promise", f"\n```text\n{content('first_walk')['promise']}\n```\n"


def readings() -> Iterator[tuple[str, str]]:
    """Cost of projections of high-rate readings over that of the readings."""
    ratios = content("evaluation_benchmark")["ratios"]
    yield "reduction.cost", percent(ratios["block means over 4 kHz"])


def flying() -> Iterator[tuple[str, str]]:
    """Forecasts: the worst element of J against rate, gyro noise and fixes."""
    shared, own = content("cross_terms"), content("before_you_fly")
    curves = shared["curves"]["tachometers, misalignment known"]
    by_rate = dict(zip(RATES.tolist(), np.array(curves["rate"])[:, :6].max(1), strict=True))
    by_noise = dict(zip(own["gyro_sigma"], np.array(own["by_noise"])[:, :6].max(1), strict=True))
    by_fixes = dict(zip(own["fixes"], np.array(own["by_fixes"])[:, :6].max(1), strict=True))
    usual = CRAFT.rate_sensor.sigma[0]
    yield "fly.rate_gain", f"{by_rate[0.1] / by_rate[0.5]:.0f}"
    yield "fly.fast_gain", f"{by_rate[0.5] / by_rate[2.0]:.1f}"
    yield "fly.quiet_gain", f"{by_noise[usual] / by_noise[min(by_noise)]:.0f}"
    yield "fly.loud_loss", f"{by_noise[max(by_noise)] / by_noise[usual]:.0f}"
    yield "fly.fixes_gain", f"{by_fixes[1] / by_fixes[12]:.1f}"
    lost = [shared["lost"][key] for key in sorted(shared["lost"])]
    yield "fly.start_low", f"{min(lost):.0f}"
    yield "fly.start_high", f"{max(lost):.0f}"
    without = np.array(shared["curves"]["no tachometers"]["rate"])[:, 3:6].max(1)
    known = np.array(curves["rate"])[:, 3:6].max(1)
    yield "fly.no_tachometers", f"{(without / known)[RATES == 1.0][0]:.0f}"


def installation() -> Iterator[tuple[str, str]]:
    """Disk space."""
    sizes = content("install_size")
    largest = sorted(sizes, key=sizes.__getitem__, reverse=True)[:3]
    yield "install.gigabytes", f"{sum(sizes.values()) / 1e9:.1f}"
    yield "install.largest", ", ".join(f"{name} {sizes[name] / 1e6:.0f} MB" for name in largest)


def random_walk() -> Iterator[tuple[str, str]]:
    """A gyro whose bias walks."""
    found = rows("random_walk")
    yield "walk.campaigns", f"{len(found)}"
    for name in ("white", "stated", "estimated"):
        z = [
            np.sqrt(np.mean(np.square([np.divide(r[name]["error"], r[name]["sd"]) for r in own])))
            for own in _by(found, "density")
        ]
        yield f"walk.{name}_low", f"{min(z):.2f}"
        yield f"walk.{name}_high", f"{max(z):.2f}" if max(z) < 5 else f"{max(z):.0f}"


def _by(found: Sequence[dict], key: str) -> list[list[dict]]:
    values = sorted({row[key] for row in found})
    return [[row for row in found if row[key] == value] for value in values]


GROUPS: tuple[Callable[[], Iterator[tuple[str, str]]], ...] = (
    first_screen,
    quoted,
    calibration,
    naming,
    formulas,
    nearly,
    strange_noise,
    outside,
    probabilities,
    unexplained,
    conventions,
    conventions_of_kinds,
    spacecraft,
    dirt,
    distortions,
    sampling,
    gpu,
    design,
    other_methods,
    throws,
    machine,
    random_walk,
    readings,
    series,
    walk,
    flying,
    installation,
)


@cache
def numbers() -> dict[str, str]:
    """All numbers: {name: text}."""
    return dict(pair for group in GROUPS for pair in group())
