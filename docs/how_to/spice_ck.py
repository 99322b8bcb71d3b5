"""Attitudes of a SPICE CK as a CCSDS attitude ephemeris message, which `import` reads as it is.

    python docs/how_to/spice_ck.py tracker.aem -82000 attitude.bc clock.tsc leapseconds.tls

The number is that of the structure whose attitude the CK holds; after it all kernels that SPICE
needs: CK, spacecraft clock, leap seconds, frames; or a meta-kernel that names them. Every attitude
is written once, as it was put into the CK (data types 1 and 3): SPICE's interpolation would make
readings that nobody took.
Needs spiceypy: pip install 'bayes-inertia[spice]'.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import spiceypy

HEAD = """CCSDS_AEM_VERS = 2.0
CREATION_DATE = {start}
ORIGINATOR = SPICE

META_START
OBJECT_NAME = {structure}
OBJECT_ID = {structure}
REF_FRAME_A = EME2000
REF_FRAME_B = SC_BODY_1
TIME_SYSTEM = UTC
START_TIME = {start}
STOP_TIME = {stop}
ATTITUDE_TYPE = QUATERNION
META_STOP

DATA_START
"""


def attitudes(kernel: str, structure: int) -> Iterator[tuple[float, np.ndarray]]:
    """Time [s of TDB] and SPICE's quaternion, EME2000 to structure, of each attitude."""
    handle = spiceypy.dafopr(kernel)
    spiceypy.dafbfs(handle)
    while spiceypy.daffna():
        summary = spiceypy.dafgs(5)
        _, (of, frame, kind, *_) = spiceypy.dafus(summary, 2, 6)
        if of != structure:
            continue
        if kind not in (1, 3):
            sys.exit(f"{kernel}: type {kind} is a fit, no readings: sample it with spiceypy.ckgp")
        for clock, quaternion in (discrete if kind == 1 else instances)(handle, summary):
            time = spiceypy.sct2e(spiceypy.ckmeta(structure, "SCLK"), clock)
            from_j2000 = spiceypy.pxform("J2000", spiceypy.frmnam(int(frame)), time)
            yield time, spiceypy.m2q(spiceypy.q2m(quaternion) @ from_j2000)
    spiceypy.dafcls(handle)


def discrete(handle: int, summary: np.ndarray) -> Iterator[tuple[float, np.ndarray]]:
    """Ticks and quaternion of each attitude of a segment of type 1 (CK Required Reading)."""
    has_rates, begin, end = map(int, spiceypy.dafus(summary, 2, 6)[1][3:])
    number, width = int(spiceypy.dafgda(handle, end, end)[0]), 7 if has_rates else 4
    clocks = begin + number * width
    rows = spiceypy.dafgda(handle, begin, clocks - 1).reshape(number, width)
    yield from zip(spiceypy.dafgda(handle, clocks, clocks + number - 1), rows[:, :4], strict=True)


def instances(handle: int, summary: np.ndarray) -> Iterator[tuple[float, np.ndarray]]:
    """The same of a segment of type 3."""
    for number in range(1, spiceypy.cknr03(handle, summary) + 1):
        clock, *quaternion = spiceypy.ckgr03(handle, summary, number)[:5]
        yield clock, np.array(quaternion)


def message(structure: int, kernels: list[str]) -> str:
    """The message, its rows in the order of their times."""
    spiceypy.furnsh(kernels)
    # Those that a meta-kernel names too.
    of_ck = [spiceypy.kdata(k, "CK")[0] for k in range(spiceypy.ktotal("CK"))]
    found = sorted(
        (row for kernel in of_ck for row in attitudes(kernel, structure)), key=lambda r: r[0]
    )
    if not found:
        sys.exit(
            f"no attitudes of {structure} in {', '.join(of_ck) or 'these kernels: none is a CK'}"
        )
    stamps = [spiceypy.et2utc(time, "ISOC", 6) for time, _ in found]
    head = HEAD.format(structure=structure, start=stamps[0], stop=stamps[-1])
    # SPICE turns vectors from EME2000 to the structure by q; the message's sense is the other.
    rows = [
        f"{stamp} {-x:.12f} {-y:.12f} {-z:.12f} {scalar:.12f}\n"
        for stamp, (_, (scalar, x, y, z)) in zip(stamps, found, strict=True)
    ]
    spiceypy.unload(kernels)
    return head + "".join(rows) + "DATA_STOP\n"


if __name__ == "__main__":
    if len(sys.argv) < 4:
        sys.exit(__doc__)
    try:
        text = message(int(sys.argv[2]), sys.argv[3:])
    except spiceypy.utils.exceptions.SpiceyError as error:  # Such as a kernel that is missing.
        sys.exit(f"SPICE says: {error.short} {error.long}")
    Path(sys.argv[1]).write_text(text, encoding="utf-8")
