"""Reports in headless Chromium: nothing is fetched, nothing overflows, keys reach everything, drops move.

Run with ``pytest -m browser``; it needs Chromium, its driver (Debian: ``chromium chromium-driver``) and
selenium, and fails where they are missing.
"""

import base64
import csv
import json
import shutil
import time
from importlib.resources import files
from xml.etree import ElementTree

import pytest

from fakes.hostile import VISIBLE
from fakes.places import PUBLISHED, SAMPLES
from fakes.reports import SHORT, short_fits
from fakes.shells import words_of
from sysid.landing.settings import MapSettings, StudySettings
from sysid.workflows.compare import compare_and_print
from sysid.workflows.fit import fit_campaign
from sysid.workflows.landing_maps import compute_landing_maps, study_designs
from sysid.workflows.options import (
    ComputeOptions,
    DesignStudyOptions,
    FitOptions,
    LandingMapOptions,
    MotorOptions,
    ReportOptions,
)
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


PAGES = ("gear-lf", "motor", "gear-hf", "against", "landing-map", "design-study", "comparison")
PUBLISHED_GEAR = PUBLISHED / "published-gear-lf.json"


@pytest.fixture(scope="module")
def short(tmp_path_factory):
    """Folders of fits whose searches ended at once."""
    return short_fits(tmp_path_factory.mktemp("fits"))


@pytest.fixture(scope="module")
def pages(short):
    """Every kind of page."""
    folder = short["gear-lf"].parent
    out = {name: write_report(path)["report"] for name, path in short.items()}
    options = ReportOptions(against=other_day(folder), out=folder / "against.html")
    out["against"] = write_report(folder / "gear-lf", options)["report"]
    motors = MotorOptions(PUBLISHED / "published-motor.json")
    grid, compute = ((5.0, 20.0, 35.0), (0.3, 0.6, 1.2)), ComputeOptions(quiet=True)
    options = LandingMapOptions(
        (PUBLISHED_GEAR,), motors, folder / "landing-map.h5", grid=MapSettings(*grid), compute=compute
    )
    compute_landing_maps(options)
    vary = "k_t=0.5:2:2,dx_f=1:1.3:2"
    file, study = folder / "design-study.h5", StudySettings(*grid)
    study_designs(DesignStudyOptions(PUBLISHED_GEAR, motors, vary, file, study=study, compute=compute))
    for name in ("landing-map", "design-study"):
        out[name] = write_report(folder / f"{name}.h5")["report"]
    out["comparison"] = folder / "comparison.html"
    compare_and_print(
        [short["gear-lf"], short["gear-hf"]], cross=True, page=out["comparison"], threads=1, force=False,
        say=None, json=False,
    )  # fmt: skip
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


# Script that returns what cannot be read once unfolded: figures below three quarters of their size, for their
# letters have 8 to 10 points, and numbers that break into lines.
UNREADABLE = """
document.querySelectorAll('details').forEach(d => d.open = true);
return [...document.images].filter(i => i.width < 0.75 * i.getAttribute('width')).map(i => i.alt).concat(
[...document.querySelectorAll('td:not(.prose)')].filter(
c => c.clientHeight > 2 * parseFloat(getComputedStyle(c).lineHeight)
&& c.parentElement.querySelector('.prose') === null).map(c => c.textContent))
"""


def stands_alone(driver, pages, name):
    # Eight drops with their traces, animation and figures for paper.
    assert pages[name].stat().st_size < 3_000_000
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
        "return [...document.querySelectorAll('canvas:not([aria-hidden], [aria-label])')].length"
    )
    assert nameless == 0
    lost = driver.execute_script(
        "return [...document.querySelectorAll('nav a')]"
        ".filter(a => !document.getElementById(decodeURIComponent(a.hash.slice(1)))).map(a => a.hash)"
    )
    assert lost == []
    assert driver.execute_script(UNREADABLE) == [], name


