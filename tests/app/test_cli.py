"""The command: exit codes, one clear message for bad input, and nothing overwritten."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import webbrowser
from pathlib import Path

import pytest
from support.commands import run

import bayes_inertia
from bayes_inertia.app.terminal import open_in_browser
from bayes_inertia.inference.posterior import Posterior

EXAMPLE = Path(bayes_inertia.__file__).parent / "example"


@pytest.fixture
def campaign(tmp_path):
    folder = tmp_path / "campaign"
    shutil.copytree(EXAMPLE, folder)
    return folder


def contents(folder: Path) -> dict[str, bytes]:
    return {
        str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()
    }


def edit(folder: Path, old: str, new: str, file: str = "campaign.toml") -> None:
    path = folder / file
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))


def test_check_says_what_the_example_contains(capsys):
    assert run("check", EXAMPLE) == 0
    printed = capsys.readouterr().out
    for word in ("slew 1", "slew 5", "commanded", "measured", "principal moments"):
        assert word in printed


def test_version_is_said(capsys):
    assert run("--version") == 0
    assert capsys.readouterr().out == f"bayes-inertia {bayes_inertia.__version__}\n"


def test_the_module_is_the_command():
    words = [sys.executable, "-m", "bayes_inertia", "--version"]
    said = subprocess.run(words, check=True, capture_output=True, text=True).stdout
    assert said == f"bayes-inertia {bayes_inertia.__version__}\n"


@pytest.mark.parametrize(("asked", "computes_on"), [(None, "cpu"), ("cuda", "cuda")])
def test_commands_compute_on_the_processor_unless_a_gpu_is_asked_for(
    monkeypatch, capsys, asked, computes_on
):
    monkeypatch.setenv("JAX_PLATFORMS", asked or "")
    if asked is None:
        monkeypatch.delenv("JAX_PLATFORMS")
    assert run("effects") == 0
    assert os.environ["JAX_PLATFORMS"] == computes_on


@pytest.mark.slow
def test_doctor_passes_its_own_test(capsys):
    assert run("doctor") == 0
    assert "passed" in capsys.readouterr().out


BAD = {
    "unknown key": (
        lambda f: edit(f, "relative_sigma", "relative_sigmma"),
        ("campaign.toml", "relative_sigmma", "relative_sigma"),
    ),
    "missing unit": (lambda f: edit(f, ', unit = "rad/s"', ""), ("campaign.toml", "rate", "unit")),
    "missing column": (lambda f: edit(f, '"wx_radps"', '"omega_x"'), ("omega_x",)),
    "missing file": (lambda f: edit(f, "slew_03.csv", "slew_33.csv"), ("slew_33.csv",)),
    "path leaves the folder": (
        lambda f: edit(f, "slew_03.csv", "../slew_03.csv"),
        ("../slew_03.csv",),
    ),
    "unphysical prior": (
        lambda f: edit(f, "3.235722782", "6.235722782"),
        ("inertia.tensor", "principal moments"),
    ),
    "sigma not positive": (
        lambda f: edit(f, "sigma = 2e-05", "sigma = 0.0"),
        ("rate_sensor.sigma",),
    ),
    "time is not a number": (
        lambda f: edit(f, "\n0.5,", "\n,", "slew_01.csv"),
        ("slew_01.csv", "line 4"),
    ),
    "times not sorted": (
        lambda f: edit(f, "\n0.5,", "\n0.25,", "slew_01.csv"),
        ("slew_01.csv", "line 4"),
    ),
}


@pytest.mark.parametrize("spoil", BAD)
@pytest.mark.parametrize("command", ["check", "fit"])
def test_bad_input_ends_with_2_and_one_message_that_says_where(
    campaign, tmp_path, capsys, spoil, command
):
    change, words = BAD[spoil]
    change(campaign)
    out = tmp_path / "run"
    assert run(command, campaign, *(["-o", out] if command == "fit" else [])) == 2
    message = capsys.readouterr().err
    assert message.startswith("error: ")
    assert message.count("\n") == 1
    assert all(word in message for word in words), message
    assert not out.exists()


def test_what_a_file_writes_into_a_message_stays_one_short_line(campaign, capsys):
    edit(campaign, 'name = "', f'name = "{"x" * 9000}')
    edit(campaign, "slew_03.csv", "slew\\u001b[31m\\u2028.csv")
    assert run("check", campaign) == 2
    message = capsys.readouterr().err
    assert message.splitlines() == [message.removesuffix("\n")]
    assert "\x1b" not in message
    assert len(message) < 4500


def test_unknown_effects_name_the_nearest(campaign, tmp_path, capsys):
    assert run("fit", campaign, "-o", tmp_path / "run", "--effects", "wheel_comand_lag") == 2
    assert "wheel_command_lag" in capsys.readouterr().err
    assert not (tmp_path / "run").exists()


def test_a_run_of_other_data_is_not_overwritten(campaign, tmp_path, capsys):
    from bayes_inertia.app import run_folder as runs

    out = tmp_path / "run"
    runs.start(campaign, out)
    before = contents(out)
    runs.start(campaign, out)  # the same run may go on
    edit(campaign, "relative_sigma = 0.04", "relative_sigma = 0.05")
    assert run("fit", campaign, "-o", out) == 2
    assert "other data" in capsys.readouterr().err
    assert run("fit", EXAMPLE, "-o", out, "--seed", "5") == 2
    assert "settings" in capsys.readouterr().err
    assert contents(out) == before


def test_files_that_a_run_would_overwrite_stop_it(campaign, tmp_path, capsys):
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "summary.json").write_text("mine")
    assert run("fit", campaign, "-o", tmp_path / "run") == 2
    assert (tmp_path / "run" / "summary.json").read_text() == "mine"


def test_a_run_that_cannot_be_leaves_nothing_in_the_way_of_the_corrected_one(
    campaign, tmp_path, capsys
):
    out = tmp_path / "run"
    edit(campaign, "magnetic_field = {", "# magnetic_field = {")
    assert run("fit", campaign, "-o", out, "--effects", "magnetic_dipole") == 2
    assert "magnetic_field" in capsys.readouterr().err
    assert not out.exists()


def test_a_copy_of_the_campaign_that_was_killed_is_completed_and_other_files_are_kept(
    campaign, tmp_path, capsys
):
    from bayes_inertia.app import run_folder as runs

    out = tmp_path / "run"
    runs.start(campaign, out)
    (out / "run.json").unlink()
    (out / "campaign" / "slew_02.csv").unlink()
    runs.start(campaign, out)
    assert (out / "campaign" / "slew_02.csv").read_bytes() == (
        campaign / "slew_02.csv"
    ).read_bytes()
    (out / "run.json").unlink()
    (out / "campaign" / "slew_02.csv").write_text("mine")
    assert run("fit", campaign, "-o", out) == 2
    assert "slew_02.csv: would overwrite" in capsys.readouterr().err
    assert (out / "campaign" / "slew_02.csv").read_text() == "mine"


@pytest.mark.parametrize("command", ["fit", "diagnose", "observe", "design"])
def test_an_output_folder_that_cannot_be_made_is_refused_before_anything_is_computed(
    campaign, tmp_path, capsys, command
):
    (tmp_path / "file").write_text("mine")
    assert run(command, campaign, "-o", tmp_path / "file" / "run") == 2
    assert "is a file, not a folder" in capsys.readouterr().err


def test_resume_and_report_want_a_run(tmp_path, capsys):
    assert run("resume", tmp_path) == 2
    assert "run.json" in capsys.readouterr().err
    assert run("report", tmp_path) == 2
    assert "posterior.nc" in capsys.readouterr().err


@pytest.mark.slow
def test_fit_of_the_example_is_trusted_and_right(tmp_path, capsys):
    """Telemetry of an independent simulator: truth within 3.5 sd, gates, files, units."""
    out = tmp_path / "run"
    assert run("fit", EXAMPLE, "-o", out, "--seed", "1") == 0
    summary = json.loads((out / "summary.json").read_text())
    truth = json.loads((EXAMPLE / "truth.json").read_text())
    J, K = truth["J_kgm2"], truth["K"]
    true = dict(
        zip(
            ("Jxx", "Jyy", "Jzz", "Jxy", "Jxz", "Jyz"),
            (J[0][0], J[1][1], J[2][2], J[0][1], J[0][2], J[1][2]),
            strict=True,
        )
    )
    true |= {f"K{i + 1}": k for i, k in enumerate(K)}
    for name, value in true.items():
        row = summary["parameters"][name]
        assert abs(row["mean"] - value) < 3.5 * row["sd"], name
        assert row["q05"] < row["q50"] < row["q95"]
        assert row["observable"]
    found, fit = summary["diagnostics"], summary["fit"]
    assert found["converged"]
    assert found["ess_per_evaluation"] >= 0.5
    assert min(found["ess_bulk_min"], found["ess_tail_min"]) >= 5_000
    assert all(
        fit["interval_99"][c][0] < fit["reduced_chi2"][c] < fit["interval_99"][c][1]
        for c in ("rate", "attitude", "momentum")
    )
    tree = Posterior.load(out / "posterior.nc").tree
    assert tree["posterior"]["Jxx"].attrs["units"] == "kg m^2"
    for group in (
        "posterior",
        "prior",
        "sample_stats",
        "observed_data",
        "posterior_predictive",
        "log_likelihood",
        "log_likelihood_reading",
    ):
        assert group in tree.children
    assert (out / "report.html").stat().st_size > 100_000
    first = contents(out)
    assert run("fit", EXAMPLE, "-o", out, "--seed", "1") == 0  # the same run again changes no chain
    again = contents(out)
    assert all(again[name] == data for name, data in first.items() if name.startswith("chains/"))


def test_open_shows_the_page_in_a_browser_with_windows_and_is_silent_without(
    tmp_path, monkeypatch, capsys
):
    class Windows(webbrowser.BackgroundBrowser):
        def open(self, url, *_):
            opened.append(url)

    opened, page = [], tmp_path / "report.html"
    monkeypatch.delenv("BROWSER", raising=False)
    monkeypatch.setattr(webbrowser, "get", lambda: Windows("windows"))
    open_in_browser(page, True)
    page.write_text("<p>page</p>")
    open_in_browser(page, False)
    assert opened == []
    open_in_browser(page, True)
    assert opened == [page.as_uri()]

    def none():
        raise webbrowser.Error("could not locate runnable browser")

    for get in (none, lambda: webbrowser.GenericBrowser("no-such-browser-of-text")):
        monkeypatch.setattr(webbrowser, "get", get)
        open_in_browser(page, True)
    assert capsys.readouterr() == ("", "")
