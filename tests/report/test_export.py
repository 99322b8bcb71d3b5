"""Exports: read back as the tool that they are for reads them; untrusted results say so."""

from __future__ import annotations

import ast
import csv
import json
import re
import runpy
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import bayes_inertia as bi
from bayes_inertia.app import export_run, run_folder
from bayes_inertia.app.cli import main
from bayes_inertia.app.export_run import exported_result, forecast_of
from bayes_inertia.app.options import FormatName
from bayes_inertia.campaign.prior import prior_in
from bayes_inertia.campaign.reader import read_campaign
from bayes_inertia.inference.posterior import Posterior
from bayes_inertia.maths.inertia_tensor import ELEMENTS
from bayes_inertia.maths.tensor_elements import COLUMNS_OF_ELEMENTS, ROWS_OF_ELEMENTS
from bayes_inertia.report.export.formats import EXPORT_FORMATS, ExportedCorrection, csv_text
from bayes_inertia.report.page import render

EXAMPLE = Path(bi.__file__).parent / "example"
RUNS = 1000
# As far as the largest of 27 moments comes by chance in one test of a thousand.
MOST_ERRORS = 4.2
# J and K known before flight; the made-up posteriors say K = 1.01, 1.02, 0.98.
OLD = np.array([3.3, 2.2, 1.8, -0.012, 0.0026, 0.016, 1.0, 1.0, 0.99])


def body(text: str) -> list[str]:
    """Lines of an export, but for when it was made."""
    return [line for line in text.splitlines() if not re.search("DATE|TZERO = ", line)]


def export(*arguments) -> int:
    with pytest.raises(SystemExit) as stop:
        main(["export", *map(str, arguments)])
    return stop.value.code


@pytest.fixture(scope="module")
def run_of(posteriors, tmp_path_factory):
    """Folder of a run of the example with a made-up posterior of this kind."""

    def make(kind: str) -> Path:
        folder = tmp_path_factory.mktemp("runs") / kind
        run_folder.start(EXAMPLE, folder)
        tree = posteriors[kind].tree.copy(deep=True)
        tree["estimate"]["prior_mean"][:9] = OLD
        Posterior(tree).save(folder / "posterior.nc")
        return folder

    return make


@pytest.fixture(scope="module")
def run(run_of):
    return run_of("good")


@pytest.fixture(scope="module")
def result(run):
    """With a forecast that is made up."""
    forecast = ExportedCorrection("z", (0.0105, 0.0107), (1e-4, 2e-4), "no noise")
    return replace(exported_result(run, with_correction=False), correction=forecast)


@pytest.fixture(scope="module")
def hostile(result):
    """The result of a campaign whose name and effects want to end a comment or a string."""
    name = "a\nimport os  % ' \\end{tabular} \x1b[31m µ"
    rows = tuple(replace(p, name=f"{p.name}'&\n") for p in result.parameters[9:])
    return replace(result, campaign=name, parameters=result.parameters[:9] + rows)


@pytest.mark.slow
def test_both_tensors_differ_by_the_wheels_spin(result):
    wheels = read_campaign(EXAMPLE).wheels
    spin = sum(w.spin_inertia * np.outer(w.axis_B, w.axis_B) for w in wheels)
    assert np.allclose(result.inertia_locked_B - result.inertia_B, spin, rtol=0.0, atol=1e-15)
    assert result.inertia_B[0, 1] == result.parameter("Jxy").new


def test_old_is_what_the_prior_states(make_case, tmp_path):
    """No median of draws, whose Monte Carlo error would be a change."""
    posterior = make_case(extra=("torquers.gain",))
    run_folder.start(EXAMPLE, tmp_path / "run")
    posterior.save(tmp_path / "run" / "posterior.nc")
    result = exported_result(tmp_path / "run", with_correction=False)
    stated = posterior.tree["estimate"]["prior_mean"].values
    assert result.parameters[9].name == "torquers.gain"
    assert [p.old for p in result.parameters] == stated.tolist()


