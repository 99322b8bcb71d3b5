"""Marks of tests."""

import pytest

# Another parameter stands for this one in every run; before a release all are run.
LIKE_ANOTHER = (pytest.mark.slow, pytest.mark.long)
