"""Layout of the report and its pictures, and limits from which a sentence is said."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Layout:
    """Fields by the file that reads them."""

    # `words/diagnosis.txt`
    # Answers that are told: more probable than this, and so many at most.
    negligible_probability: float = 0.01
    most_answers_told: int = 4
    nearly_certain: float = 0.99
    # Share of the power above which a torque without a name has one axis.
    one_axis_share: float = 0.8
    # Share of the misfit above which what such a torque goes along with is mentioned.
    mentioned_share: float = 0.3
    # rms before the wheels act over rms afterwards below which a ringing begins with them.
    quiet_ratio: float = 0.4

    # `fit_sections.py`, of a diagnosis
    most_alike_listed: int = 8
    evidence_rows_shown: int = 3  # rows of a table of evidence; the others are folded
    most_windows_listed: int = 12
    most_matches_listed: int = 3
    most_answers_listed: int = 8

    # p-value below which "one campaign of so many" is no longer counted out
    rare_p_value: float = 1e-3

    # In units of the sd: a smaller difference between two models is called none.
    negligible_difference_sd: float = 0.1
    formulas_listed: int = 3
    least_false_alarms: float = 1e-6  # no simulation tells a smaller share

    # `export/formats.py`
    # Digits beyond the second of the sd, so that rounding moves a number by less than sd / 1000.
    guard_digits: int = 2
    comment_line: int = 200  # [characters] of a comment; CCSDS messages allow 254 a line

    # `fit_sections.py`
    most_parameters_drawn: int = 16

    # `verdict.py`
    # A parameter whose sd would be so many times larger without one slew rests on that slew.
    rests_on_one_slew: float = 3.0

    # `formatting.py`
    named_axis: float = 15.0  # [deg] to a body axis within which a direction has its name
    smallest_plain: float = 1e-3  # smaller numbers are written with a power of ten
    smallest_p_value: float = 1e-100

    # `words.py`
    # Beyond it two parameters are said to be hard to tell apart.
    strong_correlation: float = 0.9
    # Of what J and K are averaged over so many cases are listed; the rest are summed up.
    most_cases_listed: int = 5

    # `pictures/telemetry.py`, attitude
    most_slew_names: int = 8  # more slews than this are numbered

    # `pictures/study.py`
    calibration_row_height: float = 2.5  # [in]

    # `pictures/diagnosis.py`
    smallest_p_drawn: float = 1e-300  # what is smaller is drawn here
    largest_on_linear_axis: float = 40.0  # beyond this strength the axis is logarithmic
    strength_ticks: tuple[int, ...] = (0, 2, 5, 10, 30, 100, 300)

    # `pictures/chains.py`
    chain_bins: int = 20

    # `pictures/design.py`
    plan_label_width: int = 22  # letters of a line of a plan's name

    # `pictures/diagnosis.py`, where the model disagrees
    color_limit_sigma: float = 6.0  # sigma at which colours saturate
    most_frames: int = 2  # in one channel and slew

    # `pictures/figure_file.py`
    # Dots per inch, colours and their choice of a PNG: the next where the file would be too large.
    # The octree is truer to many colours, coverage keeps white and pale grey among few.
    png_qualities: tuple[tuple[int, int, str], ...] = (
        (130, 128, "FASTOCTREE"),
        (110, 48, "MAXCOVERAGE"),
        (100, 32, "MAXCOVERAGE"),
    )
    svg_dpi: int = 110  # of a rasterised artist: a page shows 96
    # Of a rasterised artist: few hues, each with its shades of transparency
    colours_in_svg: int = 64

    # `pictures/observability.py`
    most_slews_of_information: int = 6
    sd_factors: tuple[float, ...] = (1, 1.5, 2, 3, 5, 10, 30, 100, 1000, 10000, 100000)
    # Decades from which on there is room for powers of ten alone.
    decades_of_sd_factors: float = 2.5

    # `pictures/posterior_data.py`
    # [half slews] between fixes that come during slews too; bursts at rest leave the motion out.
    longest_pause_of_fixes: float = 0.5

    # `pictures/pairs.py`
    cell_pixels: int = 44
    density_shades: int = 12  # of the densities; more cost bytes and show nothing
    cell_half_width_sd: float = 3.4  # cells show the mean +- this many sds
    cell_gap: float = 0.06
    most_upright_labels: int = 10  # more labels than this are turned

    # `pictures/pairs.py`, priors
    density_bins: int = 96  # of a density
    # Below this ratio of quoted to prior sd the prior would look flat: it has a strip of its own.
    zoomed_sd_ratio: float = 0.12
    prior_strip_height: tuple[float, float] = (0.80, 0.98)  # height of that strip in axes fractions

    # `pictures/series.py`, `pictures/telemetry.py`
    sds_of_90_percent: float = 1.645  # half width of the central 90 % of a normal distribution

    # `pictures/diagnosis.py`, steps
    misfit_ticks: tuple[float, ...] = (0.5, 1, 2, 5, 10, 30, 100, 300, 1000, 1e4, 1e5, 1e6)

    # `pictures/style.py`
    picture_width: float = 10.0  # [in]
    # With colours gone, dash pattern and marker still tell components apart.
    dashes: tuple[tuple[int, tuple[float, ...]], ...] = (
        (0, ()),
        (0, (5, 2)),
        (0, (1.5, 1.5)),
        (0, (6, 2, 1.5, 2)),
        (0, (8, 3)),
        (0, (3, 1, 1, 1, 1, 1)),
    )

    # `pictures/chains.py`, `pictures/telemetry.py`
    most_line_points: int = 900  # points of a line: two a pixel of a panel

    # `pictures/telemetry.py`
    most_dots: int = 600  # of a component in a panel, two a pixel

    # `plan_promise.py`
    # Achieved over promised sds beyond it are pointed out. Those of single flights of one plan
    # scatter by 2 to 7 % (one sd, 48 simulated flights of two plans; the largest was 1.12).
    worse_than_promised: float = 1.3

    # `plan_sections.py`
    worse_sd_ratio: float = 1.1  # ratio of sds from which a parameter is said to be known worse
    many_plans: int = 4  # columns that do not stand side by side on a phone

    # `residual_sections.py`
    most_slews_drawn: int = 9
    most_slews_listed: int = 40
    most_residuals: int = 24_000  # residuals in a page
    not_measured: int = -32768  # stands for a gap
    largest_step: int = 32767  # steps
    fewest_residual_rows: int = 50  # of a slew and channel
    stands_out: float = 5.0  # standard errors: noise makes one such channel and slew in a million

    # `criteria.py`
    # Just outside a 99 % interval happens once in a hundred; gates reject at one in a thousand. The
    # interval is widened by this share of its half width before anything is called wrong.
    interval_slack: float = 0.28

    # `run_comparison.py`
    # Differences beyond it are pointed out: noise makes one in three hundred.
    noticeable_sd: float = 3.0

    # `section.py`
    largest_svg: int = 200_000  # bytes; beyond, a PNG with a palette is smaller and as good to read
    largest_png: int = 125_000  # bytes

    # `series_sections.py`
    # A change is told as one above this probability, and as a possible one above the other.
    certain_change: float = 0.95
    possible_change: float = 0.2
    # A change of J by more than this share of the mean moment may be another spacecraft: it is
    # three times the largest jump that is weighed.
    another_body: float = 0.1
    most_dates: int = 6  # of the ticks of a panel: more overlap
    change_told_sd: float = 3.0  # elements of a jump that are told are as far from no change
    sharper_by_sisters: float = 1.1  # sisters that make nothing so much sharper are worth no word


LAYOUT = Layout()