def test_the_command_knows_the_formats_of_the_table():
    assert set(FormatName.__args__) == set(EXPORT_FORMATS)


def test_an_inertia_block_is_read_by_a_library_for_ccsds_messages(result):
    ccsds_ndm = pytest.importorskip("ccsds_ndm")
    head = (
        "CCSDS_APM_VERS = 2.0\nCREATION_DATE = 2026-01-01T00:00:00\nORIGINATOR = US\n\n"
        "OBJECT_NAME = MOST\nOBJECT_ID = 2003-031B\nTIME_SYSTEM = UTC\n\n"
        "EPOCH = 2026-01-01T00:00:00\n\nQUAT_START\nREF_FRAME_A = SC_BODY_1\n"
        "REF_FRAME_B = ICRF\nQ1 = 0.0\nQ2 = 0.0\nQ3 = 0.0\nQC = 1.0\nQUAT_STOP\n\n"
    )
    message = ccsds_ndm.Apm.from_str(head + EXPORT_FORMATS["apm"].text(result))
    block = message.segment.data.inertia[0]
    J = [[block.ixx, block.ixy, block.ixz], [0, block.iyy, block.iyz], [0, 0, block.izz]]
    smallest = min(p.sd for p in result.parameters[:6])
    gap = np.triu(result.inertia_locked_B) - np.array(J)
    assert np.abs(gap).max() < 1e-3 * smallest
    assert any("-integral of x y dm" in line for line in block.comment)


def test_a_comprehensive_message_is_read_by_a_library_for_ccsds_messages(result):
    ccsds_ndm = pytest.importorskip("ccsds_ndm")
    message = ccsds_ndm.Acm.from_str(EXPORT_FORMATS["acm"].text(result))
    message.validate()
    data = message.segment.data
    block = data.phys
    J = [[block.ixx, block.ixy, block.ixz], [0, block.iyy, block.iyz], [0, 0, block.izz]]
    smallest = min(p.sd for p in result.parameters[:6])
    assert np.abs(np.triu(result.inertia_locked_B) - np.array(J)).max() < 1e-3 * smallest
    assert (block.inertia_ref_frame, message.segment.metadata.object_name) == (
        "SC_BODY_1",
        result.campaign,
    )


def test_scale_factors_and_covariance_are_user_defined_entries(result):
    text = EXPORT_FORMATS["acm"].text(result)
    entries = dict(
        line.removeprefix("USER_DEFINED_").split(" = ")
        for line in text.splitlines()
        if line.startswith("USER_DEFINED_")
    )
    for k in (1, 2, 3):
        factor = result.parameter(f"K{k}")
        assert abs(float(entries[f"K{k}"]) - factor.new) < 1e-3 * factor.sd
    names = ["IXX", "IYY", "IZZ", "IXY", "IXZ", "IYZ", "K1", "K2", "K3"]
    for i, a in enumerate(names):
        for j, b in enumerate(names[: i + 1]):
            told = float(entries[f"COV_{a}_{b}"])
            assert told == pytest.approx(result.covariance[i, j], rel=1e-7)
    assert len(entries) == 3 + 45


def test_python_lines_set_the_hub_of_basilisk(result):
    craft = SimpleNamespace(hub=SimpleNamespace())
    names = {"scObject": craft}
    exec(EXPORT_FORMATS["basilisk"].text(result), names)
    assert np.allclose(craft.hub.IHubPntBc_B, result.inertia_locked_B, rtol=0.0, atol=1e-6)
    assert np.allclose(names["rate_sensor_K"], [result.parameter(f"K{i}").new for i in (1, 2, 3)])


