"""The page of a selection in a browser, on a wide screen and on a phone, light and dark: it is opened and used."""

import shutil

import numpy as np
import pytest
from selenium import webdriver
from selenium.webdriver.chrome.service import Service
from selenium.webdriver.common.action_chains import ActionChains
from selenium.webdriver.common.by import By
from selenium.webdriver.common.keys import Keys
from selenium.webdriver.support.ui import WebDriverWait

import mexpress as mx

PROGRAMS = {name: shutil.which(name) for name in ("chromium", "chromedriver")}
OPTIONS = ("--headless=new", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage", "--hide-scrollbars")
WIDTHS, SCHEMES = (1400, 390), ("light", "dark")
RNG = np.random.default_rng(4)

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(
        not all(PROGRAMS.values()), reason="no browser: apt-get install chromium chromium-driver"
    ),
]


@pytest.fixture(scope="module")
def pages(tmp_path_factory):
    folder = tmp_path_factory.mktemp("pages")
    source = RNG.uniform(0, 1, (80, 2)) * [320, 200]
    target = source + 6 * np.sin(source[:, ::-1] / 60) + RNG.normal(0, 0.3, source.shape)
    target[7] += 40
    y, x = np.mgrid[:200, :320]
    image = np.uint8(127 + 60 * np.sin(x / 9) + 60 * np.sin(y / 13))
    warps = mx.select_warp(source, target, criteria=["FIT", "ER10", "AIC"], robust=True)
    warps.report(
        folder / "warp.html", image, np.roll(image, 6, axis=1), command="mexpress warp " + 40 * "long "
    )
    points = RNG.uniform(0, 1, (200, 2)) * [640, 480]
    surfaces = mx.select_surface(points, 2 + np.sin(points[:, 0] / 90) + RNG.normal(0, 0.01, 200))
    surfaces.report(folder / "surface.html", image_size=(640, 480), unit="m")
    return folder


@pytest.fixture(scope="module")
def browser():
    options = webdriver.ChromeOptions()
    options.binary_location = PROGRAMS["chromium"]
    for option in OPTIONS:
        options.add_argument(option)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    driver = webdriver.Chrome(options=options, service=Service(PROGRAMS["chromedriver"]))
    yield driver
    driver.quit()


@pytest.fixture
def show(browser, pages):
    def show(name, width=1400, scheme="light"):
        size = {"width": width, "height": 900, "deviceScaleFactor": 1, "mobile": width < 600}
        browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
        wish = {"features": [{"name": "prefers-color-scheme", "value": scheme}]}
        browser.execute_cdp_cmd("Emulation.setEmulatedMedia", wish)
        browser.get((pages / f"{name}.html").as_uri())
        return browser

    return show


def find(browser, selector):
    element = browser.find_element(By.CSS_SELECTOR, selector)
    browser.execute_script("arguments[0].scrollIntoView({block: 'center'})", element)
    return element


def drawn(element):
    """What is seen of an element, as a PNG; of a canvas, what is on it."""
    if element.tag_name == "canvas":
        return element.parent.execute_script("return arguments[0].toDataURL()", element)
    element.parent.execute_script("document.activeElement.blur()")  # the rim of the focus is no change
    return element.screenshot_as_png


def luminance(colour):
    """Relative luminance of a colour as CSS has it, by WCAG."""
    parts = [int(part) / 255 for part in colour[colour.index("(") + 1 : -1].split(",")[:3]]
    linear = [part / 12.92 if part <= 0.04045 else ((part + 0.055) / 1.055) ** 2.4 for part in parts]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


@pytest.mark.parametrize("scheme", SCHEMES)
@pytest.mark.parametrize("width", WIDTHS)
@pytest.mark.parametrize("name", ["warp", "surface"])
def test_it_opens_without_errors_and_fits_the_screen(show, name, width, scheme):
    browser = show(name, width, scheme)
    assert browser.get_log("browser") == []
    requests = [
        entry["message"]
        for entry in browser.get_log("performance")
        if "requestWillBeSent" in entry["message"]
    ]
    assert not any('"url":"http' in message for message in requests)
    assert browser.execute_script("return document.documentElement.scrollWidth") == width
    wide = "return [...document.querySelectorAll('figure, figure > svg, canvas, img, p, h1')].filter(e => {"
    wide += "const b = e.getBoundingClientRect(); return b.left < -1 || b.right > innerWidth + 1})"
    wide += ".map(e => e.outerHTML)"
    assert browser.execute_script(wide) == []


@pytest.mark.parametrize("scheme", SCHEMES)
def test_letters_stand_out(show, scheme):
    browser = show("warp", 1400, scheme)
    paper = luminance(browser.find_element(By.TAG_NAME, "body").value_of_css_property("background-color"))
    assert (paper > 0.8) is (scheme == "light")
    for selector in ("h1", "header > p", "dt", "figcaption", ".asked th", ".chart output", "pre code"):
        ink = luminance(find(browser, selector).value_of_css_property("color"))
        assert (max(ink, paper) + 0.05) / (min(ink, paper) + 0.05) > 4.5, selector


