"""A mapping says everything that cannot be known, once, and nothing that the files contradict."""

from __future__ import annotations

import numpy as np
import pytest
from support.campaign_files import assert_teaches
from support.raw_logs import MAPPING, edited_mapping, log_columns, write_csv

from bayes_inertia.campaign.reader import read_campaign
from bayes_inertia.errors import CampaignError
from bayes_inertia.importing.import_logs import import_logs
from bayes_inertia.importing.mapped_lines import mapped_lines
from bayes_inertia.importing.mapping import parse_mapping, rate_sensor_axes
from bayes_inertia.importing.questions import QUESTIONS, open_questions

RATE = 'unit = "deg/s"\nframe = "body"\n'
FIXES = 'scalar = "last"\nmaps = "inertial_to_body"\nframe = "body"\n'
FLAT = "[[1.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]"
QUARTER = "[[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]"


def with_changes(*changes: tuple[str, str]) -> str:
    text = MAPPING
    for old, new in changes:
        assert old in text, old
        text = text.replace(old, new, 1)
    return text


def test_a_full_mapping_is_read():
    assert [stream.holds for stream in parse_mapping(MAPPING, "m.toml").streams] == [
        "rate",
        "wheel_torque",
        "attitude",
    ]


BAD = [
    ((RATE, 'uint = "deg/s"\nframe = "body"\n'), ["streams.rate.uint", 'did you mean "unit"?']),
    ((RATE, 'unit = "deg/s"\n'), ["streams.rate.frame", '"body" or "sensor"', "never guessed"]),
    (('acts_on = "wheel"\n', ""), ["streams.wheel_torque.acts_on", '"wheel" or "body"']),
    (('holds = "rate"', 'holds = "rates"'), ["streams.rates.holds", "'rates' is not one of"]),
    (('holds = "rate"\n', ""), ["streams[1 of 3].holds", "missing key"]),
    (('files = ["log*.csv"]\n', ""), ["streams.rate.files", "missing key"]),
    ((RATE, RATE.replace("body", "sensor") + f"body_from_sensor = {FLAT}\n"),
     ["rate.body_from_sensor", "in one plane"]),
    ((FIXES, f'{FIXES[:-7]}"tracker"\nbody_from_tracker = {FLAT}\n'),
     ["attitude.body_from_tracker", "no rotation"]),
    ((RATE, RATE + f"mounting = {QUARTER}\n"), ["rate.frame", "contradict"]),
    ((RATE, 'unit = "deg/s"\nframe = "sensor"\n'), ["streams.rate.mounting", "v_sensor"]),
    (('names = ["torque"]', 'names = ["torque", "v"]'), ["wheel_torque.names", "for 1 wheel"]),
    (('scalar = "last"', 'sequence = "zyx"'), ["attitude.sequence", "'euler'"]),
    (('form = "quaternion"', 'form = "dcm"'), ["attitude.scalar", "'quaternion'"]),
    (('frame = "body"\n\n[[streams]]\nholds = "wheel', 'frame = "sensor"\n\n[[streams]]\nholds = '
      '"wheel'), ["streams.rate.mounting"]),
    (('\n[star_tracker]\nboresight = [0.0, 0.0, 1.0]\nsigma_cross = 2e-5\nsigma_roll = 1e-4', ""),
     ["streams.attitude", "star_tracker"]),
    (('format = "bayes-inertia-mapping/1"', 'format = "bayes-inertia-campaign/1"'), ["format"]),
]  # fmt: skip


@pytest.mark.parametrize(("change", "named"), BAD, ids=[named[0] for _, named in BAD])
def test_a_bad_mapping_is_refused_by_its_key(change, named):
    with pytest.raises(CampaignError) as caught:
        parse_mapping(with_changes(change), "m.toml")
    assert_teaches(caught.value, named)


@pytest.mark.parametrize(
    ("old", "new", "key"),
    [
        ('unit = "deg/s"', 'unit = "?"', "streams.rate.unit"),
        ('maps = "inertial_to_body"', 'maps = "?"', "streams.attitude.maps"),
        ("axis = [1.0, 0.0, 0.0]", 'axis = ["?", 0.0, 0.0]', "wheels.x.axis"),
        ('kind = "ms", epoch = "campaign"', 'kind = "?"', "streams.rate.time.kind"),
    ],
)
def test_an_open_question_is_repeated(old, new, key):
    with pytest.raises(CampaignError) as caught:
        parse_mapping(with_changes((old, new)), "m.toml")
    parts = key.split(".")
    question = QUESTIONS.get(key) or QUESTIONS[".".join([parts[0], *parts[2:]])]
    assert_teaches(caught.value, [f"m.toml, key {key}", "the question is open", question])


