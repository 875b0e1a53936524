"""Reports in headless Chromium: nothing is fetched, nothing overflows, keys reach everything, drops move.

Run with ``pytest -m browser``; it needs Chromium, its driver (Debian: ``chromium chromium-driver``) and
selenium, and fails where they are missing.
"""

import json
import shutil
import time

import pytest

from fakes.hostile import VISIBLE
from fakes.places import SAMPLES
from fakes.reports import SHORT, short_fits
from sysid.workflows.fit import fit_campaign
from sysid.workflows.options import FitOptions, ReportOptions
from sysid.workflows.report import write_report

pytestmark = pytest.mark.browser

WIDTHS = (1280, 400)
FLAGS = (
    "--headless=new", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run",
    "--disable-background-networking", "--disable-component-update", "--disable-sync", "--hide-scrollbars",
)  # fmt: skip


def browser(folder, *flags):
    try:
        from selenium import webdriver
    except ImportError:
        pytest.fail('selenium is missing; install it with: pip install -e ".[dev]"')
    names = {"chromium": ("chromium", "chromium-browser", "google-chrome"), "chromedriver": ("chromedriver",)}
    paths = {what: next(filter(None, map(shutil.which, every)), None) for what, every in names.items()}
    if missing := [what for what, path in paths.items() if path is None]:
        pytest.fail(f"missing: {', '.join(missing)}; install with: apt-get install chromium chromium-driver")
    options = webdriver.ChromeOptions()
    options.binary_location = paths["chromium"]
    for flag in (*FLAGS, f"--user-data-dir={folder}", *flags):
        options.add_argument(flag)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    return webdriver.Chrome(options=options, service=webdriver.ChromeService(paths["chromedriver"]))


PAGES = ("gear-lf", "motor", "gear-hf", "against")


@pytest.fixture(scope="module")
def pages(tmp_path_factory):
    """Every kind of page, of searches that end at once."""
    folder = tmp_path_factory.mktemp("fits")
    out = {name: write_report(path)["report"] for name, path in short_fits(folder).items()}
    options = ReportOptions(against=other_day(folder), out=folder / "against.html")
    out["against"] = write_report(folder / "gear-lf", options)["report"]
    return out


def other_day(folder):
    """A campaign of one drop that the fit does not hold: the same movement in a file of other bytes."""
    shutil.copytree(SAMPLES / "gear-lf", folder / "other")
    campaign = folder / "other" / "campaign.toml"
    head, first, *_ = campaign.read_text(encoding="utf-8").split("[[trials]]")
    campaign.write_text(f"{head}[[trials]]{first}".replace("synthetic-lf", "other-day"), encoding="utf-8")
    (log,) = (folder / "other").glob("drop-1-*.csv")
    log.write_bytes(log.read_bytes() + b"\n")
    return campaign


@pytest.fixture
def start(tmp_path):
    """Return a function that starts a browser with flags."""
    drivers = []

    def started(*flags):
        drivers.append(browser(tmp_path / "profile", *flags))
        return drivers[-1]

    yield started
    for driver in drivers:
        driver.quit()


@pytest.fixture(params=WIDTHS)
def opened(request, start, pages):
    """Return a function that opens a page at a width."""
    driver, width = start(), request.param
    metrics = {"width": width, "height": 900, "deviceScaleFactor": 1, "mobile": width < 600}
    driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", metrics)

    def show(name):
        driver.get("about:blank")
        driver.get_log("performance")  # what the browser's own start page asked for
        driver.get(pages[name].as_uri())
        return driver

    return show


def requests(driver):
    """Return the addresses that the page asked for: data inside it and the browser's own pages aside."""
    found = []
    for entry in driver.get_log("performance"):
        message = json.loads(entry["message"])["message"]
        if message["method"] == "Network.requestWillBeSent":
            found.append(message["params"]["request"]["url"])
    return [url for url in found if not url.startswith(("data:", "chrome:", "chrome-untrusted:"))]


def test_every_page_stands_alone_and_fits_the_window(opened, pages):
    assert set(pages) == set(PAGES)
    # One browser for all: starting it takes longer than a page.
    for name in PAGES:
        stands_alone(opened(name), pages, name)


def stands_alone(driver, pages, name):
    assert pages[name].stat().st_size < 5_000_000
    assert [entry for entry in driver.get_log("browser") if entry["level"] != "INFO"] == []
    assert requests(driver) == [pages[name].as_uri()]
    widths = driver.execute_script("return [document.documentElement.scrollWidth, innerWidth]")
    assert widths[0] <= widths[1], f"{name} overflows: {widths}"
    broken = driver.execute_script(
        "return [...document.images].filter(i => i.alt.trim() === '' || i.naturalWidth === 0).length"
    )
    assert broken == 0
    assert driver.execute_script("return document.images.length") > 1
    nameless = driver.execute_script(
        "return [...document.querySelectorAll('canvas')].filter(c => !c.getAttribute('aria-label')).length"
    )
    assert nameless == 0
    lost = driver.execute_script(
        "return [...document.querySelectorAll('nav a')]"
        ".filter(a => !document.getElementById(decodeURIComponent(a.hash.slice(1)))).map(a => a.hash)"
    )
    assert lost == []


@pytest.mark.parametrize(
    "broken",
    [
        # Figures are drawn with 8 to 10 point letters; below three quarters of their size nobody reads them.
        "[...document.images].filter(i => i.width < 0.75 * i.getAttribute('width')).map(i => i.alt)",
        "[...document.querySelectorAll('td:not(.prose)')]"
        ".filter(c => c.clientHeight > 2 * parseFloat(getComputedStyle(c).lineHeight)"
        " && c.parentElement.querySelector('.prose') === null).map(c => c.textContent)",
    ],
    ids=["letters of figures", "numbers of tables"],
)
def test_what_is_unfolded_stays_readable(opened, broken):
    for name in PAGES:
        unfold = "document.querySelectorAll('details').forEach(d => d.open = true); return "
        assert opened(name).execute_script(unfold + broken) == [], name


