"""Units of signals of unknown name: never an angle that nobody wrote, never a factor for a logarithm."""

import pytest

from sysid.loaders.signals import plain_unit


@pytest.mark.parametrize(
    ("stated", "unit", "factor"),
    [
        ("%", "1", 0.01),
        ("strain", "1", 1.0),
        ("dB", "", 1.0),
        ("dBm", "", 1.0),
        ("mrad", "rad", 1e-3),
        ("rad/s", "rad/s", 1.0),
        ("mV", "V", 1e-3),
    ],
)
def test_plain_units(stated, unit, factor):
    assert plain_unit(stated) == (unit, pytest.approx(factor))


def test_a_log_is_never_replaced_by_its_conversion(tmp_path, run):
    log = tmp_path / "log.csv"
    log.write_text("Time (s),Speed (rad/s)\n0,1\n0.01,2\n0.02,3\n", encoding="utf-8")
    before = log.read_bytes()
    code, _, err = run("convert", log, log, "--force")
    assert code == 2
    assert "is the log itself" in err
    assert log.read_bytes() == before
