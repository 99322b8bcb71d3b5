"""What a process costs: waiting takes time by the clock, work takes time of a processor."""

from __future__ import annotations

import pytest


@pytest.mark.parametrize(
    ("code", "is_busy"),
    [
        ("import time; time.sleep(0.5)", False),
        ("import time\nwhile time.process_time() < 0.5: pass", True),
    ],
)
def test_waiting_is_no_work(analysis, code, is_busy):
    timed = analysis("engine.timed_process").timed_process([code])
    assert timed.clock_seconds >= 0.5
    assert (timed.processor_seconds >= 0.5) is is_busy


def test_what_a_failed_process_says_is_kept(analysis):
    timed = analysis("engine.timed_process").timed_process(
        ["import sys; sys.exit(sys.argv[1])", "why"]
    )
    assert (timed.exit_code, timed.message) == (1, "why\n")


def test_a_process_has_the_environment_it_is_given(analysis):
    code = "import os, sys; sys.exit(int(os.environ.get('CODE', 0)))"
    timed_process = analysis("engine.timed_process").timed_process
    assert timed_process([code], {"CODE": "7"}).exit_code == 7
    assert timed_process([code], {}).exit_code == 0