def test_drops_of_two_campaigns_are_told_apart(opened):
    options = opened("against").execute_script(
        "return [...document.querySelectorAll('[data-do=\"drop\"] option')].map(o => o.textContent)"
    )
    assert len(set(options)) == len(options) == 9
    assert sum(text.startswith("other-day, ") and text.endswith(", not fitted") for text in options) == 1


def test_keys_reach_every_control(opened):
    from selenium.webdriver.common.keys import Keys

    driver = opened("gear-lf")
    controls = driver.execute_script(
        "return [...document.querySelectorAll('a, button, select, input, summary, [tabindex]')]"
        ".filter(e => e.checkVisibility()).length"
    )
    body = driver.find_element("css selector", "body")
    seen = set()
    for _ in range(controls + 5):
        body.send_keys(Keys.TAB) if not seen else driver.switch_to.active_element.send_keys(Keys.TAB)
        reached = driver.execute_script(
            "const e = document.activeElement; e.dataset.reached = '1';"
            "return document.querySelectorAll('[data-reached]').length"
        )
        seen.add(reached)
    missed = driver.execute_script(
        "return [...document.querySelectorAll('a, button, select, input, summary, [tabindex]')]"
        ".filter(e => e.checkVisibility() && !e.dataset.reached).map(e => e.outerHTML.slice(0, 90))"
    )
    assert missed == []


def test_the_animation_plays_pauses_and_goes_to_an_instant(opened):
    from selenium.webdriver.common.keys import Keys

    driver = opened("gear-lf")
    root = driver.find_element("css selector", ".animation")
    play = root.find_element("css selector", '[data-do="play"]')
    canvas = root.find_element("css selector", "canvas")

    def picture():
        return driver.execute_script("return arguments[0].toDataURL()", canvas)

    def instant():
        return float(root.get_attribute("data-time"))

    assert root.get_attribute("data-playing") == "no"
    first = picture()
    play.send_keys(Keys.ENTER)
    time.sleep(1.5)
    moved = instant()
    # Ten times slower than life: 1.5 s show 0.15 s; a busy machine shows fewer frames, not a faster drop.
    assert 0.01 < moved < 0.4
    assert picture() != first
    assert play.text == "Pause"
    play.send_keys(Keys.ENTER)
    held = instant()
    time.sleep(0.3)
    assert instant() == held
    buttons = root.find_elements("css selector", '[data-do="instants"] button')
    assert len(buttons) >= 2
    assert all(button.get_attribute("aria-label") for button in buttons)
    buttons[1].send_keys(Keys.ENTER)
    assert instant() != held
    seek = root.find_element("css selector", '[data-do="seek"]')
    seek.send_keys(Keys.HOME)
    assert instant() == 0.0
    assert picture() == first


def test_reduced_motion_steps_instead_of_moving(start, pages):
    driver = start("--force-prefers-reduced-motion")
    driver.get(pages["gear-lf"].as_uri())
    driver.find_element("css selector", '[data-do="play"]').click()
    instants = set()
    for _ in range(10):
        instants.add(driver.find_element("css selector", ".animation").get_attribute("data-time"))
        time.sleep(0.1)
    # Each instant stands for a second and a half.
    assert len(instants) == 1
    assert float(instants.pop()) > 0


def test_printing_shows_what_is_folded(start, pages):
    driver = start()
    driver.get(pages["gear-lf"].as_uri())
    count = (
        "dispatchEvent(new Event(arguments[0]));"
        "return document.querySelectorAll('details:not([open])').length"
    )
    assert driver.execute_script(count, "beforeprint") == 0
    assert driver.execute_script(count, "afterprint") > 0


def test_no_name_runs_as_a_script(tmp_path, start):
    strange = (
        "<script>document.title='owned'</script>{{ 7 * 7 }}<img src=x onerror=document.title='owned'>../"
    )
    drops = shutil.copytree(SAMPLES / "gear-lf", tmp_path / "drops")
    for path in (drops / "campaign.toml", *drops.glob("*.csv")):
        text = path.read_text(encoding="utf-8-sig").replace("F450", f"{strange}body")
        path.write_text(text.replace("board-", f"{strange}board-"), encoding="utf-8")
    text = (drops / "campaign.toml").read_text(encoding="utf-8")
    for number, name in enumerate(VISIBLE[:8], start=1):
        text = text.replace(f'name = "drop-{number}"', f"name = {json.dumps(name)}")
    (drops / "campaign.toml").write_text(text, encoding="utf-8")
    fit = fit_campaign(drops / "campaign.toml", FitOptions(tmp_path / "fit", **SHORT, trust=False))[1]
    page = write_report(fit)["report"]
    driver = start()
    driver.get(page.as_uri())
    assert "owned" not in driver.title
    assert [entry for entry in driver.get_log("browser") if entry["level"] != "INFO"] == []
    assert requests(driver) == [page.as_uri()]
    names = driver.execute_script("return document.body.textContent")
    assert VISIBLE[0] in names
    # Only the page's own scripts, and its policy, are there.
    scripts = driver.execute_script(
        "return [...document.scripts].map(s => s.textContent.trim().slice(0, 12))"
    )
    assert len(scripts) == 3, scripts  # the drops as data, what draws them, what unfolds for printing
    policy = driver.execute_script("return document.querySelector('meta[http-equiv]').content")
    assert policy.startswith("default-src 'none'")
    # The picture of the drops is drawn, with names as text.
    assert driver.execute_script("return document.querySelectorAll('canvas').length") > 0
