"""From a `Campaign` to a campaign folder that reads back as the same numbers."""

from __future__ import annotations

import math
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.hardware import Wheel
from bayes_inertia.campaign.schema import FORMAT
from bayes_inertia.campaign.slew import Slew
from bayes_inertia.errors import OutputError
from bayes_inertia.files import write_new_files

# Slew field -> key of [columns], its unit and sense, and its columns (a text: one a wheel).
_CHANNELS = {
    "wheel_torque": ("wheel_torque", {"unit": "N m", "acts_on": "wheel"}, "u{}_Nm"),
    "wheel_momentum": ("wheel_momentum", {"unit": "N m s", "relative_to": "body"}, "h{}_Nms"),
    "rate": ("rate", {"unit": "rad/s"}, ["wx_radps", "wy_radps", "wz_radps"]),
    "attitude": (
        "attitude",
        {"scalar": "last", "maps": "inertial_to_body"},
        ["q1", "q2", "q3", "q4"],
    ),
    "magnetic_field_N": (
        "magnetic_field",
        {"unit": "T", "frame": "inertial"},
        ["Bx_N_T", "By_N_T", "Bz_N_T"],
    ),
    "position_N": ("position", {"unit": "m", "frame": "inertial"}, ["rx_N_m", "ry_N_m", "rz_N_m"]),
}


def write_campaign(campaign: Campaign, folder: str | Path) -> Path:
    """Write a campaign as a folder that reads back as the same numbers.

    The folder gets `campaign.toml` and one `slew_NN.csv` a slew, also where the telemetry was read
    from several streams. All digits are kept and NaN becomes an empty cell; angles of slews are
    kept to 15 digits. The description comes last: an interrupted write leaves no campaign, and
    writing again completes it.

    Parameters
    ----------
    campaign : Campaign
        The campaign.
    folder : str or Path
        Where to; made if absent. Identical files may be there already.

    Returns
    -------
    Path
        The folder.

    Raises
    ------
    OutputError
        If a file of another content is in the way, or the system refuses; if a rate axis or a
        wheel has no number in a slew, or a vector of the environment lacks one (which cannot be
        read back).

    Examples
    --------
    >>> from pathlib import Path
    >>> from tempfile import TemporaryDirectory
    >>> from bayes_inertia.physics.small_campaign import small_campaign
    >>> with TemporaryDirectory() as parent:
    ...     folder = write_campaign(small_campaign(), Path(parent) / "small")
    ...     sorted(path.name for path in folder.iterdir())[:2]
    ['campaign.toml', 'slew_01.csv']
    """
    content = {name: text.encode("utf-8") for name, text in _render(campaign).items()}
    return write_new_files(folder, content, holds="campaign")


def _render(campaign: Campaign) -> dict[str, str]:
    """The files of the folder, by name, the description last."""
    columns = _columns(campaign)
    digits = max(2, len(str(len(campaign.slews))))
    files = [f"slew_{i:0{digits}d}.csv" for i in range(1, len(campaign.slews) + 1)]
    content = {file: _csv(slew, columns) for file, slew in zip(files, campaign.slews, strict=True)}
    content["campaign.toml"] = _toml(campaign, columns, files)
    return content


def _columns(campaign: Campaign) -> dict[str, list[str]]:
    """The channels that the campaign has, with the names of their columns."""
    columns: dict[str, list[str]] = {}
    for channel, (_, _, names) in _CHANNELS.items():
        having = [slew for slew in campaign.slews if _has(slew, channel)]
        per_wheel = isinstance(names, str)
        if (
            not having
            or (per_wheel and not campaign.wheels)
            or (channel == "attitude" and campaign.star_tracker is None)
        ):
            continue
        for slew in having:
            _refuse_what_reading_refuses(slew, channel)
        if isinstance(names, str):
            columns[channel] = [names.format(i + 1) for i in range(len(campaign.wheels))]
        else:
            columns[channel] = list(names)
    return columns


def _has(slew: Slew, channel: str) -> bool:
    """Whether a slew has a channel; fixes and environment without a number count as absent."""
    values = getattr(slew, channel)
    may_be_empty = channel == "attitude" or channel.endswith("_N")
    return values is not None and not (may_be_empty and np.isnan(values).all())


def _refuse_what_reading_refuses(slew: Slew, channel: str) -> None:
    """Raise `OutputError` for gaps in a channel that cannot be read back."""
    empty = np.isnan(getattr(slew, channel))
    if channel in ("rate", "wheel_momentum") and empty.all(axis=0).any():
        raise OutputError(
            f"{channel} has no number in column {int(np.argmax(empty.all(axis=0))) + 1}",
            where=f"slew {slew.name}",
            advice="leave the channel or the slew out",
        )
    if channel.endswith("_N") and (empty.any(axis=1) != empty.all(axis=1)).any():
        row = int(np.argmax(empty.any(axis=1) != empty.all(axis=1)))
        raise OutputError(
            f"{channel} has a gap in row {row + 1}",
            where=f"slew {slew.name}",
            advice="fill it, or leave the row of the channel empty",
        )