def test_keys_reach_every_control(opened):
    from selenium.webdriver.common.keys import Keys

    driver = opened("gear-lf")
    controls = driver.execute_script(
        "return [...document.querySelectorAll('a, button, select, input, summary, [tabindex]')]"
        ".filter(e => e.checkVisibility()).length"
    )
    body = driver.find_element("css selector", "body")
    seen = set()
    # What is drawn when it comes near adds its own.
    for _ in range(controls + 40):
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


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_a_checker_finds_no_serious_violation(opened, scheme):
    axe = (files("axe_core_python") / "axe.min.js").read_text(encoding="utf-8")
    for name in PAGES:
        driver = opened(name)
        scheme_is(driver, scheme)
        # Loaded by the driver: the page's policy would refuse it.
        driver.execute_script(f"document.querySelectorAll('details').forEach(d => d.open = true);{axe}")
        found = driver.execute_async_script("const done = arguments[0]; axe.run().then(done)")["violations"]
        serious = [each for each in found if each["impact"] in ("serious", "critical")]
        assert [(each["id"], [node["html"][:80] for node in each["nodes"]]) for each in serious] == [], name
    scheme_is(driver, "")


def test_cells_are_read_by_mouse_keys_and_fingers(opened, run):
    from selenium.webdriver import ActionChains
    from selenium.webdriver.common.keys import Keys

    driver = opened("landing-map")
    find = lambda name: driver.find_element("css selector", f'.cells [data-{name}"]')  # noqa: E731
    canvas = driver.find_element("css selector", ".cells canvas")
    # The middle cell is chosen first.
    assert (find('is="x').text, find('is="y').text) == ("0.6 m/s", "20 deg")
    first = find('is="command').text
    find('do="y').send_keys(Keys.END)
    find('do="x').send_keys(Keys.HOME)
    assert (find('is="x').text, find('is="y').text) == ("0.3 m/s", "35 deg")
    assert "--slope 35deg --speed 0.3" in find('is="command').text != first
    size = canvas.size
    corner = (size["width"] // 2 - 40, size["height"] // 2 - 70)
    ActionChains(driver).move_to_element_with_offset(canvas, *corner).perform()
    if driver.execute_script("return matchMedia('(pointer: fine)').matches"):
        # The pointer only looks; a click keeps the cell.
        assert (find('is="x').text, find('is="y').text) == ("1.2 m/s", "5 deg")
    ActionChains(driver).move_to_element_with_offset(canvas, *corner).click().perform()
    ActionChains(driver).move_to_element(find('do="copy')).perform()
    assert (find('is="x').text, find('is="y').text) == ("1.2 m/s", "5 deg")
    words = words_of(find('is="command').text)
    code, printed, _ = run(*words[1:], "--json")
    assert code == 0
    (landing,) = json.loads(printed)
    said = driver.find_elements("css selector", '.cells [data-is="rows"] td')
    assert said[0].text.startswith({"short": "at rest within 45 cm"}[landing["outcome"]])
    assert float(said[1].text.split()[0]) == pytest.approx(landing["distance"], abs=2e-3)


def scheme_is(driver, scheme):
    feature = {"name": "prefers-color-scheme", "value": scheme}
    driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": [feature]})


def plot_of(driver, piece="[data-plot]"):
    """Return the first plot, or animation, of a page when it is drawn and in view."""
    root = driver.find_element("css selector", piece)
    driver.execute_script("arguments[0].scrollIntoView()", root)
    for _ in range(50):
        if root.get_attribute("data-ready"):
            return root
        time.sleep(0.1)
    raise AssertionError(f"{piece} was not drawn")


def window_of(root):
    low, high = map(float, root.get_attribute("data-range").split())
    return low, high


def test_traces_are_read_and_zoomed_by_mouse(opened):
    from selenium.webdriver.common.action_chains import ActionChains

    driver = opened("gear-lf")
    root = plot_of(driver)
    over = root.find_element("css selector", ".u-over")
    full, wide = window_of(root), over.size["width"]
    ActionChains(driver).move_to_element_with_offset(over, 0, 0).perform()
    middle = (full[0] + full[1]) / 2
    assert float(root.get_attribute("data-time")) == pytest.approx(middle, abs=0.02 * full[1])
    values = root.find_element("css selector", ".values").text
    assert "measured" in values
    assert "best set" in values
    # The animation shows the same moment.
    animation = plot_of(driver, "[data-animation]")
    assert float(animation.get_attribute("data-time")) == pytest.approx(middle, abs=0.02 * full[1])
    drag = ActionChains(driver).move_to_element_with_offset(over, -wide // 4, 0).click_and_hold()
    drag.move_by_offset(wide // 4, 0).release().perform()
    low, high = window_of(root)
    assert low == pytest.approx(full[0] + 0.25 * (full[1] - full[0]), abs=0.02)
    assert high == pytest.approx(middle, abs=0.02)
    hold = ActionChains(driver).key_down("\ue008").move_to_element_with_offset(over, 0, 0).click_and_hold()
    hold.move_by_offset(-wide // 4, 0).release().key_up("\ue008").perform()
    assert window_of(root)[0] > low + 0.02
    ActionChains(driver).double_click(over).perform()
    assert window_of(root) == pytest.approx(full)


def test_traces_are_read_and_zoomed_by_keys(opened):
    driver = opened("gear-lf")
    root = plot_of(driver)
    stage = root.find_element("css selector", ".stage")
    full = window_of(root)
    stage.send_keys("\ue014")  # arrow right
    first = float(root.get_attribute("data-time"))
    stage.send_keys("\ue014")
    assert float(root.get_attribute("data-time")) > first
    # What is shown is told as well.
    assert "measured" in root.find_element("css selector", "[role=status]").get_attribute("textContent")
    stage.send_keys("++")
    low, high = window_of(root)
    assert high - low < 0.6 * (full[1] - full[0])
    root.find_element("css selector", '[data-do="right"]').send_keys("\ue007")  # enter
    assert window_of(root)[0] > low
    stage.send_keys("0")
    assert window_of(root) == full


def test_traces_are_read_and_zoomed_by_fingers(opened):
    driver = opened("gear-lf")
    driver.execute_cdp_cmd("Emulation.setTouchEmulationEnabled", {"enabled": True, "maxTouchPoints": 2})
    root = plot_of(driver)
    full = window_of(root)
    box = driver.execute_script(
        "const b = arguments[0].querySelector('.u-over').getBoundingClientRect();"
        "return [b.left, b.top, b.width, b.height]",
        root,
    )

    def touch(kind, *shares):
        points = [
            {"x": box[0] + s * box[2], "y": box[1] + box[3] / 2, "id": k} for k, s in enumerate(shares, 1)
        ]
        driver.execute_cdp_cmd("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})
        # Moves are handed over with the next frame.
        time.sleep(0.2)

    touch("touchStart", 0.25)
    assert float(root.get_attribute("data-time")) == pytest.approx(0.25 * full[1], abs=0.03)
    touch("touchMove", 0.5)
    assert float(root.get_attribute("data-time")) == pytest.approx(0.5 * full[1], abs=0.03)
    touch("touchEnd")
    # What is read has moved nothing below the finger.
    assert driver.execute_script(
        "return arguments[0].querySelector('.u-over').getBoundingClientRect().top", root
    ) == pytest.approx(box[1])
    touch("touchStart", 0.4, 0.6)
    touch("touchMove", 0.3, 0.7)
    touch("touchMove", 0.2, 0.8)
    low, high = window_of(root)
    # What lay under 0.4 and 0.6 lies under 0.2 and 0.8.
    assert high - low == pytest.approx((full[1] - full[0]) / 3, rel=0.05)
    touch("touchEnd")


def test_a_drop_is_chosen_hidden_and_saved(opened, tmp_path):
    driver = opened("gear-lf")
    root = plot_of(driver)
    driver.execute_cdp_cmd(
        "Browser.setDownloadBehavior", {"behavior": "allow", "downloadPath": str(tmp_path)}
    )
    driver.execute_script(
        "const s = arguments[0].querySelector('[data-do=\"view\"]'); s.value = '1';"
        "s.dispatchEvent(new Event('change'))",
        root,
    )
    animation = plot_of(driver, "[data-animation]").find_element("css selector", '[data-do="drop"]')
    assert animation.get_attribute("value") == "1"
    shown = "return arguments[0].plot.plots[0].series.map(s => s.show)"
    before = driver.execute_script(shown, root)
    driver.execute_script("arguments[0].querySelector('.toggles input').click()", root)
    after = driver.execute_script(shown, root)
    assert sum(after) < sum(before)
    for what in ("csv", "svg"):
        root.find_element("css selector", f'[data-do="{what}"]').send_keys("\ue007")
    for _ in range(50):
        made = {path.suffix: path for path in tmp_path.iterdir() if path.suffix in (".csv", ".svg")}
        if len(made) == 2:
            break
        time.sleep(0.1)
    rows = list(csv.reader(made[".csv"].read_text(encoding="utf-8-sig").splitlines()))
    assert rows[0][0] == "time [s]"
    assert any(head.startswith("z_B, measured") for head in rows[0])
    assert len(rows) > 100
    assert float(rows[-1][0]) > 0.5
    assert ElementTree.parse(made[".svg"]).getroot().tag.endswith("svg")
    # The policy let both through, and nothing else went out.
    assert [entry for entry in driver.get_log("browser") if entry["level"] != "INFO"] == []


def test_the_drone_fills_its_picture_on_sharp_screens(start, pages):
    driver = start()
    metrics = {"width": 1280, "height": 900, "deviceScaleFactor": 2, "mobile": False}
    driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", metrics)
    driver.get(pages["gear-lf"].as_uri())
    root = plot_of(driver, "[data-animation]")
    assert 0.6 < float(root.get_attribute("data-filled")) < 1
    canvas = root.find_element("css selector", "canvas")
    sizes = driver.execute_script("return [arguments[0].width, arguments[0].clientWidth]", canvas)
    assert sizes[0] == pytest.approx(2 * sizes[1], abs=2)
    for key in ("\ue014", "\ue014", " "):
        canvas.send_keys(key)
    assert float(root.get_attribute("data-time")) > 0
    assert root.get_attribute("data-playing") == "yes"


def test_two_fits_move_beside_each_other(start, tmp_path, short):
    out = tmp_path / "two.html"
    options = ReportOptions(compare=short["gear-lf"], out=out)
    write_report(short["gear-lf"], options)
    driver = start()
    driver.get(out.as_uri())
    root = plot_of(driver, "[data-animation]")
    names = [c.get_attribute("aria-label") for c in root.find_elements("css selector", "canvas")]
    assert [name.partition(".")[0] for name in names] == ["synthetic-lf", "synthetic-lf (second)"]
    toggles = plot_of(driver).find_element("css selector", ".toggles").text
    assert "best set of synthetic-lf" in toggles


def test_paper_takes_few_pages(start, pages):
    driver = start()
    for name in ("gear-lf", "gear-hf", "motor"):
        driver.get(pages[name].as_uri())
        folded = (
            "dispatchEvent(new Event(arguments[0]));"
            "return document.querySelectorAll('details:not([open], .unprinted)').length"
        )
        assert driver.execute_script(folded, "beforeprint") == 0
        assert driver.execute_script(folded, "afterprint") > 0
        printed = driver.execute_cdp_cmd("Page.printToPDF", {"preferCSSPageSize": True})["data"]
        assert base64.b64decode(printed).count(b"/Type /Page\n") <= 8, name
        driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": "print"})
        shown = "return [...document.querySelectorAll(arguments[0])].filter(e => e.checkVisibility()).length"
        assert driver.execute_script(shown, "[data-plot], [data-animation], .unprinted") == 0
        assert driver.execute_script(shown, ".printed figure") >= 5
        driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": ""})


def test_the_animation_plays_pauses_and_goes_to_an_instant(opened):
    from selenium.webdriver.common.keys import Keys

    driver = opened("gear-lf")
    root = plot_of(driver, "[data-animation]")
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
    buttons = root.find_elements("css selector", '[data-do="marks"] button')
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
    plot_of(driver, "[data-animation]").find_element("css selector", '[data-do="play"]').click()
    instants = set()
    for _ in range(10):
        instants.add(driver.find_element("css selector", ".animation").get_attribute("data-time"))
        time.sleep(0.1)
    # Each instant stands for a second and a half.
    assert len(instants) == 1
    assert float(instants.pop()) > 0


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
    # Traces and drops as data; what unfolds for printing, uPlot, what draws traces, what draws drops.
    assert len(scripts) == 6, scripts
    policy = driver.execute_script("return document.querySelector('meta[http-equiv]').content")
    assert policy.startswith("default-src 'none'")
    # The policy lets run no script but those of the page, by their hashes.
    assert "unsafe" not in policy.partition("script-src")[2].partition(";")[0]
    assert policy.count("'sha256-") == 4
    driver.execute_script(
        "const s = document.createElement('script'); s.textContent = \"document.title = 'owned'\";"
        "document.body.append(s)"
    )
    assert "owned" not in driver.title
    plot_of(driver, "[data-animation]")
    plot_of(driver)
    # Traces and drops are drawn, with names as text; a file that is saved has a harmless name.
    assert driver.execute_script("return document.querySelectorAll('canvas').length") > 5
    assert set(VISIBLE[:8]) <= {
        text.rpartition(" (")[0]
        for text in driver.execute_script(
            "return [...document.querySelectorAll('[data-do=\"view\"] option')].map(o => o.textContent)"
        )
    }
    svg = driver.execute_script("return document.querySelector('[data-plot]').plot.svg()")
    assert ElementTree.fromstring(svg).tag.endswith("svg")
