"""Tables of inertial samples, and the file that says what their columns are."""

import numpy as np
import pytest

from spoofgym.core.reading import FileError
from spoofgym.data.inertial import read_inertial
from spoofgym.earth.wgs84 import DEGREE, STANDARD_GRAVITY

pandas = pytest.importorskip("pandas")

MAPPING = """\
[time]
column = "t"
unit = "ms"
scale = "gps"
[specific_force]
columns = ["-ay", "ax", "az"]
unit = "g"
[angular_rate]
columns = ["-gy", "gx", "gz"]
unit = "deg/s"
"""
ROWS = (
    "1000,0.1,0.2,-1,1,2,3\n1010,0.1,0.2,-1,1,2,nan\n1005,0.1,0.2,-1,1,2,3\n1020,0.3,0.2,-1,1,2,3\n"
)


@pytest.fixture
def read(tmp_path):
    def go(mapping=MAPPING, rows=ROWS, header="t,ax,ay,az,gx,gy,gz\n", near=0.0):
        (tmp_path / "imu.csv").write_text(header + rows)
        (tmp_path / "imu.toml").write_text(mapping)
        return read_inertial(tmp_path / "imu.csv", tmp_path / "imu.toml", near)

    return go


def test_columns_units_and_axes(read, tmp_path):
    samples = read()
    assert samples.time == pytest.approx([1.0, 1.005, 1.02])
    assert samples.dropped == 1
    force = STANDARD_GRAVITY * np.array([-0.2, 0.1, -1.0])
    np.testing.assert_allclose(samples.specific_force_b[0], force)
    np.testing.assert_allclose(samples.angular_rate_b[0], DEGREE * np.array([-2.0, 1.0, 3.0]))
    numbers = MAPPING.replace('"t"', "1")
    for k, name in enumerate(("ax", "ay", "az", "gx", "gy", "gz"), 2):
        numbers = numbers.replace(f'"{name}"', str(k)).replace(f'"-{name}"', str(-k))
    same = read(f"header = false\n{numbers}", header="")
    np.testing.assert_array_equal(same.angular_rate_b, samples.angular_rate_b)
    pandas.read_csv(tmp_path / "imu.csv", names=list("abcdefg")).to_parquet(tmp_path / "i.parquet")
    again = read_inertial(tmp_path / "i.parquet", tmp_path / "imu.toml", 0.0)
    np.testing.assert_array_equal(again.angular_rate_b, samples.angular_rate_b)


@pytest.mark.parametrize(
    ("scale", "stamp", "near"),
    [("gps", 1.4e9, 0.0), ("unix-gps", 1.4e9 + 315_964_800.0, 0.0), ("week", 509_000.0, 1.4e9),
     ("unix", 1.4e9 + 315_964_800.0 - 18.0, 0.0)],
)  # fmt: skip
def test_scales_of_time(read, scale, stamp, near):
    mapping = MAPPING.replace('"gps"', f'"{scale}"').replace('"ms"', '"s"')
    if scale == "week":
        stamp = 1.4e9 % 604_800.0
    rows = "".join(f"{stamp + k!r},0,0,-1,0,0,0\n" for k in (0.0, 0.5))
    assert read(mapping, rows, near=near).time == pytest.approx([1.4e9, 1.4e9 + 0.5], abs=1e-6)


def test_a_lever_arm_moves_the_sensor_to_the_antenna(read):
    rows = "".join(f"{10 * k},0,0,-1,0,0,{10 * k}\n" for k in range(1, 50))  # turns ever faster
    arm = read(f"lever_arm_m = [0.5, 0.0, 0.0]\n{MAPPING}", rows)
    change = arm.specific_force_b - read(MAPPING, rows).specific_force_b
    rate = arm.angular_rate_b[:, 2]
    np.testing.assert_allclose(change[:, 0], -0.5 * rate**2, atol=1e-12)
    np.testing.assert_allclose(change[:, 1], 0.5 * 1000.0 * DEGREE, atol=1e-9)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('unit = "deg/s"', "", r"\[angular_rate\] must have the keys columns, unit"),
        ('"deg/s"', '"rpm"', r"unknown `angular_rate\.unit` 'rpm'; valid: deg/s, rad/s"),
        ('"gps"', '"utc"', r"unknown `time\.scale` 'utc'; valid: gps, unix, unix-gps, week"),
        ("[specific_force]", "[force]", "unknown key 'force'; valid: angular_rate"),
        ('["-ay", "ax", "az"]', '["ax"]', r"`specific_force\.columns` must be 3 names"),
        ('"-ay"', '"-xx"', "unknown column 'xx'; valid: ax"),
        ('"-ay"', "9", "unknown column '9'; valid: 1, 2"),
        ("[time]", "[time", "is not TOML: "),
        ("[time]", "lever_arm_m = 3\n[time]", "`lever_arm_m` must be 3 numbers of .*, got 3"),
        ("[time]", "lever_arm_m = [500, 0, 0]\n[time]", "at most 100 m, got .500, 0, 0."),
    ],
)
def test_a_mapping_that_is_wrong_names_the_key(read, old, new, message):
    with pytest.raises(FileError, match=message) as caught:
        read(MAPPING.replace(old, new))
    assert "imu." in str(caught.value)


def test_a_table_without_numbers_is_refused(read):
    for rows in ("", "1,2,3,x,5,6,7\n2,2,3,x,5,6,7\n"):
        with pytest.raises(FileError, match=r"imu\.csv: "):
            read(rows=rows)
