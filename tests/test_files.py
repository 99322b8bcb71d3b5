"""Digests and atomic writing."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from support.campaign_files import (
    assert_teaches,
)

from bayes_inertia.errors import OutputError
from bayes_inertia.files import write_atomically


@pytest.mark.parametrize(
    "content",
    [b"new", "new", lambda path: path.write_bytes(b"new")],
    ids=["bytes", "text", "function"],
)
def test_atomic_write(tmp_path, content):
    path = tmp_path / "result.nc"
    path.write_bytes(b"old")
    assert write_atomically(path, content) == path
    assert path.read_bytes() == b"new"
    assert [p.name for p in tmp_path.iterdir()] == ["result.nc"]


def test_a_failed_write_leaves_the_old_file(tmp_path):
    path = tmp_path / "result.nc"
    path.write_bytes(b"old")

    def fails(temporary: Path):
        assert (temporary.parent, temporary.suffix) == (tmp_path, ".nc")
        temporary.write_bytes(b"half")
        raise ValueError("interrupted")

    with pytest.raises(ValueError, match="interrupted"):
        write_atomically(path, fails)
    assert [(p.name, p.read_bytes()) for p in tmp_path.iterdir()] == [("result.nc", b"old")]
    for bad in (tmp_path / "no" / "folder.txt", path / "below.txt"):
        with pytest.raises(OutputError) as caught:
            write_atomically(bad, b"")
        assert_teaches(caught.value, [str(bad), "cannot be written"])


def test_written_files_have_ordinary_permissions(tmp_path):
    plain = tmp_path / "plain"
    plain.write_bytes(b"")
    assert os.stat(write_atomically(tmp_path / "atomic", b"")).st_mode == plain.stat().st_mode
