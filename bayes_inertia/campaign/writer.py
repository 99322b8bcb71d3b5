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
from bayes_inertia.files import write_atomically

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

    The folder gets `campaign.toml` and one `slew_NN.csv` a slew. All digits are kept and NaN
    becomes an empty cell; angles of slews are kept to 15 digits. The description comes last: an
    interrupted write leaves no campaign, and writing again completes it.

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
        If a file of another content is in the way, or the system refuses; if some slews but not
        all have wheel telemetry (`[columns]` hold for all slews); if wheel or environment telemetry
        has gaps (which cannot be read back).
    """
    folder = Path(folder)
    content = {name: text.encode("utf-8") for name, text in _render(campaign).items()}
    try:
        folder.mkdir(parents=True, exist_ok=True)
        present = {
            name: (folder / name).read_bytes() for name in content if (folder / name).exists()
        }
    except OSError as error:
        raise OutputError(
            f"cannot be used ({error.strerror or error})",
            where=str(folder),
            advice="name a folder that can be made or written to",
        ) from error
    in_the_way = [name for name in content if name in present and present[name] != content[name]]
    if in_the_way:
        raise OutputError(
            "would overwrite another campaign",
            where=str(folder / in_the_way[0]),
            advice="write to a new folder",
        )
    for name, data in content.items():
        if name not in present:
            write_atomically(folder / name, data)
    return folder


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
        having = [_has(slew, channel) for slew in campaign.slews]
        per_wheel = isinstance(names, str)
        if (
            not any(having)
            or (per_wheel and not campaign.wheels)
            or (channel == "attitude" and campaign.star_tracker is None)
        ):
            continue
        if per_wheel and not all(having):
            lacking = campaign.slews[having.index(False)].name
            raise OutputError(
                f"no {channel}, which other slews have",
                where=f"slew {lacking}",
                advice="write the slews with and without it as two campaigns",
            )
        for slew in campaign.slews:
            values = getattr(slew, channel)
            if (
                channel not in ("rate", "attitude")
                and values is not None
                and np.isnan(values).any()
            ):
                row = int(np.argmax(np.isnan(values).any(axis=1)))
                raise OutputError(
                    f"{channel} has a gap in row {row + 1}",
                    where=f"slew {slew.name}",
                    advice="fill it, or leave the channel out",
                )
        if isinstance(names, str):
            columns[channel] = [names.format(i + 1) for i in range(len(campaign.wheels))]
        else:
            columns[channel] = list(names)
    return columns


def _has(slew: Slew, channel: str) -> bool:
    values = getattr(slew, channel)
    return values is not None and not (channel == "attitude" and np.isnan(values).all())


def _csv(slew: Slew, columns: dict[str, list[str]]) -> str:
    parts = [slew.time[:, None]]
    for channel, names in columns.items():
        values = getattr(slew, channel)
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
    tracker = campaign.star_tracker
    document["inertia"] = _table(**vars(campaign.inertia))
    if campaign.wheels:
        document["wheels"] = _tables(_wheel_table(wheel) for wheel in campaign.wheels)
    document["rate_sensor"] = _table(**vars(campaign.rate_sensor))
    if tracker is not None:
        document["star_tracker"] = _table(
            boresight=tracker.boresight_B,
            sigma_cross=tracker.sigma_cross,
            sigma_roll=tracker.sigma_roll,
        )
    document["columns"] = _columns_toml(columns, tomlkit)
    document["slews"] = _tables(
        _slew_table(slew, file) for slew, file in zip(campaign.slews, files, strict=True)
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


def _tables(parts: Iterable[Any]) -> Any:
    """An array of tables of TOML."""
    import tomlkit

    listed = tomlkit.aot()
    for part in parts:
        listed.append(part)
    return listed


def _wheel_table(wheel: Wheel) -> Any:
    entries = vars(wheel).items()
    return _table(**{"axis" if key == "axis_B" else key: value for key, value in entries})


def _slew_table(slew: Slew, file: str) -> Any:
    return _table(
        name=slew.name,
        file=file,
        start=slew.start,
        axis=slew.axis_B,
        angle_deg=_degrees(slew.angle),
    )


def _columns_toml(columns: dict[str, list[str]], tomlkit: Any) -> Any:
    part = tomlkit.table()
    for key, entries in [("time", {"names": ["t_s"], "unit": "s"})] + [
        (key, {"names": columns[channel], **sense})
        for channel, (key, sense, _) in _CHANNELS.items()
        if channel in columns
    ]:
        entry = tomlkit.inline_table()
        entry.update(entries)
        part[key] = entry
    return part


def _degrees(angle: float | None) -> float | None:
    # 15 digits return the degrees that were read, so that copying a campaign changes nothing.
    return None if angle is None else float(f"{math.degrees(angle):.15g}")
