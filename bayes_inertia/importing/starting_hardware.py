"""The hardware's part of a mapping to be filled in: inertia, wheels, sensors."""

from __future__ import annotations

import re
from collections.abc import Sequence

from bayes_inertia.importing.mapping_schema import MAPPING_FORMAT
from bayes_inertia.importing.mapping_text import mapping_entry
from bayes_inertia.importing.questions import UNKNOWN
from bayes_inertia.tables.time_columns import split_unit

_AXES = {"x": [1.0, 0.0, 0.0], "y": [0.0, 1.0, 0.0], "z": [0.0, 0.0, 1.0]}


def wheel_words(names: Sequence[str]) -> list[str]:
    """What tells the columns of the wheels from each other.

    Parameters
    ----------
    names : sequence of str
        One column a wheel.

    Returns
    -------
    list of str
        A word a wheel: "x" of "cmd_wheel_x", else its number.

    Examples
    --------
    >>> wheel_words(["cmd_wheel_x", "cmd_wheel_y"]), wheel_words(["rw1_rpm", "rw2_rpm"])
    (['x', 'y'], ['1', '2'])
    """
    stems = [split_unit(name)[0] for name in names]
    before = _shared(stems)
    after = _shared([stem[before:][::-1] for stem in stems])
    words = [stem[before : len(stem) - after].lower() for stem in stems]
    usable = len(set(words)) == len(words) and all(re.fullmatch(r"[a-z0-9]+", w) for w in words)
    return words if usable and len(words) > 1 else [str(k + 1) for k in range(len(words))]


def _shared(texts: Sequence[str]) -> int:
    """Number of letters with which all texts begin."""
    columns = list(zip(*texts, strict=False))
    return next((k for k, letters in enumerate(columns) if len(set(letters)) > 1), len(columns))


def hardware_text(name: str, wheels: Sequence[str], *, tracker: bool, epoch: str = "") -> str:
    """Format, name and hardware of a mapping to be filled in.

    Parameters
    ----------
    name : str
        A name for the campaign.
    wheels : sequence of str
        What tells the wheels apart, as `wheel_words` says it; none without wheels.
    tracker : bool
        Whether a stream holds attitudes.
    epoch : str
        Zero of the clocks that count; "?" asks, "" where no stream has one.

    Returns
    -------
    str
        TOML with comments.
    """
    lines = [
        '# What the raw logs hold. Answer every question: replace each "?" and delete what does',
        "# not apply. Suggestions come from the files and from names of columns: check them.",
        f'format = "{MAPPING_FORMAT}"',
        mapping_entry(("name",), name, "any text"),
        *([mapping_entry(("epoch",), epoch)] if epoch else []),
        "",
        "[inertia]",
        *(
            mapping_entry(("inertia", key), UNKNOWN)
            for key in ("tensor", "relative_sigma", "product_sigma", "includes_wheel_spin")
        ),
    ]
    for word in wheels:
        lines += _wheel(word, wheels[0])
    lines += [
        "",
        "[rate_sensor]",
        '# sigma = ...  # white noise per sample [rad/s], or such as "3 arcsec/s"; left out, the',
        "#              # import says what it sees",
        "# scale_factor_sigma = 0.03",
        "# bias_sigma = 1e-5  # [rad/s]",
        "# rate_random_walk = ...  # RRW of the data sheet [rad/s^1.5]",
    ]
    if tracker:
        lines += [
            "",
            "[star_tracker]",
            mapping_entry(("star_tracker", "boresight"), UNKNOWN),
            '# sigma_cross = ...  # noise across the boresight [rad], or such as "5 arcsec"; left',
            "#                    # out, the import says what it sees",
            "# sigma_roll = ...  # and about it [rad]",
        ]
    return "\n".join(lines) + "\n"


def _wheel(word: str, first: str) -> list[str]:
    """One `[[wheels]]`."""
    axis = _AXES.get(word, UNKNOWN)
    why = "from the name of its column: check axis and sign in the drawing"
    lines = [
        "",
        "[[wheels]]",
        mapping_entry(("wheels", "", "name"), f"wheel_{word}"),
        mapping_entry(("wheels", "", "axis"), axis, why),
    ]
    if word != first:
        why = "spin inertia, limits and noise; or give its own here"
        return [*lines, mapping_entry(("wheels", "", "same_as"), f"wheel_{first}", why)]
    return [
        *lines,
        mapping_entry(("wheels", "", "spin_inertia"), UNKNOWN),
        "# max_torque = ...  # [N m]; optional, with it impossible commands are seen",
        "# max_momentum = ...  # [N m s]; optional, with it impossible readings are seen",
        "# momentum_sigma = ...  # noise of the tachometer [N m s]; the import measures it",
    ]
