"""Numbers of the numerical methods, each with its reason."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Numerics:
    """Fields by the file that reads them."""

    # `device_arrays.py`
    # Rows or star-tracker fixes of a slew are padded to so many at least. Sizes are multiples of
    # three, as the rows of an integration step are.
    smallest_padding: int = 48
    # Up to here sizes are doubled: compiling (30 s of a fit) costs more than running (5 s). Beyond,
    # there is a size between.
    doubled_up_to: int = 768

    # `least_squares.py`
    # Damping of a correction: stiff directions move, weak ones stay. Corrections of one step at
    # most: with derivatives from before the step they converge slowly.
    correction_damping: float = 1e-4
    most_corrections: int = 8
    # One that leaves more than this share of what exceeds the target is the last.
    most_left: float = 0.8
    # A descent ends when so many steps together gained less than so many tolerances.
    stall_steps: int = 5
    stall_tolerances: float = 100.0
    # Gauss-Newton converges the more slowly the larger the misfit, which counts up to so many
    # times.
    most_misfit_counted: float = 30.0
    # Half-width of the trust region, in sizes of the coordinates: at first, and where no step is
    # short enough.
    first_radius: float = 1.0
    smallest_radius: float = 1e-12
    # Share of a step's promise below which it disappoints and is corrected, and below and above
    # which the region shrinks and grows, and by what.
    disappointing_share: float = 0.9
    poor_share: float = 0.25
    good_share: float = 0.75
    shrink: float = 0.25
    grow: float = 2.0
    # Damping that keeps the normal matrix definite in spite of rounding, relative.
    least_damping: float = 1e-12

    # `linear_algebra.py`
    # Signal-to-noise power, for an effect of prior size, below which a direction is invisible.
    visible_power: float = 1.0


NUMERICS = Numerics()