def test_a_thousand_runs_of_basilisk_have_the_moments_of_the_posterior(run, result):
    example = runpy.run_path(str(EXAMPLE.parents[1] / "docs/how_to/basilisk_dispersion.py"))
    dispersion = example["PosteriorDispersion"](example["hub_tensors"](run))
    assert dispersion.getName().endswith("hub.IHubPntBc_B")
    state = np.random.get_state()
    flown = []
    for index in range(RUNS):
        # As Basilisk's controller does before each run.
        np.random.seed(10 * index)
        flown.append(ast.literal_eval(dispersion.generateString(None)))
    np.random.set_state(state)
    J = np.array(flown)
    low, middle, high = np.linalg.eigvalsh(J).T
    assert (low > 0.0).all()
    assert (low + middle > high).all()
    np.testing.assert_array_equal(J, np.swapaxes(J, 1, 2))
    elements = J[:, [0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
    covariance = result.covariance[:6, :6]
    sd = np.sqrt(np.diag(covariance))
    expected = result.inertia_locked_B[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
    off = (elements.mean(0) - expected) / sd
    assert np.abs(off).max() < MOST_ERRORS / np.sqrt(RUNS)
    # The Monte Carlo error of c_ij is sqrt((c_ii c_jj + c_ij^2) / n).
    error = np.sqrt((np.outer(sd, sd) ** 2 + covariance**2) / RUNS)
    assert np.abs((np.cov(elements, rowvar=False) - covariance) / error).max() < MOST_ERRORS


def test_a_dispersion_of_a_result_that_is_not_trusted_is_refused(run_of):
    example = runpy.run_path(str(EXAMPLE.parents[1] / "docs/how_to/basilisk_dispersion.py"))
    with pytest.raises(SystemExit, match="the result is not trusted"):
        example["hub_tensors"](run_of("thrown"))


def test_42_reads_the_tensor_back_with_its_own_signs(result):
    lines = [x for x in EXPORT_FORMATS["42"].text(result).splitlines() if x[0] != "!"]
    numbers = [[float(x) for x in line.split("!")[0].split()] for line in lines]
    J = np.diag(numbers[0])
    # As in 42init.c: products are negated when they are read.
    J[0, 1], J[0, 2], J[1, 2] = (-x for x in numbers[1])
    assert np.allclose(J, np.triu(result.inertia_B), rtol=0.0, atol=1e-6)
    scale = 1.0 + 1e-6 * np.array(numbers[2:]).ravel()
    K = [result.parameter(f"K{i}").new for i in (1, 2, 3)]
    assert np.allclose(scale * K, 1.0, rtol=0.0, atol=1e-7)


def test_the_sheet_shows_old_new_and_the_correction_slew(result):
    text = EXPORT_FORMATS["csv"].text(result)
    rows = list(csv.DictReader(x for x in text.splitlines() if x[0] != "#"))
    by_name = {row["parameter"]: row for row in rows}
    p = result.parameter("K1")
    assert by_name["K1"]["old"] == "1.00000"
    assert abs(float(by_name["K1"]["new"]) - p.new) <= 0.05 * p.sd
    assert float(by_name["K1"]["change_in_old_sd"]) == pytest.approx(p.change / p.old_sd, abs=0.01)
    assert by_name["correction_slew_z_median"]["old"] == "2.17e+03"
    assert by_name["correction_slew_z_q95"]["new"] == "41.3"


@pytest.mark.long
@pytest.mark.slow
def test_the_correction_slew_is_that_of_the_scale_factors_errors(run):
    """60 degrees with a scale factor that is wrong by 1 %, then by a draw's sd of 1e-4."""
    forecast = exported_result(run, with_correction=True).correction
    assert forecast.axis == "y"
    assert forecast.before[0] == pytest.approx(np.radians(60.0) * 0.02, rel=0.1)
    assert 0.0 < forecast.after[0] < np.radians(60.0) * 3e-4


def test_a_json_document_holds_all_digits(result):
    content = json.loads(EXPORT_FORMATS["json"].text(result))
    assert content["J_kgm2"] == result.inertia_B.tolist()
    assert content["parameters"]["Jxx"]["new"] == result.parameter("Jxx").new
    assert content["correction_slew_rad"]["before"][0] == result.correction.before[0]
    # The covariance is that of the sds that are quoted beside it.
    sds = [parameter.sd for parameter in result.parameters]
    np.testing.assert_allclose(np.sqrt(np.diag(content["covariance"])), sds, rtol=1e-12)


def test_a_matlab_script_holds_all_digits(result):
    text = EXPORT_FORMATS["matlab"].text(result)
    new = re.search(r"bayes_inertia\.new = \[(.*)\];", text).group(1)
    assert [float(x) for x in new.split()] == [p.new for p in result.parameters]


def test_a_table_in_latex_rounds_to_the_uncertainty(result):
    text = EXPORT_FORMATS["latex"].text(result)
    p = result.parameter("Jxx")
    decimals = 1 - int(np.floor(np.log10(p.sd)))
    assert f"${p.new:.{decimals}f} \\pm {p.sd:.{decimals}f}$" in text


@pytest.mark.parametrize("to", EXPORT_FORMATS)
def test_no_name_ends_a_comment_or_a_string(hostile, result, to):
    text = EXPORT_FORMATS[to].text(hostile)
    assert "\x1b" not in text
    assert text.isascii()
    if to == "json":
        assert json.loads(text)["campaign"] == hostile.campaign
        return
    assert len(text.splitlines()) == len(EXPORT_FORMATS[to].text(result).splitlines())
    assert not any(line.lstrip().startswith("import") for line in text.splitlines())


@pytest.mark.parametrize("axes", [0, 2, 4])
@pytest.mark.parametrize("to", EXPORT_FORMATS)
def test_every_format_takes_any_number_of_gyro_axes(result, to, axes):
    K = [replace(result.scale_factors[0], name=f"K{i + 1}") for i in range(axes)]
    rows = (*result.parameters[:6], *K)
    few = replace(result, parameters=rows, covariance=np.eye(len(rows)), correction=None)
    text = EXPORT_FORMATS[to].text(few)
    assert text.count("Gyro Axis") == (axes if to == "42" else 0)
    assert not re.search(rf"\bK{axes + 1}\b", text)


@pytest.mark.parametrize("to", EXPORT_FORMATS)
def test_no_format_speaks_of_wheels_where_there_are_none(result, to):
    text = EXPORT_FORMATS[to].text(replace(result, wheels=False))
    assert "wheel" not in text.replace("includes_wheel_spin", "")


@pytest.mark.slow
def test_where_nothing_ties_the_size_of_the_tensor_its_ratios_are_exported(run, tmp_path):
    folder = tmp_path / "free"
    run_folder.start(EXAMPLE, folder)
    tree = Posterior.load(run / "posterior.nc").tree.copy(deep=True)
    attributes = json.loads(tree.attrs["bayes_inertia"]) | {"scale_of_J": []}
    tree.attrs["bayes_inertia"] = json.dumps(attributes)
    Posterior(tree).save(folder / "posterior.nc")
    free, tied = (exported_result(f, with_correction=False) for f in (folder, run))
    ratios = Posterior.load(folder / "posterior.nc").summary()["ratios"]
    trace = sum(p.new for p in free.parameters[:3])
    for p in free.parameters[:6]:
        assert p.sd / trace == pytest.approx(ratios[f"{p.name}/trace"]["quoted_sd"])
        assert p.determined == "only its ratio"
    assert np.sqrt(np.diag(free.covariance)) == pytest.approx([p.sd for p in free.parameters])
    # The trace itself is not in doubt here.
    of_trace = [x.covariance[:3, :3].sum() / tied.covariance[:3, :3].sum() for x in (free, tied)]
    assert of_trace == pytest.approx([0.0, 1.0], abs=0.1)
    assert "nothing ties the size of J" in free.notes[0]


@pytest.mark.parametrize("to", ["acm", "apm", "json", "csv", "matlab", "latex", "basilisk", "42"])
def test_an_untrusted_result_carries_its_warning(result, to):
    refused = replace(result, trusted=False, reasons=("the ensembles disagree",))
    text = EXPORT_FORMATS[to].text(refused)
    assert "WARNING: DO NOT USE THIS RESULT AS IT STANDS: the ensembles disagree" in text
    assert "DO NOT USE" not in EXPORT_FORMATS[to].text(result)


@pytest.mark.slow
@pytest.mark.parametrize("change", ["inertia_change", pytest.param("fuel", marks=pytest.mark.long)])
def test_a_tensor_that_changed_on_the_way_is_said(change, make_case, tmp_path):
    """By an effect, or by a change that the campaign dates."""
    posterior = make_case(extra=tuple(f"{change}.change_{name}" for name in ELEMENTS))
    run_folder.start(EXAMPLE, tmp_path / "run")
    posterior.save(tmp_path / "run" / "posterior.nc")
    result = exported_result(tmp_path / "run", with_correction=False)
    for form in EXPORT_FORMATS.values():
        assert f"now it is J + {change}.change_Jxx" in form.text(result)
    shown = f"add {change.replace('_', ' ')}, element by element"
    assert shown in render(posterior)


def test_the_next_slew_is_flown_with_the_tensor_after_its_change(make_case, monkeypatch):
    posterior = make_case(extra=tuple(f"fuel.change_{name}" for name in ELEMENTS))
    seen = []
    monkeypatch.setattr(export_run, "correction_with_update", lambda *given: seen.append(given[1:]))
    forecast_of(posterior, None)
    draws, old, new = seen[0]
    rows, at = posterior.summary()["parameters"], posterior.names.index
    for i, name in enumerate(ELEMENTS):
        change = f"fuel.change_{name}"
        assert new[i] == pytest.approx(rows[name]["mean"] + rows[change]["mean"], rel=1e-12)
        assert draws[0, i] == posterior.samples[0, at(name)] + posterior.samples[0, at(change)]
    assert list(old) == posterior.tree["estimate"]["prior_mean"].values[:9].tolist()


@pytest.fixture
def with_attributes(run):
    """The posterior of the run; what it says of itself is added to."""

    def made(**more) -> Posterior:
        tree = Posterior.load(run / "posterior.nc").tree
        attributes = json.loads(tree.attrs["bayes_inertia"]) | more
        tree.attrs["bayes_inertia"] = json.dumps(attributes)
        return Posterior(tree)

    return made


@pytest.mark.parametrize("to", ["acm", "apm", "42", "matlab"])
def test_a_fit_is_exported_as_its_run_is(with_attributes, run, tmp_path, to):
    campaign = read_campaign(EXAMPLE)
    states_spin = with_attributes(wheel_spin_kgm2=campaign.wheel_spin.tolist())
    bi.export(run, tmp_path / "run", to)
    bi.export(with_attributes(), tmp_path / "campaign", to, campaign=campaign)
    assert bi.export(states_spin, str(tmp_path / "fit"), to) == tmp_path / "fit"
    bi.export(states_spin.save(tmp_path / "fit.nc"), tmp_path / "file", to)
    told = [body((tmp_path / name).read_text()) for name in ("run", "campaign", "fit", "file")]
    assert told[0] == told[1] == told[2] == told[3]
    assert len(told[0]) > 5


def test_what_cannot_be_exported_is_said(with_attributes, run_of, tmp_path):
    fit, campaign = with_attributes(), read_campaign(EXAMPLE)
    other = with_attributes(slew_digests={"own": campaign.subset([0]).slew_digests["own"]})
    elsewhere = run_of("good")
    other.save(elsewhere / "posterior.nc")
    for result, to, more, says in (
        (fit, "xml", {}, "to: no format 'xml'; choose one of json, csv, acm"),
        (fit, "acm", {}, "campaign: a fit of an older version does not state the wheels' spin"),
        (fit, "acm", {"campaign": "c"}, "campaign: a str is no Campaign"),
        (other, "acm", {"campaign": campaign}, "campaign: its slews are not those of the fit"),
        (elsewhere, "acm", {"campaign": campaign}, "campaign: its slews are not those of the fit"),
        (elsewhere, "acm", {"campaign": "c"}, "campaign: a str is no Campaign"),
        (tmp_path, "acm", {}, "no run here"),
        (run_of("thrown"), "acm", {}, "result: do not use this result as it stands"),
    ):
        with pytest.raises(bi.BayesInertiaError, match=says):
            bi.export(result, tmp_path / "out", to, **more)
    assert not (tmp_path / "out").exists()
    bi.export(run_of("thrown"), tmp_path / "out", "acm", even_untrusted=True)
    assert "WARNING: DO NOT USE" in (tmp_path / "out").read_text()


@pytest.mark.parametrize("to", ["acm", "json"])
def test_an_exported_result_is_a_prior(result, tmp_path, to):
    file = tmp_path / "result"
    file.write_text(EXPORT_FORMATS[to].text(result))
    prior, n = prior_in(file), 9
    assert prior.names == tuple(p.name for p in result.parameters[:n])
    assert prior.includes_wheel_spin is (True if to == "acm" else result.includes_wheel_spin)
    J = result.inertia_locked_B if prior.includes_wheel_spin else result.inertia_B
    rounding = 0.01 * prior.sd
    elements = J[ROWS_OF_ELEMENTS, COLUMNS_OF_ELEMENTS].tolist()
    known = np.array(elements + [p.new for p in result.scale_factors])
    assert np.all(np.abs(prior.mean - known) < rounding)
    np.testing.assert_allclose(prior.covariance, result.covariance[:n, :n], rtol=1e-7)


@pytest.mark.parametrize("to", ["acm", "json"])
def test_an_exported_result_is_no_prior_of_the_slews_that_it_was_learnt_from(
    with_attributes, tmp_path, to
):
    campaign = read_campaign(EXAMPLE)
    fitted = with_attributes(slew_digests=campaign.slew_digests)
    prior = prior_in(bi.export(fitted, tmp_path / "result", to, campaign=campaign))
    assert list(prior.learnt_from) == campaign.slew_digests["own"]
    with pytest.raises(bi.CampaignError, match="count twice"):
        replace(campaign, prior=prior)


@pytest.mark.parametrize("to", ["acm", "json"])
@pytest.mark.parametrize("caution", [{"notes": ("only ratios are found",)}, {"trusted": False}])
def test_an_exported_result_with_a_caution_is_no_prior(result, tmp_path, to, caution):
    file = tmp_path / "result"
    reasons = () if "notes" in caution else ("a gate failed",)
    file.write_text(EXPORT_FORMATS[to].text(replace(result, **caution, reasons=reasons)))
    with pytest.raises(bi.CampaignError, match=r"the result is no prior: .*(only ratios|a gate)"):
        prior_in(file)


@pytest.mark.parametrize(
    ("line", "instead", "says"),
    [
        ("^USER_DEFINED_COV_IYY_IXX = .*", "", "it states no COV_IYY_IXX; give names, mean"),
        ("^USER_DEFINED_K1 = .*", "", "it states no K1; give"),
        ("^IXX = .*", "", "it states no IXX; give"),
        ("^IXX = .*", "IXX = 2852741.7 [g*m**2]", r"IXX: the unit is 'g\*m\*\*2'; give kg"),
        ("^IXX = .*", "IXX = nan [kg*m**2]", "IXX: 'nan' is no number"),
        ("^IYY = .*", "IXX = 2852.7 [kg*m**2]", "IXX is given twice; remove one line"),
        ("SC_BODY_1", "EME2000", "INERTIA_REF_FRAME = EME2000; give the inertia in body axes"),
        ("(?s).*", "INERTIA_START", "holds no prior; give the folder"),
    ],
)
def test_what_a_message_does_not_say_is_no_prior(result, tmp_path, line, instead, says):
    file = tmp_path / "result.acm"
    message = EXPORT_FORMATS["acm"].text(result)
    file.write_text(re.sub(line, instead, message, count=1, flags=re.MULTILINE))
    with pytest.raises(bi.CampaignError, match=says):
        prior_in(file)


def test_ratios_alone_have_no_change_in_sds(result):
    """Against the sd of a ratio a change of the size that nobody saw would be thousands of sds."""
    row = replace(result.parameters[0], determined="only its ratio")
    alone = replace(
        result, parameters=(row, *result.parameters[1:]), notes=("only ratios & so on",)
    )
    table = [line for line in csv_text(alone).splitlines() if not line.startswith("#")]
    rows = {row["parameter"]: row for row in csv.DictReader(table)}
    assert rows["Jxx"]["change_in_new_sd"] == ""
    assert rows["Jyy"]["change_in_new_sd"] != ""
    assert "the quoted one" not in csv_text(alone)
    assert r"Note: only ratios \& so on." in EXPORT_FORMATS["latex"].text(alone)


def test_a_message_names_spacecraft_and_operator(with_attributes, tmp_path):
    stated = {"name": "M", "spacecraft": "MOST-1", "operator": "UTIAS"}
    campaign = replace(read_campaign(EXAMPLE), mission=stated)
    fitted = with_attributes(slew_digests=campaign.slew_digests)
    text = bi.export(fitted, tmp_path / "a", "acm", campaign=campaign).read_text()
    assert "\nOBJECT_NAME = MOST-1\n" in text
    assert "\nORIGINATOR = UTIAS\n" in text
    # Without files of its own, the slews are what was fitted.
    assert re.search(r"slews sha256 [0-9a-f]{16}", text)


def test_a_message_has_the_date_of_the_first_slew(with_attributes, tmp_path):
    """An epoch of a campaign is when its clock was zero; without any, the message says so."""
    campaign = read_campaign(EXAMPLE)
    late = [replace(slew, start=slew.start + 90.25) for slew in campaign.slews]
    dated = replace(campaign, slews=late, mission={"epoch": "2026-03-02T12:00:00Z"})
    assert dated.begin_utc == "2026-03-02T12:01:30.250"
    at = {"wheel_spin_kgm2": campaign.wheel_spin.tolist()}
    of_fit = bi.export(with_attributes(**at, begin_utc=dated.begin_utc), tmp_path / "fit", "acm")
    of_both = bi.export(with_attributes(), tmp_path / "both", "acm", campaign=dated)
    for path in (of_fit, of_both):
        assert "\nEPOCH_TZERO = 2026-03-02T12:01:30.250\n" in path.read_text()
        assert "COMMENT EPOCH_TZERO is when the first slew began" in path.read_text()
    undated = bi.export(with_attributes(**at), tmp_path / "undated", "acm").read_text()
    assert "COMMENT EPOCH_TZERO is when this message was made, as the campaign" in undated
    for wrong, says in (
        ("soon", "mission.epoch: 'soon' is no date"),
        ("1601-01-01", "mission.epoch: a date is before 1678 or after 2261; give UTC"),
        (5, "an int is no str"),
    ):
        with pytest.raises(bi.CampaignError, match=says):
            replace(campaign, mission={"epoch": wrong})


@pytest.mark.slow
def test_the_command_writes_a_file_and_overwrites_none(run, tmp_path, capsys):
    out = tmp_path / "sub" / "inertia.txt"
    assert export(run, "--to", "42", "-o", out) == 0
    assert export(run, "--to", "42", "-o", out) == 0
    printed = capsys.readouterr()
    assert printed.out == ""
    assert str(out) in printed.err
    assert export(run, "--to", "42") == 0
    assert capsys.readouterr().out == out.read_text()
    assert export(run, "--to", "apm", "-o", out) == 2
    assert "would overwrite" in capsys.readouterr().err


def test_the_command_refuses_an_untrusted_result_unless_told(run_of, tmp_path, capsys):
    refused, out = run_of("thrown"), tmp_path / "inertia.py"
    assert export(refused, "--to", "basilisk", "-o", out) == 3
    assert "--even-untrusted" in capsys.readouterr().err
    assert not out.exists()
    assert export(refused, "--to", "basilisk", "-o", out, "--even-untrusted") == 3
    assert out.read_text().startswith("# WARNING: DO NOT USE")


def test_a_folder_without_a_finished_run_is_reported(tmp_path, capsys):
    assert export(tmp_path, "--to", "csv") == 2
    assert "posterior.nc" in capsys.readouterr().err
