"""Reports of fits of the sample data: LF and HF, one trial or many, gear and motor."""

import re
import shutil
from html.parser import HTMLParser

import h5py
import pytest
from PIL import Image

from fakes.places import SAMPLES
from fakes.reports import SHORT, short_fits
from sysid.workflows.fit import fit_gear
from sysid.workflows.options import FitOptions, ReportOptions
from sysid.workflows.report import write_report

pytestmark = pytest.mark.slow


class Balanced(HTMLParser):
    """Counts what is opened and not closed, and the images without words."""

    VOID = frozenset({"img", "meta", "link", "input", "br", "hr"})

    def __init__(self):
        super().__init__()
        self.open, self.pictures, self.silent = [], 0, 0

    def handle_starttag(self, tag, attrs):
        words = {"img": "alt", "svg": "aria-label"}.get(tag)
        if words and (tag == "img" or dict(attrs).get("role") == "img"):
            self.pictures += 1
            self.silent += not (dict(attrs).get(words) or "").strip()
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag, tag


def checked(text, pictures):
    parser = Balanced()
    parser.feed(text)
    assert parser.open == []
    assert parser.silent == 0
    assert parser.pictures >= pictures
    assert len(text.encode()) < 5_000_000
    # Nothing is fetched: no address but those of data inside the page (and the names of XML's own schemas).
    bare = re.sub(r"data:image/[a-z+]+[;,][^\"]*", "data:", text)
    assert re.findall(r"(?:src|href)=\"(?!#|data:|\")[^\"]*\"", bare) == []
    return bare


@pytest.fixture(scope="module")
def fits(tmp_path_factory):
    return short_fits(tmp_path_factory.mktemp("fits"))


@pytest.mark.parametrize(("name", "pictures"), [("gear-lf", 18), ("gear-hf", 18), ("motor", 15)])
def test_the_report_of_a_fit(fits, name, pictures):
    text = checked(write_report(fits[name])["report"].read_text(encoding="utf-8"), pictures)
    assert "not computed; run sysid" in text
    assert "two trials that it never saw" in text
    if name != "motor":
        assert text.count("<canvas") == 1
        # Eight drops of five channels, each with its contacts.
        channels = re.findall(r'alt="drop-\d [^"]*: x_B, [^"]*z_B, [^"]*ẋ_B, [^"]*ż_B, [^"]*q_B', text)
        assert len(channels) == 8
        assert len(re.findall(r'"label":"rear foot down","spans":\[\[\d', text)) == 8
    if name == "gear-hf":
        assert "both feet slip, rear sticks, front sticks, both stick" in text


def test_the_report_of_a_single_drop_against_the_others(fits, tmp_path):
    shutil.copytree(SAMPLES / "gear-lf", tmp_path / "one")
    campaign = tmp_path / "one" / "campaign.toml"
    text = campaign.read_text(encoding="utf-8")
    head, *trials = text.split("[[trials]]")
    campaign.write_text("[[trials]]".join([head, trials[3]]), encoding="utf-8")
    _, fit = fit_gear(campaign, FitOptions(tmp_path / "fit", **SHORT, trust=False))
    options = ReportOptions(
        against=SAMPLES / "gear-lf" / "campaign.toml", figure=tmp_path / "pdf", gif=tmp_path / "a.gif"
    )
    written = write_report(fit, options)
    page_text = checked(written["report"].read_text(encoding="utf-8"), 18)
    # Eight drops lie there, and the fit was made from one of them.
    assert "It predicts seven trials of synthetic-lf that it never saw" in page_text
    figures = sorted(path.name for path in (tmp_path / "pdf").iterdir())
    assert {"convergence.pdf", "geometry.pdf", "spread.pdf", "waterfall.pdf"} <= set(figures)
    assert all((tmp_path / "pdf" / name).read_bytes().startswith(b"%PDF") for name in figures)
    film = Image.open(tmp_path / "a.gif")
    # 0.75 s, ten times slower, 20 frames per second.
    assert film.n_frames == pytest.approx(150, abs=3)


def test_the_motor_s_report_against_another_campaign(fits, tmp_path):
    # The same bench on another day: equal numbers in a file of other bytes, the only log not of the fit.
    shutil.copytree(SAMPLES / "motor", tmp_path / "motor")
    with h5py.File(tmp_path / "motor" / "forward-2.h5", "a") as log:
        log.attrs["note"] = "copied"
    options = ReportOptions(against=tmp_path / "motor" / "campaign.toml", out=tmp_path / "against.html")
    text = checked(write_report(fits["motor"], options)["report"].read_text(encoding="utf-8"), 15)
    # The same trials with the same sets: the same errors as in the fit itself.
    shares = re.findall(r'alt="(?:synthetic-motor, )?forward-2 \(not fitted\): NRMSE ([\d.]+) %', text)
    assert len(shares) == 2
    assert float(shares[0]) == pytest.approx(float(shares[1]), rel=0.02)
