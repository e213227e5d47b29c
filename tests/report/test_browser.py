"""The pages in headless Chromium: no errors, nothing fetched, words for every picture, no sideways
scrolling, tables that sort.
"""

import json
import shutil

import pytest

SIZES = (1400, 400)
SCHEMES = ("light", "dark")
FLAGS = (
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-background-networking",
    "--no-first-run",
    "--disable-component-update",
    "--disable-sync",
)


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    """A Chromium with a profile of its own."""
    webdriver = pytest.importorskip("selenium.webdriver", reason="selenium is not installed")
    program = shutil.which("chromium") or shutil.which("google-chrome")
    driver = shutil.which("chromedriver")
    if program is None or driver is None:
        pytest.skip("no chromium with its chromedriver is installed")
    options = webdriver.ChromeOptions()
    options.binary_location = program
    for flag in (*FLAGS, f"--user-data-dir={tmp_path_factory.mktemp('profile')}"):
        options.add_argument(flag)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    found = webdriver.Chrome(
        options=options, service=webdriver.ChromeService(executable_path=driver)
    )
    found.execute_cdp_cmd("Emulation.setFocusEmulationEnabled", {"enabled": True})
    yield found
    found.quit()


def opened(browser, path, width, scheme):
    """Opens a file at a width in a color scheme; the addresses requested, and the console's
    messages.
    """
    screen = {"width": width, "height": 900, "deviceScaleFactor": 1, "mobile": width < 600}
    browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", screen)
    browser.execute_cdp_cmd(
        "Emulation.setEmulatedMedia",
        {"features": [{"name": "prefers-color-scheme", "value": scheme}]},
    )
    for kind in ("performance", "browser"):
        browser.get_log(kind)
    browser.get(path.as_uri())
    messages = [json.loads(entry["message"])["message"] for entry in browser.get_log("performance")]
    sent = [
        m["params"]
        for m in messages
        if m["method"] == "Network.requestWillBeSent"
        and m["params"]["documentURL"] == path.as_uri()
    ]
    asked = [one["request"]["url"] for one in sent]  # but for what the browser's own pages ask for
    return [url for url in asked if not url.startswith("data:")], browser.get_log("browser")


@pytest.mark.parametrize("kind", ["fit", "diagnosis", "unfinished"])
def test_page_in_a_browser(browser, pages, kind):
    """At 1400 pixels in light, and at 400 in dark: each width and each scheme once."""
    path = pages[kind]
    backgrounds = set()
    for width, scheme in zip(SIZES, SCHEMES, strict=True):
        asked, messages = opened(browser, path, width, scheme)
        assert asked == [path.as_uri()]
        assert messages == []
        wide = browser.execute_script(
            "return [document.documentElement.scrollWidth, window.innerWidth]"
        )
        assert wide[0] <= wide[1] == width
        pictures = browser.execute_script(
            "return [...document.querySelectorAll('svg, img, canvas')].map(e => "
            "[e.getAttribute('role'), e.getAttribute('aria-label'),"
            " e.getBoundingClientRect().width, e.getBoundingClientRect().height])"
        )
        assert pictures
        assert all(role == "img" and label and w > 200 and h > 40 for role, label, w, h in pictures)
        backgrounds.add(
            browser.execute_script("return getComputedStyle(document.body).backgroundColor")
        )
    assert len(backgrounds) == 2


def test_text_can_be_read_in_both_schemes(browser, pages):
    """Words in pictures and on the page have a contrast of 4.5 to 1 (WCAG 2.1, 1.4.3)."""
    for scheme in SCHEMES:
        opened(browser, pages["diagnosis"], 1400, scheme)
        pairs = browser.execute_script(
            "const own = (e, p) => getComputedStyle(e)[p];"
            "const ground = e => { for (; e; e = e.parentElement) { const c = own(e, "
            "'backgroundColor');"
            "  if (c !== 'rgba(0, 0, 0, 0)') return c; } };"
            "const beneath = e => e.closest('.mark')"
            "  ? own(e.closest('.mark').querySelector('.disc'), 'fill') : "
            "ground(e.closest('figure') ?? e);"
            "return [...document.querySelectorAll('p, h1, h2, dt, dd, figcaption, td, svg text')]"
            "  .map(e => [own(e, e.tagName === 'text' ? 'fill' : 'color'), "
            "beneath(e), e.textContent])"
        )
        assert len(pairs) > 50
        assert min((contrast(a, b), text) for a, b, text in pairs)[0] >= 4.5
    assert contrast("rgb(150, 150, 150)", "rgb(255, 255, 255)") < 4.5