def test_every_open_question_is_counted():
    assert open_questions({"a": "?", "b": [{"name": "n", "c": ["?", 1]}], "d": "what?"}) == [
        ("a",),
        ("b", "n", "c"),
    ]


def test_the_mounting_of_the_rate_sensor_is_read_in_either_direction():
    sensor = RATE.replace('"body"', '"sensor"')
    given = parse_mapping(with_changes((RATE, f"{sensor}mounting = {QUARTER}\n")), "m")
    back = "[[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]"
    other = parse_mapping(with_changes((RATE, f"{sensor}body_from_sensor = {back}\n")), "m")
    assert rate_sensor_axes(given) == [[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]
    np.testing.assert_allclose(rate_sensor_axes(other), rate_sensor_axes(given), atol=1e-15)


@pytest.fixture
def log(tmp_path):
    return write_csv(tmp_path / "log.csv", log_columns([(40.0, 30.0, 0.5)], 110.0))


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ([("axis = [1.0, 0.0, 0.0]", "axis = [1.0, 1.0, 0.0]")], ["mapping.toml", "x.axis"]),
        ([("sigma = 1e-4\n", "sigma = -1e-4\n")], ["rate_sensor.sigma", "positive"]),
        ([(RATE, RATE + 'valid = { name = "q4", equals = "a" }\n')], ["valid.equals", "no row"]),
        ([('kind = "ms", epoch = "campaign"', 'kind = "utc"')], ["streams.rate.time", "dates"]),
        ([('epoch = "campaign"', 'epoch = "today"')], ["streams.rate.time.epoch", "'today'"]),
        ([("[inertia]", "[cut]\nlongest_s = 60.0\n\n[inertia]")], ["cut.longest_s", '"gaps"']),
        ([("[inertia]", '[cut]\nby = "gaps"\nbefore_s = 9.0\n\n[inertia]')],
         ["cut.before_s", "gaps cut the log"]),
        ([("log*.csv", "gyro.csv")], ["streams.rate.files", "log.csv"]),
        ([('["wx", "wy", "wz"]', '["wx", "wy", "wq"]')], ["no column 'wq'", "The table has: t_ms"]),
        ([('unit = "deg/s"', 'unit = "N m"')], ["streams.rate.unit", "no unit of a rate"]),
        ([('unit = "deg/s"\n', "")], ["streams.rate.unit", "missing key", "0.017"]),
        ([('scalar = "last"\n', "")], ["streams.attitude.scalar", "missing key", "cosine"]),
        ([('maps = "inertial_to_body"\n', "")], ["streams.attitude.maps", "missing key"]),
        ([(', epoch = "campaign"', "")], ["streams.rate.time.epoch", "When was zero?"]),
        (
            [('kind = "ms", epoch = "campaign" }\nnames = ["torque"]',
              'kind = "ms", epoch = "2026-03-01T00:00:00Z" }\nnames = ["torque"]')],
            ["clocks cannot be brought together", "rate: a zero"],
        ),
    ],
)  # fmt: skip
def test_what_the_files_do_not_bear_out_is_refused(log, tmp_path, changes, named):
    mapping = edited_mapping(tmp_path, *changes)
    with pytest.raises(CampaignError) as caught:
        import_logs([log], mapping, tmp_path / "c")
    assert_teaches(caught.value, named)
    assert not (tmp_path / "c").exists()


def test_files_may_be_one_path_and_what_is_no_path_is_said(log, tmp_path):
    mapping = edited_mapping(tmp_path)
    assert import_logs(str(log), mapping, tmp_path / "one").logs.streams
    given = {"files": [log], "mapping": mapping, "folder": tmp_path / "c"}
    for key, wrong in (("files", None), ("files", [3]), ("mapping", {}), ("folder", None)):
        with pytest.raises(CampaignError, match=f"key {key}"):
            import_logs(**(given | {key: wrong}))


def test_a_unit_that_the_file_states_is_taken_and_must_not_be_contradicted(tmp_path, log):
    rows = log.read_text().splitlines()
    units = "ms,deg/s,deg/s,deg/s,mN m,-,-,-,-"
    log.write_text("\n".join([rows[0], units, *rows[1:]]) + "\n")
    taken = import_logs([log], edited_mapping(tmp_path, ('unit = "deg/s"\n', "")), tmp_path / "a")
    stated = import_logs([log], edited_mapping(tmp_path), tmp_path / "b")
    assert taken.logs.streams["rate"] == stated.logs.streams["rate"]
    wrong = edited_mapping(tmp_path, ('unit = "deg/s"', 'unit = "rad/s"'))
    with pytest.raises(CampaignError) as caught:
        import_logs([log], wrong, tmp_path / "c")
    assert_teaches(caught.value, ["streams.rate.unit", "'rad/s' contradicts", "states 'deg/s'"])


