"""What several of the tests in `inference` use."""

from __future__ import annotations

DRIVES = ("commanded", "measured")