def contrast(one, two):
    """The ratio of the relative luminances of two CSS colors."""
    lights = []
    for color in (one, two):
        parts = [int(part) / 255 for part in color[color.index("(") + 1 : -1].split(",")[:3]]
        linear = [
            part / 12.92 if part <= 0.04045 else ((part + 0.055) / 1.055) ** 2.4 for part in parts
        ]
        lights.append(0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2])
    return (max(lights) + 0.05) / (min(lights) + 0.05)


def test_a_run_zooms(browser, pages):
    """By buttons, keys and dragging across a part, on a phone too; another signal is drawn."""
    opened(browser, pages["diagnosis"], 400, "light")
    figure = browser.find_element("css selector", "figure.run")
    reading = figure.find_element("css selector", ".reading")
    canvas = figure.find_element("css selector", "canvas.motion")
    drawn = "return document.querySelector('canvas.motion').toDataURL()"
    whole, first = reading.text, browser.execute_script(drawn)
    figure.find_element("css selector", "[data-do=in]").click()
    closer = reading.text
    assert closer != whole
    assert browser.execute_script(drawn) != first
    canvas.send_keys("0")
    assert reading.text == whole
    assert browser.execute_script(drawn) == first
    browser.execute_script(
        "const c = arguments[0], box = c.getBoundingClientRect();"
        "c.setPointerCapture = () => {};"
        "for (const [kind, at] of [['down', 0.4], ['move', 0.6], ['up', 0.6]])"
        "  c.dispatchEvent(new PointerEvent('pointer' + kind,"
        "    {clientX: box.left + at * box.width, bubbles: true, pointerId: 1}))",
        canvas,
    )
    assert reading.text not in (whole, closer)
    figure.find_element("css selector", "[data-do=all]").click()
    browser.execute_script(
        "const s = arguments[0].querySelector('select'); s.value = 1;"
        "s.dispatchEvent(new Event('change'))",
        figure,
    )
    assert reading.text == whole
    assert browser.execute_script(drawn) != first


def test_a_tapped_word_is_explained(browser, pages):
    """At the foot of the screen, inside it."""
    opened(browser, pages["diagnosis"], 400, "dark")
    says, shown, place = browser.execute_script(
        "const word = document.querySelector('.word'); word.focus();"
        "const style = getComputedStyle(word, '::after');"
        "return [word.title, style.content, style.position]"
    )
    assert says in shown
    assert place == "fixed"


def test_errors_and_requests_are_noticed(browser, tmp_path):
    """The control: a page that fails and fetches."""
    (tmp_path / "bad.html").write_text("<img src='other.png'><script>throw new Error('x')</script>")
    asked, messages = opened(browser, tmp_path / "bad.html", 1400, "light")
    assert len(asked) == 2
    assert messages


def test_tables_sort(browser, pages):
    """A click sorts by value, another one the other way round, and says so."""
    opened(browser, pages["fit"], 1400, "light")
    script = (
        "const head = [...document.querySelectorAll('th')].find(e => e.textContent === "
        "'mean'); head.querySelector('button').click();"
        "return [head.getAttribute('aria-sort'), "
        "[...head.closest('table').tBodies[0].rows].map(r => "
        "+r.cells[head.cellIndex].textContent)]"
    )
    up = browser.execute_script(script)
    down = browser.execute_script(script)
    assert up == ["ascending", sorted(up[1])]
    assert down == ["descending", sorted(up[1], reverse=True)]
    assert len(set(up[1])) == 4