def test_letters_in_pictures_are_large_enough_on_a_phone(show):
    browser = show("warp", 390)
    for svg in browser.find_elements(By.CSS_SELECTOR, "figure > svg"):
        size = (
            "const s = arguments[0]; return parseFloat(getComputedStyle(s.querySelector('text')).fontSize) * "
        )
        assert browser.execute_script(size + "s.getBoundingClientRect().width / 560", svg) > 10


@pytest.mark.parametrize("width", WIDTHS)
def test_a_curve_tells_its_values_where_the_pointer_is(show, width):
    browser = show("warp", width)
    svg, said = find(browser, ".chart svg"), browser.find_element(By.CSS_SELECTOR, ".chart output")
    value = browser.find_element(By.CSS_SELECTOR, ".chart data")
    chosen = said.text, value.text
    ActionChains(browser).move_to_element_with_offset(svg, int(0.4 * svg.size["width"]), 0).perform()
    assert (said.text, value.text) != chosen
    assert "smoothing" in said.text
    assert float(value.text) > float(chosen[1])  # the selected one is the smallest
    ActionChains(browser).move_to_element(find(browser, "h1")).perform()
    assert (said.text, value.text) == chosen


def test_keys_move_along_a_curve(show):
    browser = show("warp")
    svg, said = find(browser, ".chart svg"), browser.find_element(By.CSS_SELECTOR, ".chart output")
    svg.send_keys(Keys.HOME)
    first = said.text
    svg.send_keys(Keys.ARROW_RIGHT)
    second = said.text
    svg.send_keys(Keys.ARROW_LEFT)
    assert said.text == first != second


@pytest.mark.parametrize("width", WIDTHS)
def test_the_slider_changes_the_picture(show, width):
    browser = show("warp", width)
    slider, stack = find(browser, ".stack input"), browser.find_element(By.CSS_SELECTOR, ".stack")
    middle = drawn(stack)
    ActionChains(browser).move_to_element_with_offset(
        slider, int(-0.3 * slider.size["width"]), 0
    ).click().perform()
    left = drawn(stack)
    assert left != middle
    assert float(slider.get_attribute("value")) == pytest.approx(20, abs=2)
    slider.send_keys(Keys.ARROW_RIGHT)
    assert float(slider.get_attribute("value")) == pytest.approx(20.5, abs=2)
    after = drawn(stack)
    find(browser, "input[value=taken]").click()
    assert drawn(stack) != after


def test_a_map_tells_its_value(show):
    browser = show("warp")
    find(browser, ".map[data-map]")
    said = browser.find_element(By.CSS_SELECTOR, ".map[data-map] output")
    assert said.text == ""
    ActionChains(browser).move_to_element(
        browser.find_element(By.CSS_SELECTOR, ".map[data-map] svg")
    ).perform()
    number, unit = said.text.split()
    assert 0 < float(number) < 30
    assert unit == "pixels"


@pytest.mark.parametrize("width", WIDTHS)
@pytest.mark.parametrize("scheme", SCHEMES)
def test_a_surface_is_turned(show, width, scheme):
    browser = show("surface", width, scheme)
    canvas, turn, tilt = (
        find(browser, selector) for selector in ("canvas", "[data-angle=turn]", "[data-angle=tilt]")
    )
    find(browser, "canvas")
    before = drawn(canvas), turn.get_attribute("value"), tilt.get_attribute("value")
    ActionChains(browser).drag_and_drop_by_offset(canvas, 60, 20).perform()
    dragged = drawn(canvas), turn.get_attribute("value"), tilt.get_attribute("value")
    assert all(one != other for one, other in zip(before, dragged, strict=True))
    turn.send_keys(Keys.ARROW_LEFT)
    assert drawn(canvas) != dragged[0]
    assert browser.get_log("browser") == []


def test_a_surface_is_drawn_anew_for_another_screen(show):
    browser = show("surface", 1400, "light")
    canvas = find(browser, "canvas")
    light = drawn(canvas)
    wish = {"features": [{"name": "prefers-color-scheme", "value": "dark"}]}
    browser.execute_cdp_cmd("Emulation.setEmulatedMedia", wish)
    assert WebDriverWait(browser, 5).until(lambda _: drawn(canvas) != light)
    size = {"width": 500, "height": 900, "deviceScaleFactor": 2, "mobile": False}
    browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
    same = "return arguments[0].width === 2 * arguments[0].clientWidth && arguments[0].width < 1000"
    assert WebDriverWait(browser, 5).until(lambda _: browser.execute_script(same, canvas))


def test_without_scripts_it_is_read_all_the_same(show, browser, pages):
    browser.execute_cdp_cmd("Emulation.setScriptExecutionDisabled", {"value": True})
    try:
        browser.get((pages / "warp.html").as_uri())
        assert "Scripts are off" in browser.find_element(By.TAG_NAME, "main").text
    finally:
        browser.execute_cdp_cmd("Emulation.setScriptExecutionDisabled", {"value": False})
