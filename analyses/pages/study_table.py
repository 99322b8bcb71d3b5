"""The tables of docs/studies.md: what was asked, what was found, and where the study stands."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from analyses.pages.table import table_lines

ANALYSES = Path(__file__).parents[1]
# By subject: question, answer with names of numbers, page below `analyses/`.
_STUDIES: dict[str, tuple[tuple[str, str, str], ...]] = {
    "J, K and their uncertainty": (
        (
            "Do 90 % intervals hold the truth in 90 %?",
            "{quoted.low} to {quoted.high} % in each of five kinds of campaigns, with and without "
            "tachometers ({quoted.campaigns} campaigns)",
            "quoted_sd",
        ),
        (
            "Is the posterior calibrated? Commands run as a user would",
            "{calibration_study.fits} fits of truths drawn from the prior; quantities rejected: "
            "{calibration_study.rejected}",
            "calibration_study",
        ),
        ("The same, quantity by quantity", "ranks of nine parameters, two plans", "calibration"),
        (
            "Are the sds wrong by two per cent?",
            "by {settled.worst} % at most, in three cases ({settled.campaigns} campaigns)",
            "calibration_settled",
        ),
        (
            "J and K when the cause has no name",
            "after `unknown` 90 % intervals hold in {remainder.tacho.remainder} % with and "
            "{remainder.no_tacho.remainder} % without tachometers; those of a fit that believes "
            "its model in {remainder.tacho.stated} and {remainder.no_tacho.stated} % "
            "({remainder.campaigns} campaigns); of {remainder.diagnosed} that a diagnosis calls so"
            ", most of them with the hardest shapes, in {remainder.diagnosed_hold} %",
            "unmodelled_disturbance",
        ),
        (
            "Spacecraft of other kinds: gyros of any number and axes, thrusters, rotors, no gyro, "
            "no star tracker, no actuator",
            "{spacecraft.trusted} of {spacecraft.campaigns} campaigns of {spacecraft.kinds} kinds "
            "are trusted, described by keys alone and flown by another simulator; 90 % intervals "
            "hold in {spacecraft.held} %, the largest error is {spacecraft.largest} sd",
            "spacecraft",
        ),
        (
            "A gyro whose bias walks",
            "errors are {walk.stated_low} to {walk.stated_high} times their sd with the walk "
            "stated, {walk.estimated_low} to {walk.estimated_high} with its size estimated; up to "
            "{walk.white_high} times with white noise ({walk.campaigns} campaigns)",
            "random_walk",
        ),
        (
            "Other methods on the same telemetry",
            "moments to {peers.clean.least_squares.moments} % (least squares), "
            "{peers.clean.filter.moments} % (Kalman filter), "
            "{peers.clean.package.moments} % (here)",
            "other_methods",
        ),
        (
            "Did J change from campaign to campaign?",
            "a jump of 1 % is dated in {series.dated} of 100 series of six campaigns; none is "
            "invented in {series.quiet} of 200; of {series.flown_all} that were flown and fitted "
            "{series.flown} are right",
            "series_of_campaigns",
        ),
        (
            "Sister spacecraft",
            "errors of J and K are {series.fleet_low} to {series.fleet_high} times their sd in "
            "fleets of 5, 20 and 200",
            "series_of_campaigns",
        ),
        ("Ferguson's paper, redone", "each table and claim, with a verdict", "PAPER"),
    ),
    "What is missing": (
        (
            "One hidden effect, as large as the best possible test finds in 99 of 100 campaigns",
            "with tachometers found in {naming.tacho.found} of {naming.tacho.campaigns} "
            "campaigns, without in {naming.no_tacho.found} of "
            "{naming.no_tacho.campaigns}; the only "
            "name in {naming.tacho.alone_percent} and {naming.no_tacho.alone_percent} %; a wrong "
            "name without the right one in {naming.tacho.wrong} and {naming.no_tacho.wrong}",
            "table",
        ),
        (
            "Nothing hidden",
            "an effect is named in {naming.clean_named} of {naming.clean} campaigns",
            "table",
        ),
        (
            "A law that no effect is, three times as strong as the best possible test finds",
            "of {formulas.laws} campaigns of twenty laws the formula is named, or listed as its "
            "equal, in {formulas.named}, listed beside other answers in {formulas.listed}; a wrong "
            "formula is named in {formulas.wrong}, effects that imitate the law in "
            "{formulas.imitated}",
            "formulas",
        ),
        (
            "The same, just as strong as that test finds",
            "too weak as a rule: of {formulas_once.laws} campaigns the formula is named in "
            "{formulas_once.named}, listed beside other answers in {formulas_once.listed}; nothing "
            "is found in {formulas_once.missed}; a wrong formula is named in "
            "{formulas_once.wrong}, effects that imitate the law in {formulas_once.imitated}",
            "formulas",
        ),
        (
            "An effect 3, 10 and 30 times as strong whose shape differs a little (a delay for a "
            "lag, friction with a dip, a tilted field, a gain that drifts)",
            "the right name is named or in the set in {nearly.right} of {nearly.campaigns} "
            "campaigns, half of them without tachometers",
            "nearly",
        ),
        (
            "Nothing hidden, the noise of a sensor not as stated: louder, in one axis or slew, "
            "heavy tails",
            "nothing is named in {strange_noise.nothing} of {strange_noise.campaigns}; "
            "`unknown` in {strange_noise.unknown}",
            "strange_noise",
        ),
        (
            "Two effects at once; three",
            "all found in {naming.pair_found} of {naming.pair}; {naming.triple_found} of "
            "{naming.triple}",
            "table",
        ),
        (
            "Random effects (bias instability, random torque, ...) of the same size",
            "with tachometers found in {naming.random_found} of {naming.random}",
            "table",
        ),
        (
            "Twelve disturbances that the library does not hold",
            "no false certainty in {outside.tacho_akin} of {outside.tacho} with and "
            "{outside.no_tacho_akin} of {outside.no_tacho} without tachometers: `unknown`, an "
            "unmodelled disturbance or a formula among the answers, or, of those without a fixed "
            "shape, the random effect that enters at the same place",
            "table",
        ),
        (
            "Noise that wanders as the campaign states",
            "an effect is named in {stated.named} of {stated.campaigns} campaigns",
            "table",
        ),
        (
            "Are stated probabilities true?",
            "in {reliability.prior} campaigns drawn from the prior that they assume: "
            "{reliability.prior_1_true} % of {reliability.prior_1_count} answers stated at "
            "{reliability.prior_1_stated} % are true, {reliability.prior_2_true} % of "
            "{reliability.prior_2_count} stated at {reliability.prior_2_stated} %",
            "table",
        ),
        (
            "The same where effects are larger than that prior has them",
            "cautious: {reliability.others_1_true} % of "
            "{reliability.others_1_count} answers stated at {reliability.others_1_stated} % are "
            "true, {reliability.others_2_true} % of {reliability.others_2_count} stated at "
            "{reliability.others_2_stated} %",
            "reliability",
        ),
        (
            "P-values of random effects where there is none",
            "uniform, as they should be",
            "random_null",
        ),
        (
            "Real bodies with one wheel, thrown by hand: the cause is `unknown`",
            "mean error of the principal moments before and after `diagnose`: "
            "{throws.config_empty.plain} and {throws.config_empty.diagnosed} %, "
            "{throws.config_a.plain} and {throws.config_a.diagnosed} % for two bodies; the truth, "
            "known to 1 %, is inside the intervals. Halves of the throws of a body differ by "
            "{throws.config_empty.halves_plain} % fitted and {throws.config_empty.halves_quoted} % "
            "diagnosed alone, those of the other by {throws.config_a.halves_plain} and "
            "{throws.config_a.halves_quoted} %: where the cause is `unknown`, a diagnosis does not "
            "bring J nearer as a rule",
            "throws_diagnosis",
        ),
        ("The same bodies, fitted alone", "all throws of a body in one fit", "throws"),
        (
            "A real CubeSat in free rotation, gyro and magnetometer",
            "which number of its CAD tensor is wrong, and what turns its spin",
            "tumble",
        ),
    ),
    "Telemetry": (
        (
            "A wrong unit, sign, axis, order or clock",
            "`doctor` names the change in {conventions.named} of {conventions.shown} cases of "
            "{conventions.kinds} kinds; of {conventions.right} right campaigns it accuses "
            "{conventions.accused}",
            "conventions",
        ),
        (
            "Wrong keys of thrusters, rotors, told torques, gyros of any axes, direction sensors",
            "`doctor` names {wrong_keys.named} of {wrong_keys.shown} that the data can show; of "
            "{wrong_keys.right} right campaigns it accuses {wrong_keys.accused}",
            "conventions_kinds",
        ),
        (
            "Gaps, outliers, stuck values, clock jumps: random combinations",
            "{dirt.trusted} of {dirt.cases} trusted, {dirt.refused} "
            "refused, {dirt.stopped} stopped "
            "with the row; no trusted number further than {dirt.worst} sd from the truth",
            "telemetry_faults",
        ),
        (
            "The same beside a hidden effect, by `fit` alone",
            "{dirt.hidden_wrong} of {dirt.hidden} trusted and wrong: `diagnose` is for that",
            "telemetry_faults",
        ),
        (
            "Raw logs distorted at random: columns, clocks, units, files",
            "{distortions.trusted} of {distortions.cases} trusted, none further than "
            "{distortions.worst} quoted sd from the truth; {distortions.tracebacks} tracebacks; "
            "the others are refused or not trusted, with what to mend",
            "import_distortions",
        ),
        ("One campaign in 17 raw formats", "imported numbers agree to 15 digits", "import_formats"),
        ("Another mission's raw logs", "J and K as from the native campaign", "foreign_campaign"),
        (
            "A stranger's six tasks, from the pages alone",
            "times, and what hindered, before and after",
            "first_walk",
        ),
        (
            "Damaged files",
            "{faults.cases}: {faults.accepted} read, {faults.refused} refused with one line; no "
            "traceback",
            "damaged_files",
        ),
    ),
    "The next slews": (
        (
            "Designed slews against slews like the paper's, in the same time",
            "worst product of inertia {design.cross_terms} times better, J as a whole "
            "{design.inertia}, K {design.scale_factors}, correction slew {design.correction_slew}",
            "design",
        ),
        (
            "Forecast against achieved sds",
            "{design.ratio_low} to {design.ratio_high} ({design.campaigns} campaigns)",
            "design",
        ),
        ("Why are products of inertia hard?", "what hides them, and what helps", "CROSS_TERMS"),
    ),
    "Computing": (
        (
            "Effective samples a second",
            "{sampling.stretch} times emcee's StretchMove, {sampling.de} times its DEMove, "
            "{sampling.nuts} times NUTS on the same posterior; {sampling.by_hand} times emcee over "
            "`solve_ivp`",
            "benchmark",
        ),
        (
            "One evaluation of the posterior",
            "against a kernel written by hand",
            "evaluation_benchmark",
        ),
        (
            "Least-squares solvers",
            "the package's and optimistix's, from wrong starts",
            "optimizer_benchmark",
        ),
        (
            "Processor time of a fit of five slews, and of a diagnosis",
            "{engine.fit} s and {engine.diagnosis} s once compiled, "
            "{engine.first} s the first fit; "
            "{engine.memory} GB",
            "engine",
        ),
        (
            "Killed workers and drivers",
            "{engine.killed_fits} fits, killed {engine.kills} times: the same bits at the end",
            "engine",
        ),
        ("A cancelled job on SLURM", "the same bits at the end", "slurm"),
        (
            "Memory of one process",
            "below {memory.peak} GiB over {memory.diagnoses} diagnoses of as many shapes; a fit "
            "of 50 slews at 10 Hz peaks "
            "at {memory.slews_peak} GB",
            "memory",
        ),
    ),
}


def study_table(values: Mapping[str, str]) -> list[str]:
    """Headings and tables, in Markdown, for a page in docs/."""
    lines: list[str] = []
    for subject, studies in _STUDIES.items():
        body = [
            (question, _filled(answer, values), _link(page)) for question, answer, page in studies
        ]
        lines += [f"## {subject}", "", *table_lines(("question", "answer", "study"), body), ""]
    return lines[:-1]


def _filled(answer: str, values: Mapping[str, str]) -> str:
    for name in values:
        answer = answer.replace(f"{{{name}}}", values[name])
    if "{" in answer:
        raise KeyError(f"no such number: {answer}")
    return answer


def _link(page: str) -> str:
    (path,) = ANALYSES.rglob(f"{page}.md")
    return f"[{page}](../analyses/{path.relative_to(ANALYSES)})"