AEM = """\
CCSDS_AEM_VERS = 2.0
CREATION_DATE = 2026-03-02T00:00:00
ORIGINATOR = TEST

META_START
OBJECT_NAME = X
OBJECT_ID = 2026-001A
REF_FRAME_A = {a}
REF_FRAME_B = {b}
TIME_SYSTEM = UTC
START_TIME = 2026-03-01T00:00:00
STOP_TIME = 2026-03-01T00:03:00
ATTITUDE_TYPE = QUATERNION
META_STOP

DATA_START
{rows}
DATA_STOP
"""


def aem_import(tmp_path, log, a: str, b: str, keys: str):
    """Import with fixes from an AEM between two frames and some keys in the mapping."""
    stamps = [f"2026-03-01T00:{k // 60:02d}:{k % 60:02d}" for k in range(0, 110)]
    rows = "\n".join(f"{stamp} 0.0 0.0 0.6 0.8" for stamp in stamps)
    path = tmp_path / "fixes.aem"
    path.write_text(AEM.format(a=a, b=b, rows=rows))
    text = MAPPING.replace('"campaign"', '"2026-03-01T00:00:00Z"')
    head = text[: text.index('[[streams]]\nholds = "attitude"')]
    mapping = tmp_path / "mapping.toml"
    mapping.write_text(f'{head}[[streams]]\nholds = "attitude"\nfiles = ["*.aem"]\n{keys}')
    return import_logs([log, path], mapping, tmp_path / "c").logs.streams["attitude"]


def test_an_aem_needs_no_keys(tmp_path, log):
    fixes = aem_import(tmp_path, log, "EME2000", "SC_BODY_1", "")
    assert fixes.values[0].tolist() == [0.0, 0.0, 0.6, 0.8]


def test_an_aem_in_the_other_direction_is_turned_round(tmp_path, log):
    fixes = aem_import(tmp_path, log, "SC_BODY_1", "ICRF", "")
    assert fixes.values[0].tolist() == [0.0, 0.0, -0.6, 0.8]


@pytest.mark.parametrize(
    ("a", "b", "keys", "named"),
    [
        ("EME2000", "SC_BODY_1", 'scalar = "first"\n', ["attitude.scalar", "states 'last'"]),
        ("EME2000", "SC_BODY_1", 'maps = "body_to_inertial"\n', ["attitude.maps", "contradicts"]),
        ("EME2000", "STARTRACKER_1", "", ["attitude.body_from_tracker", "missing key"]),
        ("EME2000", "STARTRACKER_1", 'frame = "body"\n', ["attitude.frame", "states 'tracker'"]),
        ("LVLH", "SC_BODY_1", "", ["LVLH", "inertial"]),
    ],
)
def test_what_contradicts_an_aem_is_refused(tmp_path, log, a, b, keys, named):
    with pytest.raises(CampaignError) as caught:
        aem_import(tmp_path, log, a, b, keys)
    assert_teaches(caught.value, named)


def test_a_wheel_of_the_same_type_takes_what_it_does_not_say_itself():
    second = '[[wheels]]\nname = "w2"\naxis = [0.0, 1.0, 0.0]\nsame_as = "{}"\n\n[rate_sensor]'
    one = parse_mapping(MAPPING, "m.toml").wheels[0]
    two_columns = ('names = ["torque"]', 'names = ["torque", "torque_2"]')
    text = with_changes(two_columns, ("[rate_sensor]", second.format(one.name)))
    wheels = parse_mapping(text, "m.toml").wheels
    assert wheels[1].spin_inertia == one.spin_inertia
    assert wheels[1].axis == [0.0, 1.0, 0.0]
    with pytest.raises(CampaignError, match=r"wheels.w2.same_as: 'other' is no wheel above it"):
        parse_mapping(with_changes(two_columns, ("[rate_sensor]", second.format("other"))), "m")