def _columns_of(slew: Slew, columns: dict[str, list[str]]) -> dict[str, list[str]]:
    """The columns of a slew's table; what belongs to the wheels only where the slew has it."""
    return {
        channel: names
        for channel, names in columns.items()
        if _has(slew, channel) or not channel.startswith("wheel")
    }


def _csv(slew: Slew, columns: dict[str, list[str]]) -> str:
    columns = _columns_of(slew, columns)
    parts = [slew.time[:, None]]
    for channel, names in columns.items():
        values = getattr(slew, channel)
        if channel == "wheel_torque" and values is not None and slew.lost_command is not None:
            values = np.where((slew.lost_command > 0)[:, None], np.nan, values)
        parts.append(np.full((len(slew.time), len(names)), np.nan) if values is None else values)
    header = ["t_s", *(name for names in columns.values() for name in names)]
    return _lines(
        [header, *([_cell(x) for x in row] for row in np.concatenate(parts, axis=1).tolist())]
    )


def _cell(value: float) -> str:
    return "" if math.isnan(value) else repr(value)


def _lines(rows: Iterable[list[str]]) -> str:
    return "".join(",".join(row) + "\n" for row in rows)


def _plain(value: Any) -> Any:
    """Python numbers and lists, which is what TOML writers know."""
    if isinstance(value, bool | str):
        return value
    return np.asarray(value, dtype=float).tolist()


def _toml(campaign: Campaign, columns: dict[str, list[str]], files: list[str]) -> str:
    """The text of campaign.toml."""
    import tomlkit

    document = tomlkit.document()
    document["format"], document["name"] = FORMAT, campaign.name
    if campaign.mission:
        document["mission"] = _table(**dict(campaign.mission))
    tracker = campaign.star_tracker
    document["inertia"] = _table(**vars(campaign.inertia))
    if campaign.wheels:
        document["wheels"] = array_of_tables(_wheel_table(wheel) for wheel in campaign.wheels)
    document["rate_sensor"] = _table(**vars(campaign.rate_sensor))
    if tracker is not None:
        document["star_tracker"] = _table(
            boresight=tracker.boresight_B,
            sigma_cross=tracker.sigma_cross,
            sigma_roll=tracker.sigma_roll,
            low_frequency_sigma=tracker.low_frequency_sigma,
        )
    document["columns"] = _columns_toml(columns)
    document["slews"] = array_of_tables(
        _slew_table(slew, file, columns) for slew, file in zip(campaign.slews, files, strict=True)
    )
    return tomlkit.dumps(document)


def _table(**entries: Any) -> Any:
    """A table of TOML without the entries that are None."""
    import tomlkit

    part = tomlkit.table()
    for key, value in entries.items():
        if value is not None:
            part[key] = _plain(value)
    return part


def array_of_tables(parts: Iterable[Any]) -> Any:
    """An array of tables of TOML."""
    import tomlkit

    listed = tomlkit.aot()
    for part in parts:
        listed.append(part)
    return listed


def _wheel_table(wheel: Wheel) -> Any:
    entries = vars(wheel).items()
    return _table(**{"axis" if key == "axis_B" else key: value for key, value in entries})


def _slew_table(slew: Slew, file: str, columns: dict[str, list[str]]) -> Any:
    part = _table(
        name=slew.name,
        file=file,
        start=slew.start,
        axis=slew.axis_B,
        angle_deg=_degrees(slew.angle),
    )
    own = _columns_of(slew, columns)
    if len(own) < len(columns):
        del part["file"]
        part["files"] = _inline({_CHANNELS[channel][0]: file for channel in own})
    return part


def _inline(entries: dict[str, Any]) -> Any:
    """An inline table of TOML."""
    import tomlkit

    table = tomlkit.inline_table()
    table.update(entries)
    return table


def _columns_toml(columns: dict[str, list[str]]) -> Any:
    import tomlkit

    part = tomlkit.table()
    for key, entries in [("time", {"names": ["t_s"], "unit": "s"})] + [
        (key, {"names": columns[channel], **sense})
        for channel, (key, sense, _) in _CHANNELS.items()
        if channel in columns
    ]:
        part[key] = _inline(entries)
    return part


def _degrees(angle: float | None) -> float | None:
    # 15 digits return the degrees that were read, so that copying a campaign changes nothing.
    return None if angle is None else float(f"{math.degrees(angle):.15g}")