def test_hardware_is_stated_in_the_units_of_its_data_sheet():
    text = with_changes(
        ("sigma_cross = 2e-5", 'sigma_cross = "5 arcsec"'),
        ("sigma = 1e-4", 'sigma = ["3 arcsec/s", "2e-3 deg/s", 1e-4]\nbias_sigma = "2 deg/h"'),
        ("momentum_sigma = 5e-6", 'momentum_sigma = "5 uNms"\nmax_torque = "20 mN m"'),
    )
    mapping, arcsec = parse_mapping(text, "m.toml"), np.pi / 648_000.0
    assert mapping.star_tracker.sigma_cross == pytest.approx(5.0 * arcsec)
    assert mapping.star_tracker.sigma_roll == 1e-4
    assert mapping.rate_sensor.sigma == pytest.approx([3.0 * arcsec, 7.2 * arcsec, 1e-4])
    assert mapping.rate_sensor.bias_sigma == pytest.approx([2.0 * arcsec] * 3)
    assert mapping.wheels[0].momentum_sigma == pytest.approx(5e-6)
    assert mapping.wheels[0].max_torque == pytest.approx(0.02)


def test_a_minus_before_a_column_gives_it_the_other_sign(tmp_path):
    write_csv(tmp_path / "log.csv", log_columns([(60.0, 40.0, 1.0), (200.0, 40.0, -0.7)], 320.0))
    signed = with_changes(('["wx",', '["-wx",'), ('"q2",', '"-q2",'))
    signed = signed.replace('unit = "mN m"', 'unit = "mN m"\noffset = 0.5').replace('["t', '["-t')
    first = []
    for text, name in ((MAPPING, "right"), (signed.replace('["-t_', '["t_'), "signed")):
        (tmp_path / "m.toml").write_text(text)
        folder = import_logs([tmp_path / "log.csv"], tmp_path / "m.toml", tmp_path / name).folder
        first.append(read_campaign(folder).slews[0])
    right, other = first
    np.testing.assert_allclose(other.rate, right.rate * [-1.0, 1.0, 1.0], atol=1e-12)
    np.testing.assert_allclose(other.wheel_torque, -(right.wheel_torque + 5e-4), atol=1e-12)
    fixes = np.isfinite(right.attitude).all(axis=1)
    turned = right.attitude[fixes] * [1.0, -1.0, 1.0, 1.0]
    same = np.abs((other.attitude[fixes] * turned).sum(axis=1))
    np.testing.assert_allclose(same, 1.0, atol=1e-9)
    with pytest.raises(CampaignError, match="is named twice"):
        parse_mapping(with_changes(('["wx", "wy"', '["-wy", "wy"')), "m.toml")


@pytest.mark.parametrize(
    ("value", "says"),
    [
        ('"five arcsec"', "no number with a unit"),
        ('"5"', "no unit is given"),
        ('"5 m"', "no unit of an angle"),
        ('"5 arcsec/s"', "rad, deg, arcmin or arcsec"),
        ("true", "star_tracker.sigma_cross"),
    ],
)
def test_a_unit_of_another_quantity_is_refused(value, says):
    with pytest.raises(CampaignError) as caught:
        parse_mapping(with_changes(("sigma_cross = 2e-5", f"sigma_cross = {value}")), "m.toml")
    assert_teaches(caught.value, ["star_tracker.sigma_cross", says])


def test_the_lines_of_a_mapping_are_found_again(tmp_path):
    write_csv(tmp_path / "log.csv", log_columns([(60.0, 40.0, 1.0), (200.0, 40.0, -0.7)], 320.0))
    (tmp_path / "mapping.toml").write_text(MAPPING)
    folder = import_logs([tmp_path / "log.csv"], tmp_path / "mapping.toml", tmp_path / "out").folder
    number = MAPPING.splitlines().index('unit = "deg/s"') + 1
    assert mapped_lines(folder, "columns.rate.unit") == [
        f'mapping.toml, line {number}: unit = "deg/s"'
    ]
    # Axes of rates that are along body axes stand nowhere else.
    assert mapped_lines(folder, "rate_sensor.axes")[0].endswith('frame = "body"')
    assert mapped_lines(folder, "wheels.x.axis")[0].endswith("axis = [1.0, 0.0, 0.0]")
    assert mapped_lines(folder, "wheels.y.axis") == []
    assert mapped_lines(folder, "columns.wheel_torque.acts_on")[0].endswith('acts_on = "wheel"')
    # A campaign that was not imported, and the record of an earlier version.
    assert mapped_lines(tmp_path, "columns.rate.unit") == []
    (folder / "import.json").write_text('{"mapping": {"name": "m", "sha256": ""}}')
    assert mapped_lines(folder, "columns.rate.unit") == []
